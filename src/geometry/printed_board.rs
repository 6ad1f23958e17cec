//! The print of a target: rectangles of black and white on a sheet, in meters, and the position of
//! each corner on it.
//!
//! Sheet frame: origin at the print's upper left corner, x right, y down.

use nalgebra::Point2;

use crate::geometry::dictionary::Dictionary;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target};

/// A rectangle of one color.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrintedRect {
    /// Its left edge, in meters.
    pub x: f64,
    /// Its upper edge.
    pub y: f64,
    /// Its width.
    pub width: f64,
    /// Its height.
    pub height: f64,
    /// White, else black.
    pub white: bool,
}

/// A target as printed on white paper.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintedBoard {
    /// Width of the print, in meters.
    pub width_m: f64,
    /// Its height.
    pub height_m: f64,
    /// The printed rectangles, in order: later ones cover earlier ones.
    pub rects: Vec<PrintedRect>,
    /// The origin of the board frame on the sheet.
    origin: Point2<f64>,
    /// Whether the board frame's y axis points up the sheet.
    upward: bool,
}

impl PrintedBoard {
    /// The print of `target`. Unless the target states otherwise, a ChArUco board has the new
    /// layout and an AprilGrid has Kalibr's border of 2 cells.
    pub fn of(target: &Target) -> Self {
        match target {
            Target::Chessboard(board) => {
                let (cols, rows) = (board.size.cols + 1, board.size.rows + 1);
                let mut print = Self::empty(cols, rows, board.square_m);
                print.squares(cols, rows, board.square_m, |col, row| (col + row) % 2 == 0);
                print.origin = Point2::new(board.square_m, board.square_m);
                print
            }
            Target::Charuco(board) => Self::of_charuco(board),
            Target::AprilGrid(grid) => Self::of_april_grid(grid),
        }
    }

    /// The position on the sheet of the corner `id` of `target`, of which this is the print.
    pub fn corner(&self, target: &Target, id: u32) -> Option<Point2<f64>> {
        let corner = target.corner_in_board(id)?;
        let up = if self.upward { -1.0 } else { 1.0 };
        Some(Point2::new(self.origin.x + corner.x, self.origin.y + up * corner.y))
    }

    /// Whether the sheet is white at (`x`, `y`).
    pub fn is_white(&self, x: f64, y: f64) -> bool {
        let holds = |rect: &&PrintedRect| {
            (rect.x..rect.x + rect.width).contains(&x)
                && (rect.y..rect.y + rect.height).contains(&y)
        };
        self.rects.iter().rev().find(holds).is_none_or(|rect| rect.white)
    }

    fn empty(cols: u32, rows: u32, square_m: f64) -> Self {
        Self {
            width_m: f64::from(cols) * square_m,
            height_m: f64::from(rows) * square_m,
            rects: Vec::new(),
            origin: Point2::origin(),
            upward: false,
        }
    }

    fn square(&mut self, x: f64, y: f64, side: f64, white: bool) {
        self.rects.push(PrintedRect { x, y, width: side, height: side, white });
    }

    fn squares(&mut self, cols: u32, rows: u32, side: f64, black: impl Fn(u32, u32) -> bool) {
        for row in 0..rows {
            for col in (0..cols).filter(|&col| black(col, row)) {
                self.square(f64::from(col) * side, f64::from(row) * side, side, false);
            }
        }
    }

    fn marker(&mut self, marker: &PrintedMarker<'_>) {
        let PrintedMarker { x, y, side, dictionary, id, border, upside_down } = *marker;
        let bits = dictionary.bits();
        let cell = side / (bits + 2 * border) as f64;
        self.square(x, y, side, false);
        for row in 0..bits {
            for col in 0..bits {
                let (r, c) =
                    if upside_down { (bits - 1 - row, bits - 1 - col) } else { (row, col) };
                if dictionary.is_white(id, r, c) == Some(true) {
                    let at = |k: usize| (k + border) as f64 * cell;
                    self.square(x + at(col), y + at(row), cell, true);
                }
            }
        }
    }

    fn of_charuco(board: &CharucoBoard) -> Self {
        let CharucoBoard { cols, rows, square_m, marker_m, dictionary, first_id, legacy } = *board;
        let marked = board.markers(legacy.unwrap_or(false));
        let mut print = Self::empty(cols, rows, square_m);
        let first = marked.first().map_or(0, |(col, row)| (col + row) % 2);
        print.squares(cols, rows, square_m, |col, row| (col + row) % 2 != first);
        let margin = (square_m - marker_m) / 2.0;
        for (k, (col, row)) in marked.into_iter().enumerate() {
            let at = |k: u32| f64::from(k) * square_m + margin;
            print.marker(&PrintedMarker {
                x: at(col),
                y: at(row),
                side: marker_m,
                dictionary: &dictionary,
                id: first_id as usize + k,
                border: 1,
                upside_down: false,
            });
        }
        print
    }

    fn of_april_grid(grid: &AprilGrid) -> Self {
        let AprilGrid { cols, rows, tag_m, spacing, family, border_bits, first_id } = *grid;
        let gap = tag_m * spacing;
        let pitch = tag_m + gap;
        let border = border_bits.unwrap_or(2) as usize;
        let mut print = Self::empty(0, 0, 1.0);
        (print.width_m, print.height_m) =
            (f64::from(cols) * pitch + gap, f64::from(rows) * pitch + gap);
        for row in 0..=rows {
            for col in 0..=cols {
                print.square(f64::from(col) * pitch, f64::from(row) * pitch, gap, false);
            }
        }
        for row in 0..rows {
            for col in 0..cols {
                // Numbered from the lowest row.
                let id = first_id as usize + ((rows - 1 - row) * cols + col) as usize;
                let at = |k: u32| f64::from(k) * pitch + gap;
                print.marker(&PrintedMarker {
                    x: at(col),
                    y: at(row),
                    side: tag_m,
                    dictionary: &family,
                    id,
                    border,
                    upside_down: true,
                });
            }
        }
        print.origin = Point2::new(gap, print.height_m - gap);
        print.upward = true;
        print
    }
}

/// A marker of a print.
struct PrintedMarker<'a> {
    /// Its upper left corner, in meters.
    x: f64,
    y: f64,
    /// Its side in meters, including the border.
    side: f64,
    dictionary: &'a Dictionary,
    id: usize,
    /// The width of its black border, in bits.
    border: usize,
    upside_down: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::target::chessboard;

    #[test]
    fn a_corner_of_the_print_has_four_colors_about_it() {
        let family = Dictionary::named("tag36h11").expect("a family");
        let dictionary = Dictionary::named("DICT_5X5_100").expect("a dictionary");
        let grid = AprilGrid {
            cols: 3,
            rows: 2,
            tag_m: 0.05,
            spacing: 0.25,
            family,
            border_bits: None,
            first_id: 7,
        };
        let board = CharucoBoard {
            cols: 6,
            rows: 4,
            square_m: 0.03,
            marker_m: 0.02,
            dictionary,
            first_id: 0,
            legacy: Some(true),
        };
        let targets = [
            chessboard(5, 4, 0.03).expect("a board"),
            Target::Charuco(board),
            Target::AprilGrid(grid),
        ];
        for target in targets {
            let print = PrintedBoard::of(&target);
            let corners: Vec<Point2<f64>> =
                (0..200).filter_map(|id| print.corner(&target, id)).collect();
            assert_eq!(corners.len(), target.corner_count());
            for p in corners {
                let at = |x: f64, y: f64| print.is_white(p.x + 0.002 * x, p.y + 0.002 * y);
                let around = [at(1.0, 1.0), at(-1.0, 1.0), at(-1.0, -1.0), at(1.0, -1.0)];
                assert!(around[0] == around[2] && around[1] == around[3], "{p} {around:?}");
                assert_ne!(around[0], around[1], "{p}");
            }
        }
    }
}
