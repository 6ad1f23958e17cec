//! Determines which sides of a lattice are the board's own ends, by the pattern beyond the outer
//! squares.
//!
//! The two layouts of a ChArUco board with an even number of rows have the same markers in the same
//! order, offset by one square: on a part of the board, only its ends distinguish them. Beyond a
//! bright outer square there is bright paper if the board ends there, and a dark square if it
//! continues. Ends that both layouts share do not distinguish them, such as the top of a board
//! whose layouts differ by a column.

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::labels::BoardLabel;
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::Grid;
use crate::detection::measure::edges::sample;
use crate::detection::thresholds::markers::LabelThresholds;
use crate::detection::verify::placement::BoardPlacement;
use crate::imaging::gray::GrayView;

/// An outer line of corners of a labeled board, and what is seen beyond it.
#[derive(Debug, Clone, Copy)]
struct SheetSide {
    /// The outward direction in the grid.
    outward: (i32, i32),
    /// The position of the line in that direction.
    line: i32,
    beyond: Beyond,
}

/// The pattern beyond the outer squares of a side.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Beyond {
    /// Paper: the board ends there.
    Paper,
    /// Squares that continue alternating.
    Squares,
    /// Neither is certain.
    Unknown,
}

/// A lattice in an image, and the sheets that it may belong to.
#[derive(Debug, Clone, Copy)]
pub(super) struct LatticeInImage<'a> {
    pub image: GrayView<'a>,
    pub grid: &'a Grid,
    pub sheets: &'a Sheets,
    pub limits: &'a LabelThresholds,
}

/// Chooses between two placements of a board by the sides at which they differ: one has an end that
/// is seen, or the other would end where squares continue. `None` if the sides support neither or
/// both.
pub(super) fn by_sides(
    lattice: LatticeInImage<'_>,
    labels: [BoardLabel; 2],
    pairs: &mut Vec<ChartPair>,
) -> Option<usize> {
    let [first, second] = labels
        .map(|label| sides(lattice, lattice.sheets.ways[label.way].lines, label.placement, pairs));
    let shared = |side: &SheetSide, others: &[SheetSide; 4]| {
        others.iter().any(|other| (other.outward, other.line) == (side.outward, side.line))
    };
    let own = |sides: &[SheetSide; 4], others: &[SheetSide; 4], beyond| {
        sides.iter().any(|side| side.beyond == beyond && !shared(side, others))
    };
    let ends = [own(&first, &second, Beyond::Paper), own(&second, &first, Beyond::Paper)];
    let goes_on = [own(&first, &second, Beyond::Squares), own(&second, &first, Beyond::Squares)];
    match [ends[0] || goes_on[1], ends[1] || goes_on[0]] {
        [true, false] => Some(0),
        [false, true] => Some(1),
        _ => None,
    }
}

/// An outer line of a board's corners, in the board's columns and rows.
#[derive(Debug, Clone, Copy)]
struct OuterLine {
    /// Whether it is a column of corners; otherwise a row.
    upright: bool,
    /// Its index.
    line: i32,
    /// The outward direction: 1 or −1.
    step: i32,
    /// Its number of corners.
    length: i32,
}

impl OuterLine {
    /// The column and row of its `k`-th corner.
    fn corner(self, k: i32) -> (i32, i32) {
        if self.upright { (self.line, k) } else { (k, self.line) }
    }

    /// The outward direction in the grid, for this placement of the board.
    fn outward(self, placement: BoardPlacement) -> (i32, i32) {
        let origin = placement.in_grid(0, 0);
        let (col, row) = if self.upright { (self.step, 0) } else { (0, self.step) };
        let next = placement.in_grid(col, row);
        (next.0 - origin.0, next.1 - origin.1)
    }
}

/// The four sides of a board of `lines` corners at this placement in the lattice.
fn sides(
    lattice: LatticeInImage<'_>,
    [across, down]: [i32; 2],
    placement: BoardPlacement,
    pairs: &mut Vec<ChartPair>,
) -> [SheetSide; 4] {
    let lines = [
        OuterLine { upright: true, line: 0, step: -1, length: down },
        OuterLine { upright: true, line: across - 1, step: 1, length: down },
        OuterLine { upright: false, line: 0, step: -1, length: across },
        OuterLine { upright: false, line: down - 1, step: 1, length: across },
    ];
    lines.map(|outer| {
        let outward = outer.outward(placement);
        let in_grid = |k: i32| {
            let (col, row) = outer.corner(k);
            placement.in_grid(col, row)
        };
        let squares = (0..outer.length - 1)
            .filter_map(|k| square_ends(lattice, [in_grid(k), in_grid(k + 1)], outward, pairs));
        let squares: Vec<OuterSquare> = squares.collect();
        let at = in_grid(0);
        let line = at.0 * outward.0 + at.1 * outward.1;
        SheetSide { outward, line, beyond: beyond(&squares, lattice.limits) }
    })
}

fn beyond(squares: &[OuterSquare], limits: &LabelThresholds) -> Beyond {
    let all = |of: fn(&OuterSquare) -> bool| {
        squares.len() >= limits.least_end_squares && squares.iter().all(of)
    };
    let bright = squares.iter().filter(|square| square.bright).count();
    if all(|square| square.paper) && bright > 0 {
        Beyond::Paper
    } else if all(|square| square.alternates) && bright > 0 && bright < squares.len() {
        Beyond::Squares
    } else {
        Beyond::Unknown
    }
}

/// A square of the outer row of a side.
#[derive(Debug, Clone, Copy)]
struct OuterSquare {
    bright: bool,
    /// It ends where it should, and beyond it is bright.
    paper: bool,
    /// It ends where it should, and beyond it is the opposite color.
    alternates: bool,
}

/// The outer square next to two corners, all in the grid; `None` where it is not seen.
fn square_ends(
    LatticeInImage { image, grid, sheets, limits }: LatticeInImage<'_>,
    [a, b]: [(i32, i32); 2],
    outward: (i32, i32),
    pairs: &mut Vec<ChartPair>,
) -> Option<OuterSquare> {
    let (near, far) = (grid.get(a.0, a.1)?, grid.get(b.0, b.1)?);
    let chart = Chart::near(grid, sheets, a, None, pairs)?;
    let out = (outward.0 as f32, outward.1 as f32);
    let along = ((b.0 - a.0) as f32, (b.1 - a.1) as f32);
    let start = (sheets.line(a.0), sheets.line(a.1));
    let at = |u: f32, v: f32| {
        let x = start.0 + u * out.0 + v * along.0;
        let y = start.1 + u * out.1 + v * along.1;
        sample(image, chart.at(x, y)?)
    };
    let aside = limits.end_beside;
    let (inside, outside) = (at(aside, aside)?, at(-aside, aside)?);
    let (beside, middle) = (inside - outside, (inside + outside) / 2.0);
    let contrast = 0.5 * (near.contrast.abs() + far.contrast.abs());
    if beside.abs() < limits.least_end_contrast * contrast {
        return None;
    }
    let is_bright = beside > 0.0;
    let (mut paper, mut alternates) = (true, true);
    for v in [0.3, 0.5, 0.7] {
        let (within, beyond) =
            (at(limits.end_within, v)? > middle, at(limits.end_beyond, v)? > middle);
        paper &= within == is_bright && beyond;
        alternates &= within == is_bright && beyond != is_bright;
    }
    Some(OuterSquare { bright: is_bright, paper, alternates })
}
