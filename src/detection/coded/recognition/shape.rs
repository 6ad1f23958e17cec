//! How many columns and rows a board has whose markers are numbered row by row.

use crate::detection::coded::recognition::cells::{MarkedCell, SeenMarkers};
use crate::detection::coded::recognition::codes;
use crate::detection::grid::Grid;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target};

/// Any side of a square or tag: an image does not show lengths.
pub(super) const ANY_SIDE_M: f64 = 0.025;

/// Boards that have the markers of `seen` where the lattice `grid` has them, the likeliest first.
pub(super) fn charuco_boards(seen: &SeenMarkers, grid: &Grid) -> Vec<Target> {
    let (Some(cols), Some(lines)) = (row_length(&seen.cells, 2, 1), lines(seen, grid)) else {
        return Vec::new();
    };
    let [_, down] = lines;
    let sizes = [1, 2, 0].map(|more| down.1 - down.0 + 1 + more);
    let mut boards = Vec::new();
    for rows in sizes.into_iter().filter_map(|rows| u32::try_from(rows).ok()) {
        let mut board = CharucoBoard {
            cols,
            rows,
            square_m: ANY_SIDE_M,
            marker_m: ANY_SIDE_M * f64::from(seen.payload.ratio),
            dictionary: seen.dictionary,
            first_id: 0,
            legacy: None,
        };
        let firsts = firsts_of_charuco(seen, &board, lines);
        // Either the first rows are not seen, or the board starts with another marker than 0.
        let above = firsts.iter().map(|&first| (0, rows + first * 2 / cols.max(1)));
        let from = firsts.iter().map(|&first| (first, rows));
        for (first_id, rows) in std::iter::once((0, rows)).chain(above).chain(from) {
            let last = first_id + (cols * rows).div_ceil(2) - 1;
            board = CharucoBoard {
                rows,
                first_id,
                dictionary: codes::smallest(seen.dictionary, last),
                ..board
            };
            if board.check().is_ok() && !boards.contains(&Target::Charuco(board)) {
                boards.push(Target::Charuco(board));
            }
        }
    }
    boards
}

/// The first markers of boards of this size whose first corner is the lattice's, in both layouts.
fn firsts_of_charuco(
    seen: &SeenMarkers,
    board: &CharucoBoard,
    [across, down]: [(i32, i32); 2],
) -> Vec<u32> {
    let Some(cell) = seen.cells.first() else { return Vec::new() };
    let square = (cell.at.0 - across.0 + 1, cell.at.1 - down.0 + 1);
    let at = |markers: Vec<(u32, u32)>| {
        let index = markers.iter().position(|&(col, row)| (col as i32, row as i32) == square)?;
        cell.marker.checked_sub(index as u32)
    };
    [false, true].into_iter().filter_map(|legacy| at(board.markers(legacy))).collect()
}

/// The same of grids of tags with such a gap between them.
pub(super) fn april_grids(seen: &SeenMarkers, grid: &Grid, spacing: f64) -> Vec<Target> {
    let (Some(cols), Some(lines)) = (row_length(&seen.cells, 2, -1), lines(seen, grid)) else {
        return Vec::new();
    };
    let [across, down] = lines;
    // Tags begin on even lines of the lattice, counted in the grid.
    let low = seen.cells.iter().map(|cell| cell.at.1).max().unwrap_or(down.1);
    let left = seen.cells.iter().map(|cell| cell.at.0).min().unwrap_or(across.0);
    let corner = seen.cells.iter().find(|cell| cell.at.1 == low);
    let first = corner.map_or(0, |cell| i64::from(cell.marker) - i64::from((cell.at.0 - left) / 2));
    let rows = [0, 1].map(|more| (down.1 - down.0 + 1) / 2 + more);
    let mut grids = Vec::new();
    for rows in rows.into_iter().filter_map(|rows| u32::try_from(rows).ok()) {
        for first_id in [Some(0), u32::try_from(first).ok()].into_iter().flatten() {
            let grid = AprilGrid {
                cols,
                rows,
                tag_m: ANY_SIDE_M,
                spacing,
                family: seen.dictionary,
                border_bits: Some(seen.payload.border),
                first_id,
            };
            if grid.check().is_ok() && !grids.contains(&Target::AprilGrid(grid)) {
                grids.push(Target::AprilGrid(grid));
            }
        }
    }
    grids
}

/// By how much the numbers of markers differ from one row to the one `step.0` cells on, if they
/// rise by one along a row; of rows numbered upward `step.1` is −1.
fn row_length(cells: &[MarkedCell], step: i32, upward: i64) -> Option<u32> {
    let mut lengths: Vec<i64> = Vec::new();
    for cell in cells {
        for other in cells {
            if (other.at.0 - cell.at.0, other.at.1 - cell.at.1) == (0, step) {
                lengths.push((i64::from(other.marker) - i64::from(cell.marker)) * upward);
            }
        }
    }
    let count = |length: i64| lengths.iter().filter(|&&other| other == length).count();
    let likeliest = lengths.iter().copied().max_by_key(|&length| (count(length), -length))?;
    // Two loose copies of one marker differ by nothing.
    let length = u32::try_from(likeliest).ok().filter(|&length| length > 0)?;
    (2 * count(likeliest) > lengths.len()).then_some(length)
}

/// The first and last column and row of crossings, in the board's rotation.
fn lines(seen: &SeenMarkers, grid: &Grid) -> Option<[(i32, i32); 2]> {
    let bounds = grid.anchored_bounds()?;
    let (a, b) = (
        seen.placement.in_board(bounds.i.0, bounds.j.0),
        seen.placement.in_board(bounds.i.1, bounds.j.1),
    );
    Some([(a.0.min(b.0), a.0.max(b.0)), (a.1.min(b.1), a.1.max(b.1))])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(markers: &[((i32, i32), u32)]) -> Vec<MarkedCell> {
        markers.iter().map(|&(at, marker)| MarkedCell { at, marker }).collect()
    }

    #[test]
    fn numbers_rise_by_the_length_of_a_row() {
        let board = cells(&[((0, 0), 3), ((2, 0), 4), ((0, 2), 10), ((2, 2), 11), ((4, 0), 17)]);
        assert_eq!(row_length(&board, 2, 1), Some(7));
        assert_eq!(row_length(&board, 2, -1), None);
    }

    #[test]
    fn copies_of_one_marker_have_no_row_length() {
        assert_eq!(row_length(&cells(&[((0, 0), 5), ((0, 2), 5)]), 2, 1), None);
        assert_eq!(row_length(&cells(&[((0, 0), 5)]), 2, 1), None);
        assert_eq!(row_length(&[], 2, 1), None);
    }
}
