//! Where the board itself ends: one square beyond its outermost corners the pattern stops.
//!
//! That no corner was found beyond a line is no proof: a hand or the image's border may hide it. The board's end is seen
//! only if the squares outside the line alternate and what lies beyond these does not.

use super::cross::Vec2;
use super::edges::sample;
use super::grid::{Bounds, Grid};
use super::placement::Ends;
use crate::imaging::gray::GrayView;

/// Where the outermost squares and what lies beyond are sampled, in squares outward from the line of corners.
const WITHIN: f32 = 0.7;
const BEYOND: f32 = 1.3;
/// Two squares alternate if they differ by this share of the contrast; they are alike below [`ALIKE`].
const ALTERNATE: f32 = 0.5;
const ALIKE: f32 = 0.3;
/// Pairs of neighbouring squares that must show the end.
const LEAST_PAIRS: u32 = 2;

/// Which sides of `grid` are seen to be ends of the board.
pub(super) fn seen_ends(image: GrayView<'_>, grid: &Grid, bounds: Bounds) -> Ends {
    let columns = |i: i32, outward: i32| side(image, grid, bounds.j, outward, |along| (i, along), (1, 0));
    let rows = |j: i32, outward: i32| side(image, grid, bounds.i, outward, |along| (along, j), (0, 1));
    [columns(bounds.i.0, -1), columns(bounds.i.1, 1), rows(bounds.j.0, -1), rows(bounds.j.1, 1)]
}

/// Whether the board ends beyond the line of corners `at(least..=most)`, towards `outward` along `axis`.
fn side(
    image: GrayView<'_>,
    grid: &Grid,
    (least, most): (i32, i32),
    outward: i32,
    at: impl Fn(i32) -> (i32, i32),
    axis: (i32, i32),
) -> bool {
    let mut previous: Option<Outside> = None;
    let (mut ended, mut continued) = (0, 0);
    for along in least..most {
        let outside = outside_of(image, grid, at(along), at(along + 1), (axis.0 * outward, axis.1 * outward));
        if let (Some(p), Some(q)) = (previous, outside) {
            // Signs alternate from square to square, so the difference of neighbours times the sign is the contrast.
            let contrast = 0.5 * (p.contrast + q.contrast);
            let within = (p.within - q.within) * p.sign;
            let beyond = (p.beyond - q.beyond) * p.sign;
            if within > ALTERNATE * contrast {
                ended += u32::from(beyond.abs() < ALIKE * contrast);
                continued += u32::from(beyond < -ALTERNATE * contrast);
            }
        }
        previous = outside;
    }
    ended >= LEAST_PAIRS && ended > 3 * continued
}

/// One square outside the line of corners, and what lies beyond it.
#[derive(Debug, Clone, Copy)]
struct Outside {
    within: f32,
    beyond: f32,
    /// 1 if the square must be bright, −1 if dark.
    sign: f32,
    contrast: f32,
}

fn outside_of(image: GrayView<'_>, grid: &Grid, p: (i32, i32), q: (i32, i32), outward: (i32, i32)) -> Option<Outside> {
    let (a, b) = (grid.get(p.0, p.1)?, grid.get(q.0, q.1)?);
    let out = |at: (i32, i32), from: Vec2| Some(grid.predict(at.0 + outward.0, at.1 + outward.1)? - from);
    let middle = (a.pixel + b.pixel) * 0.5;
    let step = (out(p, a.pixel)? + out(q, b.pixel)?) * 0.5;
    // The square beyond the line, by its least corner.
    let square = (p.0.min(p.0 + outward.0), p.1.min(p.1 + outward.1));
    Some(Outside {
        within: sample(image, middle + step * WITHIN)?,
        beyond: sample(image, middle + step * BEYOND)?,
        sign: grid.polarity(square.0, square.1),
        contrast: 0.5 * (a.contrast.abs() + b.contrast.abs()),
    })
}
