//! Which sides of a lattice are the board's own ends, by what lies beyond the outer squares.
//!
//! The two layouts of a ChArUco board of even rows have the same markers in the same order, moved
//! by one square: of a part of it only the board's ends distinguish them. Beyond an outer bright
//! square lies bright paper if the board ends there, and a dark square if it goes on.

use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::Grid;
use crate::detection::measure::edges::sample;
use crate::detection::thresholds::markers::LabelThresholds;
use crate::detection::verify::placement::BoardPlacement;
use crate::imaging::gray::GrayView;

/// How many sides of the board of `lines` corners, placed so in `grid`, are seen to be its ends.
pub(super) fn seen_ends(
    image: GrayView<'_>,
    (sheets, lines, limits): (&Sheets, [i32; 2], &LabelThresholds),
    grid: &Grid,
    placement: BoardPlacement,
    pairs: &mut Vec<ChartPair>,
) -> usize {
    let [across, down] = lines;
    let sides = [
        (0, -1, down, true),
        (across - 1, 1, down, true),
        (0, -1, across, false),
        (down - 1, 1, across, false),
    ];
    sides
        .into_iter()
        .filter(|&(line, outward, length, upright)| {
            let (mut ends, mut bright) = (0, 0);
            for k in 0..length - 1 {
                let corner = |k: i32| if upright { (line, k) } else { (k, line) };
                let square =
                    [corner(k), corner(k + 1)].map(|(col, row)| placement.in_grid(col, row));
                let seen = square_ends(
                    image,
                    (sheets, grid, limits),
                    (square, outward, upright),
                    placement,
                    pairs,
                );
                match seen {
                    Some((true, is_bright)) => {
                        ends += 1;
                        bright += usize::from(is_bright);
                    }
                    Some((false, _)) => return false,
                    None => {}
                }
            }
            ends >= limits.least_end_squares && bright >= 1
        })
        .count()
}

/// Whether the board ends with the outer square beside two corners, and whether that is bright;
/// `None` where it is not seen.
fn square_ends(
    image: GrayView<'_>,
    (sheets, grid, limits): (&Sheets, &Grid, &LabelThresholds),
    (square, outward, upright): ([(i32, i32); 2], i32, bool),
    placement: BoardPlacement,
    pairs: &mut Vec<ChartPair>,
) -> Option<(bool, bool)> {
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
    let mut ends = true;
    for v in [0.3, 0.5, 0.7] {
        let (within, beyond) =
            (at(limits.end_within, v)? > middle, at(limits.end_beyond, v)? > middle);
        ends &= within == is_bright && beyond;
    }
    Some((ends, is_bright))
}
