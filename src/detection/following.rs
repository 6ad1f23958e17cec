//! Tracking: the corners of the board of the last image, each measured where it is predicted now.
//!
//! A corner's offset from its prediction predicts its neighbors' offsets: but for the first, one
//! small window is enough, as narrow as the blur allows. The whole board confirms itself: every
//! square between the corners alternates, and none beyond them does.

use super::board_edges::LEAST_CONTRAST;
use super::cross::{CrossWindow, Vec2};
use super::detector::Detector;
use super::grid::Node;
use super::growth::{FOLLOWED, Prediction, WINDOWS};
use super::last_board::ExpectedCorner;
use super::verification::{MOST_OFF, off_neighbors};
use crate::imaging::gray::GrayView;

/// A board with a larger share of corners off their prediction is not tracked.
const MOST_LOST: usize = 4;
/// Search radius of a corner whose neighbors are not found yet, in steps.
const MOST_OFF_FIRST: f32 = 0.3;
/// Reach of the windows across each edge: the near one gives the most exact corner; where it shows
/// none, the far one is as wide as the neighbors' prediction is uncertain, in pixels and in steps.
/// Both are at least this many blur widths.
const PREDICTED_PX: f32 = 5.0;
const PREDICTED_STEPS: f32 = 0.06;
/// The same after a wide, coarsely sampled window has found the corner.
const FOUND_STEPS: f32 = 0.12;
const PREDICTED_BLURS: f32 = 2.5;
/// Windows narrow by this factor: each localizes the corner to within the next.
const NARROWER: f32 = 0.45;
const EXACT_PX: f32 = 2.5;
const EXACT_BLURS: f32 = 2.0;
/// Largest reach of a window, in steps.
const MOST_REACH: f32 = 0.4;
/// Minimum correlation with a chessboard corner in the far window and in the near one.
const LEAST_SCORES: [f32; 2] = [0.6, 0.7];
/// A window is recentered, a few times, while the corner is farther from its center than this share
/// of its reach.
const MOST_ASIDE: [f32; 2] = [0.4, 0.2];
const MAX_ITERATIONS: usize = 3;
/// How far from a position beyond the board its four quadrants are sampled, in steps, and the
/// minimum alternation, as a share of the contrast, for a closer measurement.
const BEYOND: f32 = 0.3;
const MAY_ALTERNATE: f32 = 0.1;

impl Detector {
    /// Starts a grid, in the board's own order, from the corners that are found at their
    /// predictions.
    pub(super) fn measure_at_predictions(
        &mut self,
        image: GrayView<'_>,
        with_motion: bool,
    ) -> bool {
        let board = self.board;
        let Self { last, grid, followed, .. } = self;
        grid.clear(board.cols.max(board.rows) as i32 + 2, last.bright);
        followed.off.clear();
        let (count, cols) = (board.corner_count(), board.cols as usize);
        let mut lost = 0;
        for index in 0..count {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            let beside = (i > 0).then(|| followed.off[index - 1]).flatten();
            let above = (j > 0).then(|| followed.off[index - cols]).flatten();
            let off = beside.zip(above).map(|(a, b)| (a + b) * 0.5).or(beside).or(above);
            let seen = last.expect(index, board, with_motion).and_then(|corner| {
                let node = corner.measure(image, off, grid.polarity(i, j), last.blur_px)?;
                Some((node, node.pixel - corner.expected))
            });
            followed.off.push(seen.map(|(_, off)| off));
            match seen {
                Some((node, _)) => grid.set(i, j, node),
                None => lost += 1,
            }
            if lost * MOST_LOST > count {
                return false;
            }
        }
        true
    }

    /// Searches for the remaining corners where their neighbors predict them.
    pub(super) fn measure_between_neighbors(&mut self, image: GrayView<'_>) {
        let cols = self.board.cols as usize;
        for index in 0..self.board.corner_count() {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            if self.grid.get(i, j).is_none()
                && let Some(node) = Prediction::by_neighbors(&self.grid, i, j)
                    .and_then(|place| place.measure(image, &WINDOWS))
            {
                self.grid.set(i, j, node);
            }
        }
    }

    /// Whether the whole board in the grid, in the board's own order, is consistent: every corner
    /// where its neighbors predict it, and most edges between bright and dark.
    pub(super) fn holds_together(&mut self, image: GrayView<'_>) -> bool {
        let Self { grid, followed, board, .. } = self;
        let in_place =
            |&(i, j): &(i32, i32)| off_neighbors(grid, i, j).is_some_and(|off| off <= MOST_OFF);
        grid.members.iter().all(in_place) && followed.edges_hold(image, grid, *board)
    }

    /// Whether the pattern continues beyond the board: then it is another board.
    pub(super) fn goes_on_beyond(&self, image: GrayView<'_>) -> bool {
        let (cols, rows) = (self.board.cols as i32, self.board.rows as i32);
        let beside = (0..rows).flat_map(|j| [(-1, j), (cols, j)]);
        let above = (0..cols).flat_map(|i| [(i, -1), (i, rows)]);
        beside.chain(above).any(|(i, j)| {
            Prediction::by_neighbors(&self.grid, i, j)
                .filter(|place| may_be_corner(image, place))
                .is_some_and(|place| place.measure(image, &[FOLLOWED]).is_some())
        })
    }
}

/// Whether the four squares about `place` may be bright and dark by turns.
fn may_be_corner(image: GrayView<'_>, place: &Prediction) -> bool {
    let [u, v] = place.steps;
    let window =
        CrossWindow { center: place.expected, a: u * BEYOND, b: v * BEYOND }.inside(image, 0.25);
    let depth = window.and_then(|window| window.alternation(image));
    depth.is_some_and(|depth| depth * place.polarity > MAY_ALTERNATE * place.contrast[0])
}

impl ExpectedCorner {
    /// The corner, given its neighbors' offset `off`.
    fn measure(
        &self,
        image: GrayView<'_>,
        off: Option<Vec2>,
        polarity: f32,
        blur_px: f32,
    ) -> Option<Node> {
        let near = |place, steps| self.measure_near(image, place, polarity, (steps, blur_px));
        let near_by = off.and_then(|off| near(self.expected + off, PREDICTED_STEPS));
        near_by.or_else(|| {
            let contrast = [self.last.contrast.abs(), self.last.near_contrast.abs()];
            let expected = self.expected + off.unwrap_or_else(Vec2::zeros);
            let place = Prediction {
                expected,
                steps: self.steps,
                polarity,
                contrast,
                most_off: MOST_OFF_FIRST,
            };
            let found = place.measure(image, &[FOLLOWED])?;
            Some(near(found.pixel, FOUND_STEPS).unwrap_or(found))
        })
    }

    /// The corner near `place`, off by so many steps at most and under that much blur.
    fn measure_near(
        &self,
        image: GrayView<'_>,
        place: Vec2,
        polarity: f32,
        (off, blur_px): (f32, f32),
    ) -> Option<Node> {
        let [u, v] = self.steps;
        let lengths = [u.norm(), v.norm()];
        let (area, spread) = ((u.x * v.y - u.y * v.x).abs(), lengths[0] * lengths[1]);
        // A slanted window reaches farther along the other edge.
        let slant = spread / area.max(0.05 * spread);
        let measure = |center: Vec2, reach_px: f32| {
            let window = CrossWindow::on_board(center, u, v, MOST_REACH, reach_px * slant)
                .inside(image, 0.25)?;
            window.measure(image).filter(|cross| cross.contrast * polarity > 0.0)
        };
        let least_contrast = LEAST_CONTRAST * self.last.near_contrast.abs();
        // A window localizes a corner the better the nearer it is to the center.
        let settle = |mut center: Vec2, reach_px: f32, stage: usize| {
            for _ in 0..MAX_ITERATIONS {
                let cross = measure(center, reach_px)?;
                if (cross.center - center).norm() < MOST_ASIDE[stage] * reach_px {
                    let clear = cross.score >= LEAST_SCORES[stage]
                        && cross.contrast.abs() >= least_contrast;
                    return clear.then_some(cross);
                }
                center = cross.center;
            }
            None
        };
        let exact = EXACT_PX.max(EXACT_BLURS * blur_px);
        let settled = settle(place, exact, 1).or_else(|| {
            let mut reach =
                PREDICTED_PX.max(off * lengths[0].min(lengths[1])).max(PREDICTED_BLURS * blur_px);
            let mut center = place;
            while reach > exact {
                center = settle(center, reach, 0)?.center;
                reach *= NARROWER;
            }
            settle(center, exact, 1)
        })?;
        Some(Node {
            pixel: settled.center,
            contrast: polarity * self.last.contrast.abs(),
            near_contrast: settled.contrast,
            score: settled.score,
            tight: false,
        })
    }
}
