//! The target that an image shows, where none was named.

use serde::Serialize;
use utoipa::ToSchema;

use crate::detection::target_in_view::TargetInView;
use crate::geometry::target::Target;

/// Why no target is named.
const NOTHING: &str = "no ChArUco board, AprilGrid or chessboard recognized; show most of it (all of a chessboard, with its white border), flat and not too small";

/// What is recognized in an image.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TargetInViewDocument {
    /// A target is recognized.
    pub found: bool,
    /// What can be read of it; null where nothing is recognized.
    pub target: Option<RecognizedTarget>,
    /// The target in words; null where nothing is recognized.
    pub name: Option<String>,
    /// Corners that are seen.
    pub corners: usize,
    /// Some of the board is not seen.
    pub partial: bool,
    /// Black and white are inverted.
    pub inverted: bool,
    /// Why nothing is recognized; else null.
    pub reason: Option<String>,
}

/// A target without its lengths, which an image does not show.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum RecognizedTarget {
    /// A plain chessboard.
    Chessboard {
        /// Inner corners along its longer side.
        cols: u32,
        /// Inner corners along its shorter side.
        rows: u32,
    },
    /// A chessboard with ArUco markers.
    Charuco {
        /// Squares in a row.
        cols: u32,
        /// Rows of squares.
        rows: u32,
        /// OpenCV's name of the dictionary.
        dictionary: &'static str,
        /// The lowest marker's number.
        first_id: u32,
        /// Of a board with an even number of rows: it has the layout of OpenCV before 4.6.
        legacy: Option<bool>,
        /// `marker_m` over `square_m`.
        marker_ratio: f64,
    },
    /// A grid of tags as Kalibr prints it.
    AprilGrid {
        /// Tags in a row.
        cols: u32,
        /// Rows of tags.
        rows: u32,
        /// The tags' family.
        family: &'static str,
        /// The lowest tag's number.
        first_id: u32,
        /// Cells of black around a tag's payload.
        border_bits: Option<u32>,
        /// The gap between two tags, in parts of a tag's side.
        spacing: f64,
    },
}

impl RecognizedTarget {
    fn of(target: &Target) -> Self {
        let hundredths = |ratio: f64| (ratio * 100.0).round() / 100.0;
        match target {
            Target::Chessboard(board) => {
                Self::Chessboard { cols: board.size.cols, rows: board.size.rows }
            }
            Target::Charuco(board) => Self::Charuco {
                cols: board.cols,
                rows: board.rows,
                dictionary: board.dictionary.name(),
                first_id: board.first_id,
                legacy: board.legacy,
                marker_ratio: hundredths(board.marker_m / board.square_m),
            },
            Target::AprilGrid(grid) => Self::AprilGrid {
                cols: grid.cols,
                rows: grid.rows,
                family: grid.family.family().unwrap_or(grid.family.name()),
                first_id: grid.first_id,
                border_bits: grid.border_bits,
                spacing: hundredths(grid.spacing),
            },
        }
    }
}

impl From<Option<&TargetInView>> for TargetInViewDocument {
    fn from(seen: Option<&TargetInView>) -> Self {
        let Some(seen) = seen else {
            return Self {
                found: false,
                target: None,
                name: None,
                corners: 0,
                partial: false,
                inverted: false,
                reason: Some(NOTHING.to_owned()),
            };
        };
        let (target, corners, partial, inverted) = match seen {
            TargetInView::WithMarkers(board) => (
                RecognizedTarget::of(&board.target),
                board.detection.corners.len(),
                board.detection.partial,
                board.detection.markers.inverted,
            ),
            TargetInView::Chessboard(found) => {
                let (cols, rows) = (found.board.cols, found.board.rows);
                (RecognizedTarget::Chessboard { cols, rows }, found.corners.len(), false, false)
            }
        };
        Self {
            found: true,
            target: Some(target),
            name: Some(seen.to_string()),
            corners,
            partial,
            inverted,
            reason: None,
        }
    }
}
