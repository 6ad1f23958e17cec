//! The board of the last image, and the measurement of its corners where they are predicted in the
//! next.
//!
//! A corner's offset from its prediction predicts its neighbors' offsets, so except for the first
//! corner one small window is enough, as narrow as the blur allows.

use crate::detection::grid::{Grid, Node};
use crate::detection::measure::Probe;
use crate::detection::measure::cross::{CrossWindow, LEAST_INSIDE};
use crate::detection::measure::prediction::Prediction;
use crate::detection::tracking::last_corners::LastCorners;
use crate::detection::vec2::Vec2;
use crate::detection::verify::placement::BoardPlacement;
use crate::geometry::board::BoardSize;

/// A board and its corners, in the board's order.
#[derive(Debug, Default)]
pub(super) struct LastBoard {
    pub(super) corners: LastCorners,
    /// Whether the square between the first corner and the board's middle is bright.
    pub(super) bright: bool,
    /// Width of the blur across its edges, in pixels.
    pub(super) blur_px: f32,
}

impl LastBoard {
    /// Remembers a whole board.
    pub(super) fn remember(&mut self, grid: &Grid, placement: BoardPlacement, board: BoardSize) {
        let corners = (0..board.rows as i32)
            .flat_map(|row| (0..board.cols as i32).map(move |col| (col, row)));
        self.corners.remember(corners.map(|(col, row)| {
            let (i, j) = placement.in_grid(col, row);
            grid.get(i, j)
        }));
        let ((i, j), (k, l)) = (placement.in_grid(0, 0), placement.in_grid(1, 1));
        self.bright = grid.polarity(i.min(k), j.min(l)) > 0.0;
    }

    /// Predicted position of corner `index`.
    pub(super) fn predict(
        &self,
        index: usize,
        board: BoardSize,
        with_motion: bool,
    ) -> Option<ExpectedCorner> {
        let (cols, rows) = (board.cols as usize, board.rows as usize);
        let step = |at: usize, length: usize, stride: usize| {
            let low = index - stride.min(at * stride);
            let high = if at + 1 < length { index + stride } else { index };
            let (p, q) = (self.corners.get(low)?.pixel, self.corners.get(high)?.pixel);
            Some((q - p) * (stride as f32 / (high - low) as f32))
        };
        let steps = [step(index % cols, cols, 1)?, step(index / cols, rows, cols)?];
        let moved = if with_motion { self.corners.motion(index)? } else { Vec2::zeros() };
        let last = self.corners.get(index)?;
        Some(ExpectedCorner { last, expected: last.pixel + moved, steps })
    }
}

/// A corner of the last board and its prediction.
#[derive(Debug, Clone, Copy)]
pub(super) struct ExpectedCorner {
    /// Its last measurement.
    pub last: Node,
    /// Its predicted position.
    pub expected: Vec2,
    /// The steps from there to the next corner along i and along j.
    pub steps: [Vec2; 2],
}

impl ExpectedCorner {
    /// Measures the corner, given its neighbors' offset `off`.
    pub(super) fn measure(
        &self,
        probe: Probe<'_>,
        off: Option<Vec2>,
        polarity: f32,
        blur_px: f32,
    ) -> Option<Node> {
        let thresholds = &probe.thresholds.tracking;
        let near = |place, steps| self.measure_near(probe, place, polarity, steps, blur_px);
        let near_by = off.and_then(|off| near(self.expected + off, thresholds.predicted_reach));
        near_by.or_else(|| {
            let contrast = [self.last.contrast.abs(), self.last.near_contrast.abs()];
            let expected = self.expected + off.unwrap_or_else(Vec2::zeros);
            let place = Prediction {
                expected,
                steps: self.steps,
                polarity,
                contrast,
                most_off: thresholds.most_off_first,
            };
            let found = place.measure(probe, &[probe.thresholds.windows.tracked()])?;
            Some(near(found.pixel, thresholds.found_reach).unwrap_or(found))
        })
    }

    /// Measures the corner near `place`, at most this many steps away and under this much blur.
    fn measure_near(
        &self,
        probe: Probe<'_>,
        place: Vec2,
        polarity: f32,
        off: f32,
        blur_px: f32,
    ) -> Option<Node> {
        let thresholds = &probe.thresholds.tracking;
        let [u, v] = self.steps;
        let lengths = [u.norm(), v.norm()];
        let (area, spread) = ((u.x * v.y - u.y * v.x).abs(), lengths[0] * lengths[1]);
        // On a slanted board a window extends farther along the other edge.
        let slant = spread / area.max(0.05 * spread);
        let measure = |center: Vec2, reach_px: f32| {
            let most_px = reach_px * slant;
            let window = CrossWindow::on_board(center, u, v, thresholds.most_reach, most_px)
                .inside(probe.image, LEAST_INSIDE)?;
            window.measure(probe.image).filter(|cross| cross.contrast * polarity > 0.0)
        };
        let least_contrast = thresholds.least_contrast * self.last.near_contrast.abs();
        // The closer a window is centered on a corner, the better it localizes it.
        let settle = |mut center: Vec2, reach_px: f32, [aside, least_score]: [f32; 2]| {
            for _ in 0..thresholds.most_iterations {
                let cross = measure(center, reach_px)?;
                if (cross.center - center).norm() < aside * reach_px {
                    let clear =
                        cross.score >= least_score && cross.contrast.abs() >= least_contrast;
                    return clear.then_some(cross);
                }
                center = cross.center;
            }
            None
        };
        let far = [thresholds.far_aside, thresholds.least_far_score];
        let exact = [thresholds.exact_aside, thresholds.least_exact_score];
        let exact_px = thresholds.exact_px.max(thresholds.exact_blurs * blur_px);
        let settled = settle(place, exact_px, exact).or_else(|| {
            let mut reach_px = thresholds
                .predicted_px
                .max(off * lengths[0].min(lengths[1]))
                .max(thresholds.predicted_blurs * blur_px);
            let mut center = place;
            while reach_px > exact_px {
                center = settle(center, reach_px, far)?.center;
                reach_px *= thresholds.narrower;
            }
            settle(center, exact_px, exact)
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
