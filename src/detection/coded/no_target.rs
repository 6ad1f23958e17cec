//! Why no target with markers is reported.

/// Why no target is reported.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoTarget {
    /// The image is too small for any target.
    #[error("the image of {width}x{height} pixels is too small to hold a {target}")]
    ImageTooSmall {
        /// The image's width, in pixels.
        width: usize,
        /// The image's height, in pixels.
        height: usize,
        /// What was searched for.
        target: String,
    },
    /// Crossings do not form a lattice.
    #[error(
        "{corners} chessboard-like corners seen, but they form no grid; is the {target} in view, flat and not too small?"
    )]
    NoLattice {
        /// How many crossings were seen.
        corners: usize,
        /// What was searched for.
        target: String,
    },
    /// A lattice whose cells show no marker of the target.
    #[error(
        "a grid of {cols}x{rows} corners{} is seen, but no marker of the {target} is read in it: is it a plain chessboard, another dictionary or another board?",
        if *goes_on { " or more" } else { "" }
    )]
    NoMarkers {
        /// Corners along the longer side.
        cols: u32,
        /// Corners along the other side.
        rows: u32,
        /// Whether it was followed no further, so that it may have more.
        goes_on: bool,
        /// What was searched for.
        target: String,
    },
    /// Markers at places where the target does not have them.
    #[error(
        "{markers} markers of the same dictionary are seen, but not at their positions on the {target}: check its size, first_id and dictionary"
    )]
    OtherBoard {
        /// How many markers show that.
        markers: usize,
        /// What was searched for.
        target: String,
    },
    /// The target's tags, with another border than is stated.
    #[error(
        "{markers} tags of the {target} are seen with a border of {}, but \"border_bits\": {stated} is stated: state {seen}, or leave it out",
        cells(*seen)
    )]
    OtherBorder {
        /// How many tags show that.
        markers: usize,
        /// The border that is seen, in cells.
        seen: u32,
        /// The border that is stated, in cells.
        stated: u32,
        /// What was searched for.
        target: String,
    },
    /// The mirror image of the target's markers.
    #[error(
        "{markers} markers of the {target} are seen in mirror image: disable image flipping in the camera or its driver"
    )]
    Mirrored {
        /// How many markers show that.
        markers: usize,
        /// What was searched for.
        target: String,
    },
    /// Another board with markers was recognized.
    #[error(
        "another board is in view, not the {target}: {seen}; specify that board, or show the specified one"
    )]
    Recognized {
        /// What is seen.
        seen: String,
        /// What was searched for.
        target: String,
    },
    /// Markers that fit two places equally.
    #[error(
        "{markers} markers of the {target} are seen, but the visible part fits two positions on the board: show more of its edges, or state its layout (\"legacy\": true or false)"
    )]
    TwoPlaces {
        /// How many markers show that.
        markers: usize,
        /// What was searched for.
        target: String,
    },
}

impl NoTarget {
    /// A short stable name for counters and events.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::ImageTooSmall { .. } => "image_too_small",
            Self::NoLattice { .. } => "no_lattice",
            Self::NoMarkers { .. } => "no_markers",
            Self::OtherBoard { .. } | Self::OtherBorder { .. } | Self::Recognized { .. } => {
                "other_board"
            }
            Self::Mirrored { .. } => "mirrored",
            Self::TwoPlaces { .. } => "two_places",
        }
    }
}

fn cells(count: u32) -> String {
    if count == 1 { "1 cell".to_owned() } else { format!("{count} cells") }
}
