//! Whether the line between two neighboring corners is an edge between a bright and a dark square
//! all the way.
//!
//! A grid that skips corners, or joins corners of two things, fails here.

use super::cross::{Vec2, bilinear};
use super::grid::Grid;
use crate::imaging::gray::GrayView;

/// How far from the edge its two sides are sampled, as a share of the square.
const ASIDE: f32 = 0.25;
/// Least difference of the two sides, as a share of the corners' contrast.
const LEAST_DIFFERENCE: f32 = 0.25;

/// Brightness at `p`; `None` outside the image.
pub(super) fn sample(image: GrayView<'_>, p: Vec2) -> Option<f32> {
    let inside = p.x >= 0.0
        && p.y >= 0.0
        && p.x <= (image.width() - 1) as f32
        && p.y <= (image.height() - 1) as f32;
    inside.then(|| bilinear(image.bytes(), image.stride(), p.x, p.y))
}

/// Whether the side towards `aside` of the line from `p` to `q` is brighter by `contrast` (darker,
/// if that is negative) than the other side, in three places. `None` where that would be outside
/// the image.
pub(super) fn is_edge(
    image: GrayView<'_>,
    p: Vec2,
    q: Vec2,
    aside: Vec2,
    contrast: f32,
) -> Option<bool> {
    let mut holds = true;
    for part in [0.28, 0.5, 0.72] {
        let on = p + (q - p) * part;
        let difference = sample(image, on + aside * ASIDE)? - sample(image, on - aside * ASIDE)?;
        holds &= difference * contrast.signum() >= LEAST_DIFFERENCE * contrast.abs();
    }
    Some(holds)
}

/// How many of the grid's edges at one corner hold, of how many that are visible.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct EdgeCount {
    /// Edges between a bright and a dark square.
    pub held: u32,
    /// Edges to known neighbors, inside the image.
    pub seen: u32,
}

/// Counts the edges of the corner (i, j) of `grid`.
pub(super) fn count_edges(image: GrayView<'_>, grid: &Grid, i: i32, j: i32) -> EdgeCount {
    let mut count = EdgeCount::default();
    let (Some(node), Some([u, v])) = (grid.get(i, j), grid.steps(i, j)) else { return count };
    for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        let Some(other) = grid.get(i + di, j + dj) else { continue };
        // Beyond +i, the square on the side of +v has the corner's own polarity; a quarter turn
        // changes the sign.
        let (aside, sign) = if di != 0 { (v, di as f32) } else { (u, dj as f32) };
        let contrast =
            0.5 * (node.contrast.abs() + other.contrast.abs()) * grid.polarity(i, j) * sign;
        if let Some(holds) = is_edge(image, node.pixel, other.pixel, aside, contrast) {
            count.seen += 1;
            count.held += u32::from(holds);
        }
    }
    count
}
