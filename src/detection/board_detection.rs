//! The detector's result: [`Detection`] or [`NoBoard`].

use crate::detection::coded::no_target::NoTarget;
use crate::geometry::board::BoardSize;
use crate::geometry::pixel::Pixel;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target};

/// A corner's place in the board's grid: `col` along a row, `row` down the columns, the first inner
/// corner at (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GridIndex {
    /// Along a row of `cols` corners.
    pub col: i32,
    /// Which row.
    pub row: i32,
}

/// One detected inner corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedCorner {
    /// Which corner of the board.
    pub index: GridIndex,
    /// Its position in the image.
    pub pixel: Pixel,
    /// Predicted standard deviation of `pixel`, per axis, in pixels: the weight of this corner is
    /// its inverse square.
    pub std_px: f64,
}

/// A detected board.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// The board searched for.
    pub board: BoardSize,
    /// The corners in row-major order of their indices; all `cols × rows` of them unless `partial`.
    pub corners: Vec<DetectedCorner>,
    /// Whether corners of the board are missing.
    pub partial: bool,
    /// Whether indices count from the board's first corner. False for a partial board of which too
    /// little is seen to know which part it is: then indices are relative, and may count from a
    /// corner that is not seen.
    pub position_known: bool,
    /// The orientation cannot be determined from any image of this board (`cols` + `rows` even):
    /// the first corner is the one nearest the image's top left.
    pub orientation_ambiguous: bool,
    /// Width of the blur at the board's edges, as a Gaussian's standard deviation in pixels.
    pub blur_px: f64,
    /// What the board's markers show; `None` for a plain chessboard.
    pub markers: Option<BoardMarkers>,
}

impl Detection {
    /// The ids of its corners on `target`, in their order; `None` where no markers identify them.
    pub fn corner_ids(&self, target: &Target) -> Option<Vec<u32>> {
        self.markers?;
        let id = |corner: &DetectedCorner| {
            target.corner_id(corner.index.col as u32, corner.index.row as u32)
        };
        Some(self.corners.iter().map(id).collect())
    }
}

/// What the markers of a board show besides the identity of corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardMarkers {
    /// Markers whose code was read and matches.
    pub read: usize,
    /// For a ChArUco board: it has the layout of OpenCV before 4.6; `None` where both layouts are
    /// the same.
    pub legacy: Option<bool>,
    /// For an AprilGrid: the width of the black border around a tag's payload, in cells.
    pub border_bits: Option<u32>,
    /// Black and white are exchanged.
    pub inverted: bool,
}

impl BoardMarkers {
    /// `target` with the print variant that the markers show.
    pub fn as_printed(&self, target: &Target) -> Target {
        match *target {
            Target::Chessboard(_) => *target,
            Target::Charuco(board) => {
                Target::Charuco(CharucoBoard { legacy: self.legacy.or(board.legacy), ..board })
            }
            Target::AprilGrid(grid) => {
                let border_bits = self.border_bits.or(grid.border_bits);
                Target::AprilGrid(AprilGrid { border_bits, ..grid })
            }
        }
    }
}

/// Why no board is reported.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoBoard {
    /// The image is too small for any board.
    #[error("the image of {width}x{height} pixels is too small to hold a {board} board")]
    ImageTooSmall {
        /// The image's width, in pixels.
        width: usize,
        /// The image's height, in pixels.
        height: usize,
        /// The board searched for.
        board: BoardSize,
    },
    /// Almost uniform brightness.
    #[error(
        "not enough contrast: brightness varies by {range} of 255; light the board, or check the lens cap and exposure"
    )]
    LowContrast {
        /// Range of brightness between the 1st and the 99th percentile.
        range: u8,
    },
    /// Edges are too blurred for corners.
    #[error(
        "too blurred: edges are {blur_px:.1} px wide; focus the lens, hold the board still or shorten the exposure"
    )]
    Blurred {
        /// Width of the edges, as a Gaussian's standard deviation in pixels.
        blur_px: f64,
    },
    /// No corner of any chessboard.
    #[error(
        "no chessboard corners seen; is the board in view, and not too small (a square needs about 6 px)?"
    )]
    NoCorners,
    /// Corners, but no grid.
    #[error("{corners} chessboard-like corners seen, but {}", largest_grid(*cols, *rows))]
    NoGrid {
        /// How many corners were detected.
        corners: usize,
        /// Width of the largest regular part, in corners; 0 if there is none.
        cols: u32,
        /// Height of the largest regular part, in corners; 0 if there is none.
        rows: u32,
    },
    /// A board, but not this one.
    #[error("a board of {cols}x{rows} is seen, not {board}{}", other_size(*cols, *rows, *board))]
    OtherSize {
        /// Corners along the longer side of the detected board.
        cols: u32,
        /// Corners along its other side.
        rows: u32,
        /// The board searched for.
        board: BoardSize,
    },
    /// No board with markers, or not this one.
    #[error(transparent)]
    Target(#[from] NoTarget),
    /// Part of the board, because the rest is beyond the image's border.
    #[error("cut off at the image border: {seen} of the {board} board's {} corners are visible; bring the whole board into view, or allow partial boards", board.corner_count())]
    CutOff {
        /// How many corners were seen.
        seen: usize,
        /// The board searched for.
        board: BoardSize,
    },
    /// Part of the board, where the whole was asked for.
    #[error("occluded: {seen} of the {board} board's {} corners are visible; uncover the board, or allow partial boards", board.corner_count())]
    Incomplete {
        /// How many corners were seen.
        seen: usize,
        /// The board searched for.
        board: BoardSize,
    },
}

impl NoBoard {
    /// All names that [`Self::kind`] returns.
    pub const KINDS: [&'static str; 13] = [
        "image_too_small",
        "low_contrast",
        "blurred",
        "no_corners",
        "no_grid",
        "other_size",
        "cut_off",
        "incomplete",
        "no_lattice",
        "no_markers",
        "other_board",
        "two_places",
        "mirrored",
    ];

    /// A short stable name for counters and events.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::ImageTooSmall { .. } => "image_too_small",
            Self::LowContrast { .. } => "low_contrast",
            Self::Blurred { .. } => "blurred",
            Self::NoCorners => "no_corners",
            Self::NoGrid { .. } => "no_grid",
            Self::OtherSize { .. } => "other_size",
            Self::Target(reason) => reason.kind(),
            Self::CutOff { .. } => "cut_off",
            Self::Incomplete { .. } => "incomplete",
        }
    }

    /// Whether a board other than the one asked for is in view, or a mirror image of this one.
    pub fn names_another(&self) -> bool {
        matches!(
            self,
            Self::OtherSize { .. }
                | Self::Target(
                    NoTarget::OtherBoard { .. }
                        | NoTarget::OtherBorder { .. }
                        | NoTarget::Recognized { .. }
                        | NoTarget::Mirrored { .. }
                )
        )
    }
}

/// What to do where a board of `cols` × `rows` is seen, and not `board`.
fn other_size(cols: u32, rows: u32, board: BoardSize) -> String {
    let squares = (board.cols.max(board.rows), board.cols.min(board.rows));
    if squares == (cols + 1, rows + 1) {
        let (cols, rows) = (board.cols - 1, board.rows - 1);
        format!(": it has {board} squares, but sizes count inner corners; give {cols}x{rows}")
    } else {
        "; count the inner corners, or give the size that is seen".to_owned()
    }
}

fn largest_grid(cols: u32, rows: u32) -> String {
    match (cols, rows) {
        (0, _) | (_, 0) => {
            "they form no grid: is a chessboard in view, flat and not too small?".to_owned()
        }
        _ => {
            format!(
                "the largest grid is {cols}x{rows}; show more of the board, nearer and in even light"
            )
        }
    }
}

/// Options of the detector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DetectOptions {
    /// Report part of a board where the whole is not visible. Default: false.
    pub allow_partial: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_counted_in_squares_is_named() {
        let message = |cols, rows| {
            let board = BoardSize { cols, rows };
            NoBoard::OtherSize { cols: 9, rows: 6, board }.to_string()
        };
        for (cols, rows, expected) in [
            (10, 7, "not 10x7: it has 10x7 squares, but sizes count inner corners; give 9x6"),
            (7, 10, "not 7x10: it has 7x10 squares, but sizes count inner corners; give 6x9"),
            (9, 7, "not 9x7; count the inner corners, or give the size that is seen"),
        ] {
            assert_eq!(message(cols, rows), format!("a board of 9x6 is seen, {expected}"));
        }
    }

    #[test]
    fn no_grid_and_a_small_grid_have_different_messages() {
        let message = |cols, rows| NoBoard::NoGrid { corners: 57, cols, rows }.to_string();
        assert!(
            message(0, 0).starts_with("57 chessboard-like corners seen, but they form no grid"),
            "{}",
            message(0, 0)
        );
        assert!(message(4, 3).contains("the largest grid is 4x3"), "{}", message(4, 3));
    }
}
