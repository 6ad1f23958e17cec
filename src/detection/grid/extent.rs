//! Compares the extent of a grid with the board searched for.

use crate::detection::grid::{Bounds, Grid};
use crate::detection::thresholds::chessboard::SearchThresholds;
use crate::geometry::board::BoardSize;

/// Corners along the longer side.
pub(in crate::detection) fn longer(bounds: Bounds) -> u32 {
    bounds.width().max(bounds.height()) as u32
}

/// Corners along the shorter side.
pub(in crate::detection) fn shorter(bounds: Bounds) -> u32 {
    bounds.width().min(bounds.height()) as u32
}

/// Whether `bounds` are as long and as wide as `board`.
pub(in crate::detection) fn has_shape(bounds: Bounds, board: BoardSize) -> bool {
    let (cols, rows) = (board.cols as i32, board.rows as i32);
    let shape = (bounds.width(), bounds.height());
    shape == (cols, rows) || shape == (rows, cols)
}

/// Whether `grid` is the whole of `board`: every corner, in its shape.
pub(in crate::detection) fn is_whole(grid: &Grid, board: BoardSize) -> bool {
    grid.members.len() == board.corner_count()
        && grid.bounds().is_some_and(|bounds| has_shape(bounds, board))
}

/// Whether a grid is larger than `board`, one spurious line allowed on each side.
pub(in crate::detection) fn exceeds(bounds: Bounds, board: BoardSize) -> bool {
    longer(bounds) > board.cols.max(board.rows) + 2
        || shorter(bounds) > board.cols.min(board.rows) + 2
}

/// One more than the number of corners of the largest grid of `board`, with one spurious line on
/// each side.
pub(in crate::detection) fn most_corners(board: BoardSize) -> usize {
    (board.cols as usize + 2) * (board.rows as usize + 2) + 1
}

/// Least corners of a partial board: fewer could be any board, also a small one cropped by the
/// image border.
pub(in crate::detection) fn least_part(board: BoardSize, thresholds: &SearchThresholds) -> usize {
    let least = thresholds.least_part;
    least.max((board.corner_count() * 2 / 5).min(2 * least))
}
