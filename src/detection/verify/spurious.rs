//! Corners beyond a complete board that are not the board's: the edge of the plate that it is
//! mounted on, and what is seen behind it, may meet where the next line of corners would be.
//!
//! Their position shows nothing, because they are searched for where the board predicts a corner.
//! Their light does: a corner joins four squares of one board, so the two outer ones differ as the
//! two inner ones do, whatever hides the rest of their line.

use crate::detection::grid::extent::has_shape;
use crate::detection::grid::{Bounds, Grid};
use crate::detection::measure::Probe;
use crate::detection::measure::edges::sample;
use crate::detection::vec2::Vec2;
use crate::detection::verify::ends::{ends_at, seen_ends};
use crate::geometry::board::BoardSize;

/// Where the squares around a corner are sampled, as parts of the reach of the narrow window that
/// it was measured in: a few positions, for noise. Chosen, not swept.
const AT_PARTS: [f32; 3] = [0.8, 1.0, 1.2];

/// Drops the corners of `grid` that lie beyond the whole of `board`. Returns false, with `grid` as
/// it was, unless every corner of the board is there, its sides towards the others end at a margin,
/// and none of the others can be a corner of a larger board.
pub(in crate::detection) fn drop_spurious(
    probe: Probe<'_>,
    grid: &mut Grid,
    bounds: Bounds,
    board: BoardSize,
) -> bool {
    let Some(filled) = grid.filled_bounds() else { return false };
    let is_beyond = |&(i, j): &(i32, i32)| !filled.contains(i, j);
    let others: Vec<(i32, i32)> = grid.members.iter().copied().filter(is_beyond).collect();
    if others.is_empty()
        || !has_shape(filled, board)
        || grid.members.len() - others.len() != board.corner_count()
    {
        return false;
    }
    let margins = seen_ends(probe, grid, filled).margins;
    let beyond = [
        bounds.i.0 < filled.i.0,
        bounds.i.1 > filled.i.1,
        bounds.j.0 < filled.j.0,
        bounds.j.1 > filled.j.1,
    ];
    let all_end = beyond.iter().zip(margins).all(|(&beyond, ends)| ends || !beyond);
    // Something uniform around a corner may be an occluder, which takes from its contrast.
    let is_spurious = |&at: &(i32, i32)| {
        let inner = (at.0.clamp(filled.i.0, filled.i.1), at.1.clamp(filled.j.0, filled.j.1));
        let outward = ((at.0 - inner.0).signum(), (at.1 - inner.1).signum());
        continues(probe, grid, at, filled) == Some(false)
            && ends_at(probe, grid, inner, outward) == Some(false)
    };
    if !all_end || !others.iter().all(is_spurious) {
        return false;
    }
    others.iter().for_each(|&(i, j)| grid.remove(i, j));
    true
}

/// Whether the squares beyond the corner (i, j), which lies outside of `filled`, differ from each
/// other about as much as those before it. `None` if that cannot be seen.
fn continues(probe: Probe<'_>, grid: &Grid, (i, j): (i32, i32), filled: Bounds) -> Option<bool> {
    let [u, v] = grid.steps(i, j)?;
    let outward = |at: i32, (least, most): (i32, i32)| (at - at.clamp(least, most)).signum() as f32;
    let (out, along) = match (outward(i, filled.i), outward(j, filled.j)) {
        (across, 0.0) => (u * across, v),
        (0.0, down) => (v * down, u),
        _ => return None,
    };
    let corner = grid.pixel(i, j)?;
    let thresholds = &probe.thresholds.measure;
    let shortest_px = u.norm().min(v.norm()).max(1e-3);
    let reach = thresholds.near_reach.max(thresholds.least_reach_px / shortest_px);
    let pair = |out: Vec2| {
        let mut difference = 0.0;
        for (part, aside) in AT_PARTS.into_iter().flat_map(|p| AT_PARTS.map(|a| (p, a))) {
            let (middle, aside) = (corner + out * (part * reach), along * (aside * reach));
            difference +=
                sample(probe.image, middle + aside)? - sample(probe.image, middle - aside)?;
        }
        Some(difference)
    };
    // Across a corner dark and bright change places, so the difference changes its sign.
    let (inner, outer) = (pair(-out)?, -pair(out)?);
    Some(outer * inner.signum() >= (1.0 - probe.thresholds.ends.alike) * inner.abs())
}
