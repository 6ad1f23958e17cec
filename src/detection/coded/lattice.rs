//! From one cell to all crossings of a lattice, each measured where its nearest neighbors put it.

use std::collections::VecDeque;

use crate::detection::coded::chart::{Chart, ChartPair, FARTHEST};
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::{Grid, LARGEST_RADIUS, Node, in_steps};
use crate::detection::measure::cross::CrossWindow;
use crate::detection::search::candidates::{Candidate, edges_along};
use crate::detection::search::seeds::{Neighborhood, Seed};
use crate::detection::thresholds::markers::LatticeThresholds;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// Crossings of a line that say how it is curved.
pub(super) const CURVED: i32 = 3;

/// Grows lattices; its buffers are kept.
#[derive(Debug, Default)]
pub(super) struct LatticeGrowth {
    queue: VecDeque<(i32, i32)>,
    pairs: Vec<ChartPair>,
    /// Places that were measured since it was set to 0.
    pub places: usize,
    /// Whether lattices whose intervals alternate are grown as of an inverted grid: its tags are
    /// bright.
    pub inverted: bool,
}

/// What lattices grow from: an image, what was seen in it, and what the target's lines are like.
#[derive(Clone, Copy)]
pub(super) struct LatticeScene<'a> {
    pub image: GrayView<'a>,
    pub candidates: &'a [Candidate],
    pub neighborhood: &'a Neighborhood,
    pub sheets: &'a Sheets,
    pub thresholds: &'a LatticeThresholds,
}

impl LatticeGrowth {
    /// The largest lattice that grows from `seed`, left in `grid`; beyond `most_crossings` it is
    /// grown no further.
    pub(super) fn start(
        &mut self,
        scene: LatticeScene<'_>,
        seed: &Seed,
        most_crossings: usize,
        grid: &mut Grid,
        spare: &mut Grid,
    ) {
        grid.clear(LARGEST_RADIUS, true);
        let mut most = 0;
        for (first, bright) in starts(scene, seed, self.inverted) {
            spare.clear(LARGEST_RADIUS, bright);
            for (&index, (i, j)) in seed.corners.iter().zip([(0, 0), (1, 0), (0, 1), (1, 1)]) {
                let Candidate { pixel, contrast, .. } = scene.candidates[index];
                let (i, j) = (first.0 + i, first.1 + j);
                let contrast = contrast * spare.polarity(i, j);
                let node =
                    Node { pixel, contrast, near_contrast: contrast, score: 0.5, tight: false };
                spare.set(i, j, node);
            }
            self.grow(scene, spare, scene.thresholds.trial_crossings);
            if spare.members.len() > scene.thresholds.trial_crossings {
                spare.forget_attempts();
                self.grow(scene, spare, most_crossings);
            }
            if spare.members.len() > most {
                most = spare.members.len();
                std::mem::swap(grid, spare);
            }
            if most > most_crossings {
                break;
            }
        }
    }

    /// Grows `grid` until it has more than `most` crossings.
    pub(super) fn grow(&mut self, scene: LatticeScene<'_>, grid: &mut Grid, most: usize) {
        self.queue.clear();
        for index in 0..grid.members.len() {
            let (i, j) = grid.members[index];
            self.push_around(i, j);
        }
        while let Some((i, j)) = self.queue.pop_front() {
            if grid.members.len() > most {
                return;
            }
            if !grid.attempt(i, j) {
                continue;
            }
            if let (Some(node), _) = self.detect_at(scene, grid, (i, j), false) {
                grid.set(i, j, node);
                self.push_around(i, j);
            }
        }
    }

    /// Measures each of `places` that is not known yet, so many times over: what is found predicts
    /// others. A place near which nothing was found since is not measured again.
    pub(super) fn detect_missing(
        &mut self,
        scene: LatticeScene<'_>,
        grid: &mut Grid,
        places: &[(i32, i32)],
        rounds: usize,
    ) {
        // By place: how many were found before it was measured, and within how many lines the
        // others decided on the outcome.
        let mut missed = vec![(0, i32::MAX); places.len()];
        let mut found: Vec<(i32, i32)> = Vec::new();
        for _ in 0..rounds {
            let before = found.len();
            for (&(i, j), (since, reach)) in places.iter().zip(&mut missed) {
                let away = |at: &(i32, i32)| (at.0 - i).abs().max((at.1 - j).abs());
                let is_new = |at: &(i32, i32)| away(at) <= *reach;
                if grid.get(i, j).is_some()
                    || *reach < i32::MAX && !found[*since..].iter().any(is_new)
                {
                    continue;
                }
                let (node, within) = self.detect_at(scene, grid, (i, j), true);
                (*since, *reach) = (found.len(), within);
                if let Some(node) = node {
                    grid.set(i, j, node);
                    found.push((i, j));
                }
            }
            if found.len() == before {
                return;
            }
        }
    }

    fn push_around(&mut self, i: i32, j: i32) {
        self.queue.extend([(i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1)]);
    }

    /// Where the others of `grid` put the crossing (i, j), and one unit along each axis there.
    pub(super) fn predict(
        &mut self,
        sheets: &Sheets,
        grid: &Grid,
        at: (i32, i32),
    ) -> Option<(Vec2, [Vec2; 2])> {
        self.predict_within(sheets, grid, at).0
    }

    /// The same, and within how many lines the others decide on it.
    pub(super) fn predict_within(
        &mut self,
        sheets: &Sheets,
        grid: &Grid,
        (i, j): (i32, i32),
    ) -> (Option<(Vec2, [Vec2; 2])>, i32) {
        let Some(chart) = Chart::near(grid, sheets, (i, j), Some((i, j)), &mut self.pairs) else {
            return (None, FARTHEST);
        };
        let (x, y) = (sheets.line(i), sheets.line(j));
        (chart.at(x, y).zip(chart.steps(x, y)), chart.reach)
    }

    /// The crossing (i, j), if the image shows one where the others put it; and within how many
    /// lines these are.
    fn detect_at(
        &mut self,
        scene: LatticeScene<'_>,
        grid: &Grid,
        at: (i32, i32),
        labeled: bool,
    ) -> (Option<Node>, i32) {
        self.places += 1;
        let (Some((expected, steps)), reach) = self.predict_within(scene.sheets, grid, at) else {
            return (None, FARTHEST);
        };
        let (contrast, near) = contrast_near(grid, at.0, at.1);
        let place = Expected {
            pixel: expected,
            steps,
            polarity: grid.polarity(at.0, at.1),
            contrast,
            labeled,
        };
        let node = place.detect(scene).or_else(|| {
            let curved = predict_curved(scene.sheets, grid, at)?;
            Expected { pixel: curved, ..place }.detect(scene)
        });
        (node, reach.max(near).max(CURVED))
    }
}

/// A place at which a crossing is expected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected {
    pub pixel: Vec2,
    /// One unit of the lattice along each axis, in pixels.
    pub steps: [Vec2; 2],
    pub polarity: f32,
    /// Of the crossings next to it.
    pub contrast: f32,
    /// It is a place of a board that is labeled.
    pub labeled: bool,
}

impl Expected {
    /// The crossing there.
    pub(super) fn detect(&self, scene: LatticeScene<'_>) -> Option<Node> {
        let narrow = scene.sheets.widths[0].min(scene.sheets.widths[1]);
        let cell = self.steps.map(|step| step * narrow);
        let limits = scene.thresholds;
        let (least_score, least_contrast) = if self.labeled {
            (limits.least_known_score, limits.least_known_contrast)
        } else {
            (limits.least_score, limits.least_contrast)
        };
        let is_it = |node: &Node| {
            in_steps(node.pixel - self.pixel, cell).is_some_and(|off| {
                node.contrast * self.polarity >= least_contrast * self.contrast
                    && off.x.abs() <= limits.most_off
                    && off.y.abs() <= limits.most_off
            })
        };
        let nearest = self.candidate(scene, cell);
        let places = [nearest.map(|index| scene.candidates[index].pixel), Some(self.pixel)];
        let reaches = [limits.most_reach_px, limits.close_reach_px];
        let reaches = &reaches[..if self.labeled { 2 } else { 1 }];
        reaches.iter().find_map(|&most_px| {
            places.iter().flatten().find_map(|&place| {
                settle(scene, place, self.steps, least_score, most_px).filter(is_it)
            })
        })
    }

    /// The candidate nearest to it whose edges run as they must: it is nearer to the truth than
    /// what the other crossings predict.
    fn candidate(&self, scene: LatticeScene<'_>, cell: [Vec2; 2]) -> Option<usize> {
        let edges = edges_along(self.steps, self.polarity);
        let alike =
            |candidate: &Candidate| candidate.has_edges(edges, scene.thresholds.most_rotation);
        let reach = (scene.thresholds.most_off * cell[0].norm().max(cell[1].norm())).max(1.5);
        scene.neighborhood.nearest(scene.candidates, self.pixel, reach, alike)
    }
}

/// Where the lines that end beside the crossing (i, j) put it if they go on bending: a polynomial
/// of second order through the last three crossings of each.
pub(super) fn predict_curved(sheets: &Sheets, grid: &Grid, (i, j): (i32, i32)) -> Option<Vec2> {
    let (mut sum, mut count) = (Vec2::zeros(), 0.0);
    for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        let at = |k: i32| sheets.line(if dj == 0 { i + k * di } else { j + k * dj });
        let pixel = |k: i32| grid.pixel(i + k * di, j + k * dj);
        if let (Some(p), Some(q), Some(r)) = (pixel(1), pixel(2), pixel(3)) {
            let [t, a, b, c] = [at(0), at(1), at(2), at(3)];
            sum += p * ((t - b) * (t - c) / ((a - b) * (a - c)))
                + q * ((t - a) * (t - c) / ((b - a) * (b - c)))
                + r * ((t - a) * (t - b) / ((c - a) * (c - b)));
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}

/// How far the crossing (i, j) lies from where the lines that end beside it put it, in narrow
/// intervals as its neighbors on them have these.
pub(super) fn off_lines(sheets: &Sheets, grid: &Grid, (i, j): (i32, i32)) -> Option<f32> {
    let narrow = sheets.widths[0].min(sheets.widths[1]);
    let cell = |di: i32, dj: i32| {
        let at =
            |k: i32| Some((sheets.line(i * di + j * dj + k), grid.pixel(i + k * di, j + k * dj)?));
        let ((first, p), (last, q)) = match (at(-1), at(1)) {
            (Some(before), Some(after)) => (before, after),
            (None, after) => (at(0)?, after?),
            (before, None) => (before?, at(0)?),
        };
        Some((q - p) * (narrow / (last - first)))
    };
    let off = grid.pixel(i, j)? - predict_curved(sheets, grid, (i, j))?;
    in_steps(off, [cell(1, 0)?, cell(0, 1)?]).map(|off| off.amax())
}

/// The crossing at `expected`, wherever exactly it settles in windows that end short of what is
/// beyond white and black around it.
pub(super) fn settle(
    scene: LatticeScene<'_>,
    expected: Vec2,
    steps: [Vec2; 2],
    least_score: f32,
    most_px: f32,
) -> Option<Node> {
    let LatticeScene { image, sheets, thresholds: limits, .. } = scene;
    let [u, v] = steps;
    let shortest = u.norm().min(v.norm()).max(1e-3);
    let reach = (limits.reach * sheets.room).max(limits.least_reach_px / shortest);
    let window = |center| CrossWindow::on_board(center, u, v, reach, most_px).inside(image, 0.4);
    let first = window(expected)?.measure_above(image, limits.least_first_score)?;
    let mut cross = window(first.center)?.measure(image)?;
    if cross.score < least_score {
        cross = window(cross.center)?.measure_above(image, least_score)?;
    }
    // A corner of one square alone is as much like a crossing, but for its opposite square.
    let depth = window(cross.center)?.alternation(image)?;
    if depth * cross.contrast.signum() < limits.least_alternation * cross.contrast.abs() {
        return None;
    }
    Some(Node {
        pixel: cross.center,
        contrast: cross.contrast,
        near_contrast: cross.contrast,
        score: cross.score,
        tight: false,
    })
}

/// Mean contrast of the crossings next to (i, j), and within how many lines they are.
fn contrast_near(grid: &Grid, i: i32, j: i32) -> (f32, i32) {
    for reach in [1, 3, FARTHEST] {
        let (mut sum, mut count) = (0.0, 0.0);
        for dj in -reach..=reach {
            for di in -reach..=reach {
                if let Some(node) = grid.get(i + di, j + dj) {
                    sum += node.contrast.abs();
                    count += 1.0;
                }
            }
        }
        if count > 0.0 {
            return (sum / count, reach);
        }
    }
    (0.0, FARTHEST)
}

/// Which cells of the lattice a seed's square may be: the index of its first corner, and whether
/// cell (0, 0) is bright. Where intervals alternate, cell (0, 0) is a tag's: dark unless the grid
/// is `inverted`.
fn starts(scene: LatticeScene<'_>, seed: &Seed, inverted: bool) -> Vec<((i32, i32), bool)> {
    if !scene.sheets.alternates() {
        return vec![((0, 0), seed.bright)];
    }
    let [p, a, b, d] = seed.corners.map(|index| scene.candidates[index].pixel);
    let along = (a - p).norm() + (d - b).norm();
    let across = (b - p).norm() + (d - a).norm();
    // A cell of the tags' color is a tag or a corner square, another one lies between two tags.
    let firsts = match (seed.bright == inverted, along > across) {
        (true, _) => [(1, 1), (0, 0)],
        (false, true) => [(0, 1), (1, 0)],
        (false, false) => [(1, 0), (0, 1)],
    };
    firsts.map(|first| (first, inverted)).to_vec()
}
