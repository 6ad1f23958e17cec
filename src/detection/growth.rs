//! From one square to the whole grid: each place beside a known corner is looked at in the image itself.
//!
//! A corner that the candidates missed is found here all the same, because it is known where to look, how its edges run
//! and which of its squares are bright.

use std::collections::VecDeque;

use super::candidates::Candidate;
use super::cross::{Vec2, Window};
use super::grid::{Grid, Node};
use super::seeds::Seed;
use crate::imaging::gray::GrayView;

/// Least correlation with a chessboard corner.
const LEAST_SCORE: f32 = 0.62;
/// Least contrast, as a share of the neighbours'.
const LEAST_CONTRAST: f32 = 0.3;
/// Least alternation of the four squares, as a share of the contrast found.
const LEAST_ALTERNATION: f32 = 0.3;
/// How far a corner may lie from where it was predicted, in steps of the grid.
const MOST_OFF: f32 = 0.3;
/// Part of the way to the neighbours that a window reaches.
const REACH: f32 = 0.4;
/// Most pixels a window reaches.
const MOST_REACH_PX: f32 = 16.0;

/// Grows grids; its queue is kept from grid to grid.
#[derive(Debug, Default)]
pub(super) struct Growth {
    queue: VecDeque<(i32, i32)>,
}

impl Growth {
    /// Starts `grid` from `seed` and grows it over `image`.
    pub(super) fn start(
        &mut self,
        image: GrayView<'_>,
        candidates: &[Candidate],
        seed: &Seed,
        radius: i32,
        grid: &mut Grid,
    ) {
        grid.clear(radius, seed.bright);
        for (&candidate, (i, j)) in seed.corners.iter().zip([(0, 0), (1, 0), (0, 1), (1, 1)]) {
            let Candidate { pixel, contrast, .. } = candidates[candidate];
            grid.set(i, j, Node { pixel, contrast, score: 0.5 });
        }
        self.grow(image, grid);
    }

    /// Grows `grid` as far as `image` shows corners.
    pub(super) fn grow(&mut self, image: GrayView<'_>, grid: &mut Grid) {
        self.queue.clear();
        for index in 0..grid.members.len() {
            let (i, j) = grid.members[index];
            self.push_around(i, j);
        }
        while let Some((i, j)) = self.queue.pop_front() {
            if !grid.attempt(i, j) {
                continue;
            }
            if let Some(node) = look(image, grid, i, j) {
                grid.set(i, j, node);
                self.push_around(i, j);
            }
        }
    }

    fn push_around(&mut self, i: i32, j: i32) {
        self.queue.extend([(i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1)]);
    }
}

/// Looks where the grid says the corner (i, j) must be.
fn look(image: GrayView<'_>, grid: &Grid, i: i32, j: i32) -> Option<Node> {
    let expected = grid.predict(i, j)?;
    let steps = grid.steps(i, j)?;
    let node = settle(image, expected, steps)?;
    let polarity = grid.polarity(i, j);
    let near = contrast_near(grid, i, j);
    let off = in_steps(node.pixel - expected, steps)?;
    let fits = node.score >= LEAST_SCORE
        && node.contrast * polarity >= LEAST_CONTRAST * near
        && off.x.abs() <= MOST_OFF
        && off.y.abs() <= MOST_OFF;
    (fits && alternates(image, &node, steps, polarity)).then_some(node)
}

/// The corner at `expected`, wherever exactly it settles, in the image.
pub(super) fn settle(image: GrayView<'_>, expected: Vec2, [u, v]: [Vec2; 2]) -> Option<Node> {
    let window = |center| Window::on_board(center, u, v, REACH, MOST_REACH_PX).inside(image, 0.25);
    let first = window(expected)?.look(image)?;
    let second = window(first.center)?.look(image)?;
    let last = window(second.center)?.look(image)?;
    Some(Node { pixel: last.center, contrast: last.contrast, score: last.score })
}

fn alternates(image: GrayView<'_>, node: &Node, [u, v]: [Vec2; 2], polarity: f32) -> bool {
    let window = Window::on_board(node.pixel, u, v, 0.33, f32::MAX).inside(image, 0.1);
    window
        .and_then(|window| window.alternation(image))
        .is_some_and(|depth| depth * polarity >= LEAST_ALTERNATION * node.contrast.abs())
}

/// Mean contrast of the known corners about (i, j).
fn contrast_near(grid: &Grid, i: i32, j: i32) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for dj in -1..=1 {
        for di in -1..=1 {
            if let Some(node) = grid.get(i + di, j + dj) {
                sum += node.contrast.abs();
                count += 1.0;
            }
        }
    }
    sum / f32::max(count, 1.0)
}

/// `vector` in units of the steps `u` and `v`.
pub(super) fn in_steps(vector: Vec2, [u, v]: [Vec2; 2]) -> Option<Vec2> {
    let area = u.x * v.y - u.y * v.x;
    let least = 0.1 * u.norm() * v.norm();
    (area.abs() > least && area.abs() > 1.0)
        .then(|| Vec2::new((vector.x * v.y - vector.y * v.x) / area, (u.x * vector.y - u.y * vector.x) / area))
}
