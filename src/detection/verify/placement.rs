//! The placement of the board in a grid, with its orientation: the canonical order of corners.
//!
//! Columns and rows of the board run from +x to +y like the grid's i and j, because a camera sees
//! the board's front; so the placement is one of four quarter turns and an offset. The polarity of
//! squares, the visible ends and the number of corners determine it, or show that it is ambiguous.

use crate::detection::grid::{Bounds, Grid};
use crate::detection::vec2::Vec2;
use crate::geometry::board::BoardSize;

/// Which sides of a grid are the ends of the board, in the order least i, most i, least j, most j.
pub(in crate::detection) type Ends = [bool; 4];

/// How a board's columns and rows lie in a grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::detection) struct BoardPlacement {
    /// The grid's (i, j) of the board's first corner.
    pub first: (i32, i32),
    /// Quarter turns from i to the direction of columns, in the sense from i to j.
    pub quarter_turns: u8,
    /// Whether no other position in the board is possible.
    pub known: bool,
}

impl BoardPlacement {
    /// The grid's index of the board's corner (`col`, `row`).
    pub(in crate::detection) fn in_grid(&self, col: i32, row: i32) -> (i32, i32) {
        let (i, j) = self.first;
        match self.quarter_turns {
            0 => (i + col, j + row),
            1 => (i - row, j + col),
            2 => (i - col, j - row),
            _ => (i + row, j - col),
        }
    }

    /// The board's (col, row) of the grid's corner (i, j).
    pub(in crate::detection) fn in_board(&self, i: i32, j: i32) -> (i32, i32) {
        let (di, dj) = (i - self.first.0, j - self.first.1);
        match self.quarter_turns {
            0 => (di, dj),
            1 => (dj, -di),
            2 => (-di, -dj),
            _ => (-dj, di),
        }
    }
}

/// A rectangle of the grid that could be the whole board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Rectangle {
    i: i32,
    j: i32,
    width: i32,
    height: i32,
}

/// Places `board` over `grid`, whose corners lie within `bounds` and whose sides at `ends` are the
/// board's own. `None` if the board cannot lie there.
pub(in crate::detection) fn place(
    grid: &Grid,
    bounds: Bounds,
    ends: Ends,
    board: BoardSize,
) -> Option<BoardPlacement> {
    let (cols, rows) = (board.cols as i32, board.rows as i32);
    let shapes = [(cols, rows), (rows, cols)];
    let mut chosen: Option<Rectangle> = None;
    let mut frames = 0;
    for &(width, height) in &shapes[..if cols == rows { 1 } else { 2 }] {
        for j in starts(bounds.j, height, [ends[2], ends[3]]) {
            for i in starts(bounds.i, width, [ends[0], ends[1]]) {
                chosen.get_or_insert(Rectangle { i, j, width, height });
                frames += 1;
            }
        }
    }
    let frame = chosen?;
    let (first, quarter_turns) = first_corner(grid, frame, board)?;
    Some(BoardPlacement { first, quarter_turns, known: frames == 1 })
}

/// The starts, along one axis, of a board of `length` corners that covers `least` to `most` and
/// ends at the visible ends.
fn starts(
    (least, most): (i32, i32),
    length: i32,
    [ends_low, ends_high]: [bool; 2],
) -> std::ops::RangeInclusive<i32> {
    let lowest = if ends_low { least } else { most - length + 1 };
    let highest = if ends_high { most - length + 1 } else { least };
    lowest.max(most - length + 1)..=highest.min(least)
}

/// The first corner and the direction of columns: the one whose outer diagonal square is dark, if
/// that is unique; else the corner nearest the image's top left.
fn first_corner(grid: &Grid, frame: Rectangle, board: BoardSize) -> Option<((i32, i32), u8)> {
    let Rectangle { i, j, width, height } = frame;
    let corners =
        [(i, j), (i + width - 1, j), (i + width - 1, j + height - 1), (i, j + height - 1)];
    let outer_squares = [
        (i - 1, j - 1),
        (i + width - 1, j - 1),
        (i + width - 1, j + height - 1),
        (i - 1, j + height - 1),
    ];
    // At corner 0 columns run along +i, without a rotation, at corner 1 with one quarter turn, and
    // so on.
    let upright = (board.cols as i32, board.rows as i32) == (width, height);
    let fits = |quarter_turns: usize| {
        board.cols == board.rows || quarter_turns.is_multiple_of(2) == upright
    };
    let choices = (0..4).filter(|&quarter_turns| fits(quarter_turns));
    if !board.orientation_ambiguous() {
        let dark = |&quarter_turns: &usize| {
            grid.polarity(outer_squares[quarter_turns].0, outer_squares[quarter_turns].1) < 0.0
        };
        return choices
            .filter(dark)
            .map(|quarter_turns| (corners[quarter_turns], quarter_turns as u8))
            .next();
    }
    let distance = |quarter_turns: usize| {
        let p = estimate(grid, corners[quarter_turns].0, corners[quarter_turns].1)
            .map_or(f32::MAX, |p| p.norm_squared());
        (p, quarter_turns)
    };
    let best = choices.map(distance).min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((corners[best.1], best.1 as u8))
}

/// Position of the corner (i, j), extrapolated if it is missing.
fn estimate(grid: &Grid, i: i32, j: i32) -> Option<Vec2> {
    if let Some(p) = grid.pixel(i, j) {
        return Some(p);
    }
    let away = |&(mi, mj): &(i32, i32)| (mi - i).abs() + (mj - j).abs();
    let &(ni, nj) = grid.members.iter().min_by_key(|member| away(member))?;
    let [u, v] = grid.steps(ni, nj)?;
    Some(grid.pixel(ni, nj)? + u * (i - ni) as f32 + v * (j - nj) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::grid::Node;

    /// A grid of `width` × `height` corners rotated by `quarter_turns` quarter turns in the image,
    /// square (0, 0) bright or not.
    fn grid(width: i32, height: i32, quarter_turns: i32, bright: bool) -> Grid {
        let mut grid = Grid::default();
        grid.clear(20, bright);
        let (c, s) = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][quarter_turns as usize];
        for (i, j) in (0..height).flat_map(|j| (0..width).map(move |i| (i, j))) {
            let (x, y) = (20.0 * i as f32, 20.0 * j as f32);
            let pixel = Vec2::new(300.0 + c * x - s * y, 300.0 + s * x + c * y);
            grid.set(
                i,
                j,
                Node { pixel, contrast: 100.0, near_contrast: 90.0, score: 1.0, tight: false },
            );
        }
        grid
    }

    fn placed(grid: &Grid, ends: Ends, board: &str) -> Option<BoardPlacement> {
        place(grid, grid.bounds().expect("corners"), ends, board.parse().expect("a size"))
    }

    #[test]
    fn the_outer_diagonal_square_of_the_first_corner_is_dark() {
        for bright in [false, true] {
            for (width, height) in [(9, 6), (6, 9)] {
                let placement =
                    placed(&grid(width, height, 0, bright), [false; 4], "9x6").expect("it fits");
                assert!(placement.known);
                let (i, j) = placement.in_grid(-1, -1);
                // Of two diagonal neighbors, in_grid gives the corner; its outer square lies
                // between it and the first.
                let square = (i.min(placement.first.0), j.min(placement.first.1));
                assert_eq!((square.0 + square.1) % 2 == 0, !bright);
                let last = placement.in_grid(8, 5);
                assert!((0..width).contains(&last.0) && (0..height).contains(&last.1));
                assert_eq!(placement.in_board(last.0, last.1), (8, 5));
            }
        }
    }

    #[test]
    fn an_ambiguous_board_starts_nearest_the_top_left() {
        for (board, width, height) in [("7x5", 7, 5), ("7x5", 5, 7), ("4x4", 4, 4)] {
            for quarter_turns in 0..4 {
                let grid = grid(width, height, quarter_turns, true);
                let placement = placed(&grid, [false; 4], board).expect("it fits");
                let first = grid.pixel(placement.first.0, placement.first.1).expect("a corner");
                let size: BoardSize = board.parse().expect("a size");
                let (c, r) = (size.cols as i32 - 1, size.rows as i32 - 1);
                let opposite = placement.in_grid(c, r);
                let last = grid.pixel(opposite.0, opposite.1).expect("a corner");
                assert!(first.norm() < last.norm());
            }
        }
    }

    #[test]
    fn a_part_is_placed_as_far_as_its_ends_determine() {
        let part = grid(7, 6, 0, true);
        let at = |ends| placed(&part, ends, "9x6");
        assert!(!at([false; 4]).expect("it fits").known);
        let left = at([true, false, false, false]).expect("it fits");
        assert!(left.known);
        let right = at([false, true, false, false]).expect("it fits");
        assert!(right.known && right != left);
        assert_eq!(at([true, true, false, false]), None, "a board of 7 columns");
        assert_eq!(
            placed(&grid(7, 7, 0, true), [false; 4], "9x6"),
            None,
            "more rows than the board has"
        );
    }
}
