//! Which sides of a lattice are the board's own ends, by what lies beyond the outer squares.
//!
//! The two layouts of a ChArUco board of even rows have the same markers in the same order, moved
//! by one square: of a part of it only the board's ends distinguish them. Beyond an outer bright
//! square lies bright paper if the board ends there, and a dark square if it goes on. Ends that
//! both layouts share, as the top of a board whose layouts differ by a column, say nothing.

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::labels::BoardLabel;
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::Grid;
use crate::detection::measure::edges::sample;
use crate::detection::thresholds::markers::LabelThresholds;
use crate::detection::verify::placement::BoardPlacement;
use crate::imaging::gray::GrayView;

/// A line of outer corners of a labeled board, and what is seen beyond it.
#[derive(Debug, Clone, Copy)]
struct SheetSide {
    /// The way outward, in the grid.
    outward: (i32, i32),
    /// How far out the line lies that way.
    line: i32,
    beyond: Beyond,
}

/// What lies beyond the outer squares of a side.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Beyond {
    /// Paper: the board ends there.
    Paper,
    /// Squares that go on alternating.
    Squares,
    /// Neither is certain.
    Unknown,
}

/// Of two ways in which a board may lie in `grid`, the one that the sides at which they differ
/// speak for: an end of it is seen, or the other would end where squares go on. `None` if they
/// speak for neither or for both.
pub(super) fn by_sides(
    image: GrayView<'_>,
    (sheets, limits): (&Sheets, &LabelThresholds),
    grid: &Grid,
    labels: [BoardLabel; 2],
    pairs: &mut Vec<ChartPair>,
) -> Option<usize> {
    let [first, second] = labels.map(|label| {
        let lines = sheets.ways[label.way].lines;
        sides(image, (sheets, lines, limits), grid, label.placement, pairs)
    });
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

/// The four sides of the board of `lines` corners, placed so in `grid`.
fn sides(
    image: GrayView<'_>,
    (sheets, lines, limits): (&Sheets, [i32; 2], &LabelThresholds),
    grid: &Grid,
    placement: BoardPlacement,
    pairs: &mut Vec<ChartPair>,
) -> [SheetSide; 4] {
    let [across, down] = lines;
    let sides = [
        (0, -1, down, true),
        (across - 1, 1, down, true),
        (0, -1, across, false),
        (down - 1, 1, across, false),
    ];
    sides.map(|(line, step, length, upright)| {
        let corner = |k: i32| if upright { (line, k) } else { (k, line) };
        let squares = (0..length - 1).filter_map(|k| {
            let square = [corner(k), corner(k + 1)].map(|(col, row)| placement.in_grid(col, row));
            let side = (square, step, upright);
            square_ends(image, (sheets, grid, limits), side, placement, pairs)
        });
        let squares: Vec<OuterSquare> = squares.collect();
        let (origin, corner) = (placement.in_grid(0, 0), corner(0));
        let at = placement.in_grid(corner.0, corner.1);
        let next = if upright { placement.in_grid(step, 0) } else { placement.in_grid(0, step) };
        let outward = (next.0 - origin.0, next.1 - origin.1);
        let line = at.0 * outward.0 + at.1 * outward.1;
        SheetSide { outward, line, beyond: beyond(&squares, limits) }
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

/// A square of a side's outer row.
#[derive(Debug, Clone, Copy)]
struct OuterSquare {
    bright: bool,
    /// It ends where it should, and what is beyond is bright.
    paper: bool,
    /// It ends where it should, and what is beyond is its opposite.
    alternates: bool,
}

/// The outer square beside two corners; `None` where it is not seen.
fn square_ends(
    image: GrayView<'_>,
    (sheets, grid, limits): (&Sheets, &Grid, &LabelThresholds),
    (square, outward, upright): ([(i32, i32); 2], i32, bool),
    placement: BoardPlacement,
    pairs: &mut Vec<ChartPair>,
) -> Option<OuterSquare> {
    let [a, b] = square;
    let (near, far) = (grid.get(a.0, a.1)?, grid.get(b.0, b.1)?);
    let chart = Chart::near(grid, sheets, a, None, pairs)?;
    // The way outward and from the first corner to the second, in the grid.
    let origin = placement.in_grid(0, 0);
    let step = if upright { placement.in_grid(outward, 0) } else { placement.in_grid(0, outward) };
    let out = ((step.0 - origin.0) as f32, (step.1 - origin.1) as f32);
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
