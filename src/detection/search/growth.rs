//! From one square to the whole grid: each position beside a known corner is measured in the image
//! itself.

use std::collections::VecDeque;

use crate::detection::grid::perspective::Perspective;
use crate::detection::grid::{Bounds, Grid, Node};
use crate::detection::measure::Probe;
use crate::detection::measure::prediction::{Prediction, settle};
use crate::detection::search::candidates::Candidate;
use crate::detection::search::seeds::{Neighborhood, Seed};
use crate::detection::search::stretch::Stretch;
use crate::detection::thresholds::chessboard::WindowThresholds;

/// Score of a seed's corner until it is measured in the grid: so far it is only a candidate.
const SEED_SCORE: f32 = 0.5;

/// Grows grids; its queue is reused.
#[derive(Debug, Default)]
pub(in crate::detection) struct Growth {
    queue: VecDeque<(i32, i32)>,
}

impl Growth {
    /// Starts `grid`, of indices up to `radius`, from `seed` and grows it.
    pub(in crate::detection) fn start(
        &mut self,
        probe: Probe<'_>,
        candidates: &[Candidate],
        seed: &Seed,
        radius: i32,
        grid: &mut Grid,
    ) {
        const SQUARE: [(i32, i32); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];
        let windows = probe.thresholds.windows;
        grid.clear(radius, seed.bright);
        for (&candidate, (i, j)) in seed.corners.iter().zip(SQUARE) {
            let Candidate { pixel, contrast, .. } = candidates[candidate];
            let node =
                Node { pixel, contrast, near_contrast: 0.0, score: SEED_SCORE, tight: false };
            grid.set(i, j, node);
        }
        for (i, j) in SQUARE {
            let settled = grid
                .get(i, j)
                .zip(grid.steps(i, j))
                .and_then(|(node, steps)| settle(probe, node.pixel, steps, windows.0[0]));
            if let Some(node) = settled {
                grid.set(i, j, node);
            }
        }
        self.grow(probe, grid, windows.wide());
    }

    /// Grows `grid` as far as the image shows corners in these `windows`.
    fn grow(&mut self, probe: Probe<'_>, grid: &mut Grid, windows: &[WindowThresholds]) {
        self.grow_to(probe, grid, windows, usize::MAX);
    }

    /// The same, until the grid has `most` corners.
    pub(in crate::detection) fn grow_to(
        &mut self,
        probe: Probe<'_>,
        grid: &mut Grid,
        windows: &[WindowThresholds],
        most: usize,
    ) {
        self.queue.clear();
        for index in 0..grid.members.len() {
            let (i, j) = grid.members[index];
            self.push_around(i, j);
        }
        while let Some((i, j)) = self.queue.pop_front() {
            if grid.members.len() >= most {
                return;
            }
            if !grid.attempt(i, j) {
                continue;
            }
            if let Some(node) = Prediction::by_neighbors(grid, (i, j), &probe.thresholds.measure)
                .and_then(|place| place.measure(probe, windows))
            {
                grid.set(i, j, node);
                self.push_around(i, j);
            }
        }
    }

    /// Extends `grid` to candidates that are farther away than predicted, and grows it from there.
    pub(in crate::detection) fn reach(
        &mut self,
        probe: Probe<'_>,
        candidates: &[Candidate],
        neighborhood: &Neighborhood,
        grid: &mut Grid,
    ) {
        grid.forget_attempts();
        let mut from = 0;
        while let Some(&(i, j)) = grid.members.get(from) {
            for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
                let place = Stretch::from(probe, grid, (i, j), (di, dj));
                if let Some(node) =
                    place.and_then(|place| place.measure(probe, candidates, neighborhood))
                {
                    grid.set(i + di, j + dj, node);
                    self.grow(probe, grid, probe.thresholds.windows.wide());
                }
            }
            from += 1;
        }
    }

    /// Searches the free positions within `bounds`, and grows the grid from each corner found.
    pub(in crate::detection) fn bridge(
        &mut self,
        probe: Probe<'_>,
        grid: &mut Grid,
        bounds: Bounds,
    ) {
        let windows = &probe.thresholds.windows.0;
        let thresholds = &probe.thresholds.measure;
        let Some(mut perspective) = Perspective::fit(grid) else { return };
        for j in bounds.j.0..=bounds.j.1 {
            for i in bounds.i.0..=bounds.i.1 {
                if grid.get(i, j).is_some() {
                    continue;
                }
                let place = Prediction::by_perspective(&perspective, grid, i, j, thresholds);
                let seen = place.and_then(|place| place.measure(probe, windows));
                let seen = seen.or_else(|| {
                    Prediction::on_curved_board(grid, i, j, place, thresholds)?
                        .measure(probe, windows)
                });
                let Some(node) = seen else { continue };
                grid.set(i, j, node);
                self.grow(probe, grid, windows);
                let Some(fitted) = Perspective::fit(grid) else { return };
                perspective = fitted;
            }
        }
    }

    fn push_around(&mut self, i: i32, j: i32) {
        self.queue.extend([(i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1)]);
    }
}
