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
        "{corners} crossings of black and white seen, but no lattice of them; is the {target} in view, flat and not too small?"
    )]
    NoLattice {
        /// How many crossings were seen.
        corners: usize,
        /// What was searched for.
        target: String,
    },
    /// A lattice whose cells show no marker of the target.
    #[error(
        "a lattice of {cols}x{rows} corners{} is seen, but its cells show no markers of the {target}: a plain chessboard, another dictionary or another board?",
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
        "a board with {markers} markers of the same dictionary is seen, but not in the places that the {target} has them: check its size, first_id and dictionary"
    )]
    OtherBoard {
        /// How many markers show that.
        markers: usize,
        /// What was searched for.
        target: String,
    },
    /// The mirror image of the target's markers.
    #[error(
        "{markers} markers of the {target} are seen in mirror image: have the camera or its driver not flip the image"
    )]
    Mirrored {
        /// How many markers show that.
        markers: usize,
        /// What was searched for.
        target: String,
    },
    /// Another board with markers was recognized.
    #[error(
        "another board than the {target} is seen: {seen}; give the target that is seen, or show the other"
    )]
    Recognized {
        /// What is seen.
        seen: String,
        /// What was searched for.
        target: String,
    },
    /// Markers that fit two places equally.
    #[error(
        "{markers} markers of the {target} are seen, but the part in view fits two places on it: show one of its ends, or state its layout (\"legacy\": true or false)"
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
            Self::OtherBoard { .. } | Self::Recognized { .. } => "other_board",
            Self::Mirrored { .. } => "mirrored",
            Self::TwoPlaces { .. } => "two_places",
        }
    }
}
