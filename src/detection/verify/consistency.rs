//! Verification of a grid, which can only drop corners: by their edges, and by their position
//! relative to their neighbors.

use crate::detection::grid::curved_board::predict_on_curve;
use crate::detection::grid::{Grid, in_steps};
use crate::detection::measure::Probe;
use crate::detection::measure::edges::{EdgeCount, count_edges};
use crate::detection::thresholds::chessboard::ConsistencyThresholds;

/// Drops the corners of `grid` that fail in the image. Returns false if too few hold to accept any
/// of it.
pub(in crate::detection) fn verify(probe: Probe<'_>, grid: &mut Grid) -> bool {
    let total = drop_loose(probe, grid);
    let thresholds = &probe.thresholds.consistency;
    let is_consistent =
        total.seen > 0 && total.held as f32 >= thresholds.least_held * total.seen as f32;
    is_consistent && drop_misplaced(grid, thresholds)
}

/// Drops corners at which most edges fail. Each drop removes an edge from others, so it iterates.
/// Returns the counts of the last iteration.
fn drop_loose(probe: Probe<'_>, grid: &mut Grid) -> EdgeCount {
    let mut total = EdgeCount::default();
    for _ in 0..4 {
        let before = grid.members.len();
        total = EdgeCount::default();
        for index in (0..before).rev() {
            let (i, j) = grid.members[index];
            let EdgeCount { held, seen } = count_edges(probe, grid, i, j);
            if seen > 0 && 2 * held < seen {
                grid.remove(i, j);
            } else {
                total.held += held;
                total.seen += seen;
            }
        }
        if grid.members.len() == before {
            break;
        }
    }
    total
}

/// Drops the corner that is farthest from its neighbors' prediction, until all are close to it.
/// Returns false if that takes too many.
fn drop_misplaced(grid: &mut Grid, thresholds: &ConsistencyThresholds) -> bool {
    for _ in 0..thresholds.most_misplaced {
        let off = |&(i, j): &(i32, i32)| Some((outlier(grid, i, j, thresholds.most_off)?, (i, j)));
        let worst = grid.members.iter().filter_map(off).max_by(|a, b| a.0.total_cmp(&b.0));
        match worst {
            Some((off, (i, j))) if off > thresholds.most_off => grid.remove(i, j),
            _ => return true,
        }
    }
    false
}

/// Distance of the corner (i, j) from its neighbors' prediction, in steps; if that exceeds `most`,
/// from the prediction on a curved board.
pub(in crate::detection) fn outlier(grid: &Grid, i: i32, j: i32, most: f32) -> Option<f32> {
    let off = off_neighbors(grid, i, j)?;
    Some(if off > most { off_curve(grid, i, j).map_or(off, |curved| off.min(curved)) } else { off })
}

/// Distance of the corner (i, j) from the prediction on a curved board, in steps.
pub(in crate::detection) fn off_curve(grid: &Grid, i: i32, j: i32) -> Option<f32> {
    let off = in_steps(grid.pixel(i, j)? - predict_on_curve(grid, i, j)?, grid.steps(i, j)?)?;
    Some(off.x.abs().max(off.y.abs()))
}

/// Distance of the corner (i, j) from its neighbors' prediction, in steps.
pub(in crate::detection) fn off_neighbors(grid: &Grid, i: i32, j: i32) -> Option<f32> {
    let off = in_steps(grid.pixel(i, j)? - grid.predict(i, j)?, grid.steps(i, j)?)?;
    Some(off.x.abs().max(off.y.abs()))
}
