//! What a target prints, in the sheet's own frame: lines of crossings, with x to the right and y
//! down from the upper left one, and the cells between them.

use crate::detection::coded::code_columns::CodeColumns;
use crate::geometry::dictionary::Dictionary;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target};

/// The positions at which a cell of a marker's code is sampled, as fractions of its sides.
pub(super) const IN_CODE_CELL: [(f32, f32); 4] =
    [(0.35, 0.5), (0.65, 0.5), (0.5, 0.35), (0.5, 0.65)];

/// One way in which a target may be printed.
#[derive(Debug, Clone)]
pub(super) struct Sheet {
    /// The number of lines of crossings across and down.
    pub lines: [i32; 2],
    /// The marker in each cell, row by row from cell (−1, −1).
    markers: Vec<Option<u32>>,
    /// The number of markers.
    pub count: usize,
    /// The start of a marker's payload in its cell, as a fraction of the cell's side.
    pub inset: f32,
    /// The mean correlation with their codes of markers that are printed in another way but read in
    /// this one.
    pub mistaken: f32,
    /// The layout of a ChArUco board.
    pub legacy: Option<bool>,
    /// The border of an AprilGrid's tags.
    pub border_bits: Option<u32>,
}

/// All ways in which a target may be printed, and what they share.
#[derive(Debug, Clone)]
pub(super) struct Sheets {
    /// The ways.
    pub ways: Vec<Sheet>,
    /// So many of them, the first ones, are as the target is stated to be. The others are read only
    /// to report that it is not.
    pub stated: usize,
    /// Widths of the intervals between lines, those after even lines and those after odd ones, in
    /// units of the first.
    pub widths: [f32; 2],
    /// Cells along a payload's side.
    pub bits: usize,
    /// Whether markers are in bright cells (on a board that is not inverted).
    pub in_bright: bool,
    /// How far a crossing is undisturbed by other edges, in units of the lattice.
    pub room: f32,
    /// The start of a marker in its cell, as a fraction of the cell's side.
    pub margin: f32,
    /// The codes as zero-mean unit vectors over the payload in the grid's own axes, for each marker
    /// and quarter turn.
    pub codes: Vec<f32>,
    /// The same, arranged by payload cell.
    pub columns: CodeColumns,
}

impl Sheet {
    /// The correlation of a label's cells from which on no other way can have printed them: halfway
    /// between mistaken markers and perfect ones.
    pub(super) fn certain(&self) -> f32 {
        (1.0 + self.mistaken) / 2.0
    }

    /// The least ratio of the correlations of cells with their codes, read in this way and in the
    /// `other`, from which on this one is how they are printed: cells read in the wrong way have
    /// `mistaken` of the right one's correlation, so the ratio is halfway (geometrically) between
    /// what either print would give.
    pub(super) fn least_ratio(&self, other: &Self) -> f32 {
        (self.mistaken / other.mistaken.max(f32::EPSILON)).max(0.0).sqrt()
    }

    /// The marker in a cell.
    pub(super) fn marker(&self, col: i32, row: i32) -> Option<u32> {
        let across = self.lines[0] + 1;
        let inside = (-1..self.lines[0]).contains(&col) && (-1..self.lines[1]).contains(&row);
        inside.then(|| self.markers[((row + 1) * across + col + 1) as usize]).flatten()
    }

    fn of(lines: [i32; 2], inset: f32, cells: impl Iterator<Item = (i32, i32)>) -> Self {
        let across = lines[0] + 1;
        let mut markers = vec![None; (across * (lines[1] + 1)) as usize];
        let mut count = 0;
        for (col, row) in cells {
            markers[((row + 1) * across + col + 1) as usize] = Some(count as u32);
            count += 1;
        }
        Self { lines, markers, count, inset, mistaken: 0.0, legacy: None, border_bits: None }
    }
}

impl Sheets {
    /// The ways in which `target` may be printed; `None` for a target without markers.
    pub(super) fn of(target: &Target) -> Option<Self> {
        match target {
            Target::Chessboard(_) => None,
            Target::Charuco(board) => Some(Self::of_charuco(board)),
            Target::AprilGrid(grid) => Some(Self::of_april_grid(grid)),
        }
    }

    fn of_charuco(board: &CharucoBoard) -> Self {
        let ratio = (board.marker_m / board.square_m) as f32;
        let bits = board.dictionary.bits();
        let inset = charuco_inset(ratio, bits);
        let lines = [board.cols as i32 - 1, board.rows as i32 - 1];
        let way = |legacy| {
            let squares = board.markers(legacy).into_iter();
            let cells = squares.map(|(col, row)| (col as i32 - 1, row as i32 - 1));
            Sheet { legacy: Some(legacy), ..Sheet::of(lines, inset, cells) }
        };
        let alike = !board.rows.is_multiple_of(2);
        let ways: Vec<Sheet> = match board.legacy {
            _ if alike => vec![Sheet { legacy: None, ..way(false) }],
            Some(legacy) => vec![way(legacy)],
            None => vec![way(false), way(true)],
        };
        let count = ways.iter().map(|way| way.count).max().unwrap_or(0);
        let codes = codes(&board.dictionary, board.first_id as usize, count, 0);
        Self {
            stated: ways.len(),
            ways,
            widths: [1.0, 1.0],
            bits,
            in_bright: true,
            room: (1.0 - ratio) / 2.0,
            margin: (1.0 - ratio) / 2.0,
            columns: CodeColumns::of(&codes, bits * bits),
            codes,
        }
    }

    fn of_april_grid(grid: &AprilGrid) -> Self {
        let bits = grid.family.bits();
        let (cols, rows) = (grid.cols as i32, grid.rows as i32);
        let way = |border: u32| {
            let inset = tag_inset(border, bits);
            // AprilGrids are numbered from the lowest row.
            let cells =
                (0..rows).flat_map(|row| (0..cols).map(move |col| (2 * col, 2 * (rows - 1 - row))));
            Sheet { border_bits: Some(border), ..Sheet::of([2 * cols, 2 * rows], inset, cells) }
        };
        let codes =
            codes(&grid.family, grid.first_id as usize, grid.cols as usize * grid.rows as usize, 2);
        let borders = if grid.border_bits == Some(1) { [1, 2] } else { [2, 1] };
        let [first, second] = borders.map(way);
        let mistaken =
            |read: &Sheet, printed: &Sheet| mistaken(&codes, bits, [read.inset, printed.inset]);
        let ways = vec![
            Sheet { mistaken: mistaken(&first, &second), ..first.clone() },
            Sheet { mistaken: mistaken(&second, &first), ..second },
        ];
        let spacing = grid.spacing as f32;
        Self {
            stated: if grid.border_bits.is_some() { 1 } else { ways.len() },
            ways,
            widths: [1.0, spacing],
            bits,
            in_bright: false,
            room: spacing.min(1.0 / (bits + 2) as f32 * 2.0),
            margin: 0.0,
            columns: CodeColumns::of(&codes, bits * bits),
            codes,
        }
    }

    /// Number of crossings of the target.
    pub(super) fn crossings(&self) -> usize {
        self.ways.iter().map(|way| (way.lines[0] * way.lines[1]) as usize).max().unwrap_or(0)
    }

    /// Whether the distances between lines alternate.
    pub(super) fn alternates(&self) -> bool {
        self.widths[0] != self.widths[1]
    }

    /// The mean interval between lines, in units of the lattice.
    pub(super) fn reach(&self) -> f32 {
        0.5 * (self.widths[0] + self.widths[1])
    }

    /// The line nearest to the position `x`, in units of the lattice.
    pub(super) fn nearest_line(&self, x: f32) -> i32 {
        let pairs = (x / (self.widths[0] + self.widths[1])).floor() as i32;
        let off = |k: &i32| (self.line(*k) - x).abs();
        let near = 2 * pairs..=2 * pairs + 2;
        near.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(2 * pairs)
    }

    /// The position of line `k`, in units of the lattice.
    pub(super) fn line(&self, k: i32) -> f32 {
        let pairs = k.div_euclid(2) as f32 * (self.widths[0] + self.widths[1]);
        if k.rem_euclid(2) == 0 { pairs } else { pairs + self.widths[0] }
    }
}

/// The start of a payload of `bits` × `bits` cells in its square, as a fraction of the square's
/// side, for a marker with a border of one cell whose side is `ratio` of the square's.
pub(super) fn charuco_inset(ratio: f32, bits: usize) -> f32 {
    (1.0 - ratio) / 2.0 + ratio / (bits + 2) as f32
}

/// The same for a tag with a border of this many cells, as a fraction of the tag's side.
pub(super) fn tag_inset(border: u32, bits: usize) -> f32 {
    border as f32 / (bits as u32 + 2 * border) as f32
}

/// The vectors of `count` markers from `first` on, each as it appears in the grid's axes if the
/// sheet is rotated by 0 to 3 quarter turns from +x to +y; `printed` is the rotation in which they
/// are printed, in quarter turns.
fn codes(dictionary: &Dictionary, first: usize, count: usize, printed: usize) -> Vec<f32> {
    let n = dictionary.bits();
    let mut codes = Vec::with_capacity(count * 4 * n * n);
    for marker in 0..count {
        for quarter in 0..4 {
            let start = codes.len();
            for row in 0..n {
                for col in 0..n {
                    let white =
                        dictionary.is_white_rotated(first + marker, (row, col), quarter + printed);
                    codes.push(if white.unwrap_or(false) { 1.0 } else { 0.0 });
                }
            }
            unit(&mut codes[start..]);
        }
    }
    codes
}

/// The mean correlation with their codes of markers whose payload is printed at one inset but read
/// at another.
fn mistaken(codes: &[f32], bits: usize, [read, printed]: [f32; 2]) -> f32 {
    // The cell of the print that contains the fraction `part` of the cell that is read.
    let cell = |index: usize, part: f32| {
        let step = |inset: f32| (1.0 - 2.0 * inset) / bits as f32;
        let place = (read + (index as f32 + part) * step(read) - printed) / step(printed);
        (0.0..bits as f32).contains(&place).then_some(place as usize)
    };
    let agreement = |code: &[f32]| {
        let white = |row: Option<usize>, col: Option<usize>| {
            let value = row.zip(col).map_or(0.0, |(row, col)| code[row * bits + col]);
            if value > 0.0 { 1.0 } else { 0.0 }
        };
        let mut seen: Vec<f32> = (0..bits * bits)
            .map(|at| {
                let sampled =
                    IN_CODE_CELL.map(|(x, y)| white(cell(at / bits, y), cell(at % bits, x)));
                sampled.iter().sum::<f32>() / 4.0
            })
            .collect();
        unit(&mut seen);
        code.iter().zip(&seen).map(|(a, b)| a * b).sum::<f32>()
    };
    // All rotations of a code have the same correlation.
    let upright = codes.chunks_exact(bits * bits).step_by(4);
    upright.clone().map(agreement).sum::<f32>() / upright.count().max(1) as f32
}

/// Subtracts the mean and scales to length 1; returns the length before. The vector becomes zero if
/// that length is nearly zero.
pub(super) fn unit(values: &mut [f32]) -> f32 {
    let mean = values.iter().sum::<f32>() / values.len().max(1) as f32;
    let length = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f32>().sqrt();
    let scale = if length > 1e-3 { 1.0 / length } else { 0.0 };
    values.iter_mut().for_each(|value| *value = (*value - mean) * scale);
    length
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_borders_of_tags_with_few_bits_have_the_same_payload() {
        let grid = |family: &str| {
            let family = Dictionary::named(family).expect("a family");
            let grid = AprilGrid {
                cols: 6,
                rows: 5,
                tag_m: 0.04,
                spacing: 0.3,
                family,
                border_bits: None,
                first_id: 0,
            };
            let sheets = Sheets::of(&Target::AprilGrid(grid)).expect("tags");
            [0, 1].map(|way| sheets.ways[way].mistaken)
        };
        let [wide, narrow] = grid("tag36h11");
        assert!((0.75..0.82).contains(&wide) && (0.58..0.68).contains(&narrow), "{wide} {narrow}");
        let [wide, narrow] = grid("tag16h5");
        assert!(wide > 0.99 && (0.72..0.82).contains(&narrow), "{wide} {narrow}");
    }
}
