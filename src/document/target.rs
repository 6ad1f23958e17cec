//! The board that is looked for.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::error::DocumentError;
use crate::geometry::board::{BoardError, BoardSize, Chessboard};

/// What kind of target it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TargetKind {
    /// A plain chessboard.
    Chessboard,
}

/// A calibration target. There is no default: count the inner corners and measure a square.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetDocument {
    /// Its kind.
    pub kind: TargetKind,
    /// Inner corners along a row, 3 to 100.
    pub cols: u32,
    /// Rows of inner corners, 3 to 100.
    pub rows: u32,
    /// The side of one square, in meters.
    pub square_m: f64,
}

impl From<Chessboard> for TargetDocument {
    fn from(board: Chessboard) -> Self {
        let Chessboard { size, square_m } = board;
        Self { kind: TargetKind::Chessboard, cols: size.cols, rows: size.rows, square_m }
    }
}

impl TryFrom<TargetDocument> for Chessboard {
    type Error = DocumentError;
    fn try_from(document: TargetDocument) -> Result<Self, DocumentError> {
        let TargetDocument { kind: TargetKind::Chessboard, cols, rows, square_m } = document;
        let named = |error: BoardError| {
            let field = match error {
                BoardError::Size { cols, .. } if !(3..=100).contains(&cols) => "cols",
                BoardError::Size { .. } | BoardError::Malformed { .. } => "rows",
                BoardError::Square { .. } => "square_m",
            };
            DocumentError::field(field, error.to_string())
        };
        let size = BoardSize::new(cols, rows).map_err(named)?;
        Self::new(size, square_m).map_err(named)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_boards_are_refused_by_field() {
        for (cols, rows, square_m, field) in [
            (2, 6, 0.03, "cols"),
            (9, 2, 0.03, "rows"),
            (9, 6, 0.0, "square_m"),
            (9, 101, 0.03, "rows"),
        ] {
            let document = TargetDocument { kind: TargetKind::Chessboard, cols, rows, square_m };
            assert_eq!(Chessboard::try_from(document).unwrap_err().path(), Some(field));
        }
    }
}
