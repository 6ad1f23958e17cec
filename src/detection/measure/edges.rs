//! Whether the line between two neighboring corners is an edge between a bright and a dark square
//! along its whole length.
//!
//! A grid that skips corners, or joins corners of two objects, fails here.

use crate::detection::grid::Grid;
use crate::detection::measure::Probe;
use crate::detection::measure::cross::bilinear;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// Where an edge is sampled between its two corners: in the middle, and as far from each end as the
/// blur of a corner that is still found reaches.
const ALONG_PARTS: [f32; 3] = [0.28, 0.5, 0.72];

/// Brightness at `p`; `None` outside the image.
#[inline]
pub(in crate::detection) fn sample(image: GrayView<'_>, p: Vec2) -> Option<f32> {
    let inside = p.x >= 0.0
        && p.y >= 0.0
        && p.x <= (image.width() - 1) as f32
        && p.y <= (image.height() - 1) as f32;
    inside.then(|| bilinear(image.bytes(), image.stride(), p.x, p.y))
}

/// The difference in brightness between the side towards `aside` of the line from `ends[0]` to
/// `ends[1]` and the other side, at three positions, sampled by `brightness`. `None` if a sample is
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
    for (difference, part) in differences.iter_mut().zip(ALONG_PARTS) {
        let on = ends[0] + (ends[1] - ends[0]) * part;
        *difference = brightness(probe.image, on + aside)? - brightness(probe.image, on - aside)?;
    }
    Some(differences)
}

/// Whether the side towards `aside` of the line from `ends[0]` to `ends[1]` is brighter than the
/// other side, to a sufficient part of `contrast` (darker, if that is negative). `None` if a sample
/// is outside the image.
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

/// The edges of the grid at one corner: how many hold, out of how many visible ones.
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
        // The quadrant between +i and +v has the corner's own polarity, and each next quadrant the
        // opposite one.
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
