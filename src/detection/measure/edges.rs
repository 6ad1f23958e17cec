//! Whether the line between two neighboring corners is an edge between a bright and a dark square
//! all the way.
//!
//! A grid that skips corners, or joins corners of two things, fails here.

use crate::detection::grid::Grid;
use crate::detection::measure::Probe;
use crate::detection::measure::cross::{Vec2, bilinear};
use crate::imaging::gray::GrayView;

/// Where an edge is sampled between its two corners: in the middle, and as far from each end as
/// blur reaches that hides neither corner.
const ALONG: [f32; 3] = [0.28, 0.5, 0.72];

/// Brightness at `p`; `None` outside the image.
#[inline]
pub(in crate::detection) fn sample(image: GrayView<'_>, p: Vec2) -> Option<f32> {
    let inside = p.x >= 0.0
        && p.y >= 0.0
        && p.x <= (image.width() - 1) as f32
        && p.y <= (image.height() - 1) as f32;
    inside.then(|| bilinear(image.bytes(), image.stride(), p.x, p.y))
}

/// How much brighter the side towards `aside` of the line from `ends[0]` to `ends[1]` is than the
/// other side, in three places, as `brightness` samples the image. `None` where that would be
/// outside the image.
#[inline]
pub(in crate::detection) fn differences(
    probe: Probe<'_>,
    ends: [Vec2; 2],
    aside: Vec2,
    brightness: impl Fn(GrayView<'_>, Vec2) -> Option<f32>,
) -> Option<[f32; 3]> {
    let aside = aside * probe.thresholds.edges.aside;
    let mut differences = [0.0; 3];
    for (difference, part) in differences.iter_mut().zip(ALONG) {
        let on = ends[0] + (ends[1] - ends[0]) * part;
        *difference = brightness(probe.image, on + aside)? - brightness(probe.image, on - aside)?;
    }
    Some(differences)
}

/// Whether the side towards `aside` of the line from `ends[0]` to `ends[1]` is brighter by
/// `contrast` (darker, if that is negative) than the other side. `None` where that would be outside
/// the image.
pub(in crate::detection) fn is_edge(
    probe: Probe<'_>,
    ends: [Vec2; 2],
    aside: Vec2,
    contrast: f32,
) -> Option<bool> {
    let least = probe.thresholds.edges.least_difference * contrast.abs();
    let differences = differences(probe, ends, aside, sample)?;
    Some(differences.iter().all(|difference| difference * contrast.signum() >= least))
}

/// How many of the grid's edges at one corner hold, of how many that are visible.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::detection) struct EdgeCount {
    /// Edges between a bright and a dark square.
    pub held: u32,
    /// Edges to known neighbors, inside the image.
    pub seen: u32,
}

/// Counts the edges of the corner (i, j) of `grid`.
pub(in crate::detection) fn count_edges(
    probe: Probe<'_>,
    grid: &Grid,
    i: i32,
    j: i32,
) -> EdgeCount {
    let mut count = EdgeCount::default();
    let (Some(node), Some([u, v])) = (grid.get(i, j), grid.steps(i, j)) else { return count };
    for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        let Some(other) = grid.get(i + di, j + dj) else { continue };
        // Beyond +i, the square on the side of +v has the corner's own polarity; a quarter turn
        // changes the sign.
        let (aside, sign) = if di != 0 { (v, di as f32) } else { (u, dj as f32) };
        let contrast =
            0.5 * (node.contrast.abs() + other.contrast.abs()) * grid.polarity(i, j) * sign;
        if let Some(holds) = is_edge(probe, [node.pixel, other.pixel], aside, contrast) {
            count.seen += 1;
            count.held += u32::from(holds);
        }
    }
    count
}
