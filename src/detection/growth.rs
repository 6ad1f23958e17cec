//! From one square to the whole grid: each position beside a known corner is measured in the image
//! itself.
//!
//! A corner that is not among the candidates is found all the same: its position, the directions of
//! its edges and which of its squares are bright are predicted.

use std::collections::VecDeque;

use super::candidates::Candidate;
use super::cross::{CrossWindow, Vec2, in_steps};
use super::curved_board::predict_on_curve;
use super::edges::is_edge;
use super::grid::{Bounds, Grid, Node};
use super::perspective::Perspective;
use super::seeds::{Neighborhood, Seed};
use crate::imaging::gray::GrayView;

/// Minimum alternation of the four squares, as a share of the contrast.
const LEAST_ALTERNATION: f32 = 0.3;
/// Largest distance of a corner from its prediction, in steps of the grid.
const MOST_OFF: f32 = 0.4;
/// The same where no neighbor is known.
const MOST_OFF_FAR: f32 = 0.2;
/// Largest distance of a candidate from its prediction, in steps: to the side, nearer and farther.
/// Less than the error of a step that skips two occluded corners, or of the one after it. And the
/// sine of the largest rotation of its edges.
const MOST_ASIDE: f32 = 0.45;
const MOST_NEARER: f32 = 0.45;
const MOST_FARTHER: f32 = 0.75;
const MOST_TURN: f32 = 0.5;
/// A position this far from another, in steps, is measured separately.
const ELSEWHERE: f32 = 0.15;
/// The immediate surroundings of a corner, as part of the distance to its neighbors.
const NEAR: f32 = 0.16;
/// Minimum contrast in the immediate surroundings, as a share of the neighbors'.
const LEAST_NEAR_CONTRAST: f32 = 0.5;
/// Minimum correlation with a chessboard corner there.
const LEAST_NEAR_SCORE: f32 = 0.65;
/// Minimum correlation with a chessboard corner at a predicted position, before it is refined.
const LEAST_FIRST_SCORE: f32 = 0.25;
/// Minimum increase of the correlation from one measurement to the next for another iteration.
const LEAST_GAIN: f32 = 0.1;
/// Smallest reach of a window, in pixels.
const LEAST_REACH_PX: f32 = 2.0;

/// Minimum correlation in a narrower window for its corner to be accepted.
const LEAST_NARROW_SCORE: f32 = 0.6;
/// Minimum contrast of a narrower window, as a share of the widest's: with less, blur fills the
/// window.
const LEAST_NARROW_CONTRAST: f32 = 0.6;

/// A window's size, and the thresholds that it must pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindowSize {
    /// Reach, as part of the distance to the neighbors.
    reach: f32,
    /// Largest reach, in pixels.
    most_px: f32,
    /// Minimum correlation with a chessboard corner.
    least_score: f32,
    /// Minimum contrast, as a share of the neighbors'.
    least_contrast: f32,
    /// Largest distance from the prediction, in steps.
    most_off: f32,
}

/// As large as squares allow.
const WIDE: WindowSize =
    WindowSize { reach: 0.4, most_px: 16.0, least_score: 0.62, least_contrast: 0.3, most_off: 0.4 };
/// Beside an occluder of the rest of the squares, and very close beside it.
const NARROW: WindowSize = WindowSize {
    reach: 0.16,
    most_px: 8.0,
    least_score: 0.72,
    least_contrast: 0.5,
    most_off: 0.15,
};
const CLOSE: WindowSize =
    WindowSize { reach: 0.08, most_px: 4.0, least_score: 0.75, least_contrast: 0.4, most_off: 0.1 };
/// For tracking from image to image: as far as its squares reach, at positions some pixels apart.
pub(super) const FOLLOWED: WindowSize = WindowSize { most_px: f32::MAX, ..WIDE };
pub(super) const WINDOWS: [WindowSize; 3] = [WIDE, NARROW, CLOSE];

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
            grid.set(i, j, Node { pixel, contrast, near_contrast: 0.0, score: 0.5, tight: false });
        }
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let settled = grid
                .get(i, j)
                .zip(grid.steps(i, j))
                .and_then(|(n, steps)| settle(image, n.pixel, steps, WIDE));
            if let Some(node) = settled {
                grid.set(i, j, node);
            }
        }
        self.grow(image, grid, &WINDOWS[..1]);
    }

    /// Grows `grid` as far as `image` shows corners in windows of these `sizes`.
    pub(super) fn grow(&mut self, image: GrayView<'_>, grid: &mut Grid, sizes: &[WindowSize]) {
        self.grow_to(image, grid, sizes, usize::MAX);
    }

    /// The same, up to `most` corners.
    pub(super) fn grow_to(
        &mut self,
        image: GrayView<'_>,
        grid: &mut Grid,
        sizes: &[WindowSize],
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
            if let Some(node) =
                Prediction::by_neighbors(grid, i, j).and_then(|place| place.measure(image, sizes))
            {
                grid.set(i, j, node);
                self.push_around(i, j);
            }
        }
    }

    /// Continues from the corners of `grid` to candidates farther off than predicted, as where a
    /// lens compresses the board, and grows from there.
    pub(super) fn reach(
        &mut self,
        image: GrayView<'_>,
        candidates: &[Candidate],
        neighborhood: &Neighborhood,
        grid: &mut Grid,
    ) {
        grid.forget_attempts();
        let mut from = 0;
        while let Some(&(i, j)) = grid.members.get(from) {
            for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
                let place = Stretch::from(grid, (i, j), (di, dj));
                if let Some(node) =
                    place.and_then(|place| place.measure(image, candidates, neighborhood))
                {
                    grid.set(i + di, j + dj, node);
                    self.grow(image, grid, &WINDOWS[..1]);
                }
            }
            from += 1;
        }
    }

    /// Searches, within `bounds`, the positions that growth did not reach, and grows from what is
    /// found.
    pub(super) fn bridge(&mut self, image: GrayView<'_>, grid: &mut Grid, bounds: Bounds) {
        let Some(mut perspective) = Perspective::fit(grid) else { return };
        for j in bounds.j.0..=bounds.j.1 {
            for i in bounds.i.0..=bounds.i.1 {
                if grid.get(i, j).is_some() {
                    continue;
                }
                let place = Prediction::by_perspective(&perspective, grid, i, j);
                let seen = place.and_then(|place| place.measure(image, &WINDOWS));
                let seen = seen.or_else(|| {
                    Prediction::on_curved_board(grid, i, j, place)?.measure(image, &WINDOWS)
                });
                let Some(node) = seen else { continue };
                grid.set(i, j, node);
                self.grow(image, grid, &WINDOWS);
                let Some(fitted) = Perspective::fit(grid) else { return };
                perspective = fitted;
            }
        }
    }

    fn push_around(&mut self, i: i32, j: i32) {
        self.queue.extend([(i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1)]);
    }
}

/// Prediction of a corner: position and appearance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prediction {
    /// Where.
    pub expected: Vec2,
    /// From there to the next corner along i and along j.
    pub steps: [Vec2; 2],
    /// Sign of its contrast.
    pub polarity: f32,
    /// Contrast of its neighbors, and the same very near to them.
    pub contrast: [f32; 2],
    /// Largest distance from the prediction, in steps.
    pub most_off: f32,
}

impl Prediction {
    pub(super) fn by_neighbors(grid: &Grid, i: i32, j: i32) -> Option<Self> {
        Some(Self {
            expected: grid.predict(i, j)?,
            steps: grid.steps(i, j)?,
            polarity: grid.polarity(i, j),
            contrast: contrast_near(grid, i, j, 1),
            most_off: MOST_OFF,
        })
    }

    fn by_perspective(perspective: &Perspective, grid: &Grid, i: i32, j: i32) -> Option<Self> {
        Some(Self {
            expected: perspective.predict(grid, i, j)?,
            steps: perspective.steps(i, j)?,
            polarity: grid.polarity(i, j),
            contrast: contrast_near(grid, i, j, 3),
            most_off: MOST_OFF_FAR,
        })
    }

    /// The prediction on a curved board, if it differs from `before`.
    fn on_curved_board(grid: &Grid, i: i32, j: i32, before: Option<Self>) -> Option<Self> {
        let beside = [(1, 0), (0, 1), (-1, 0), (0, -1)]
            .into_iter()
            .any(|(di, dj)| grid.get(i + di, j + dj).is_some());
        let place = Self {
            expected: predict_on_curve(grid, i, j).filter(|_| beside)?,
            ..Self::by_neighbors(grid, i, j)?
        };
        let off = before.and_then(|before| in_steps(place.expected - before.expected, place.steps));
        (off.is_none_or(|off| off.x.abs().max(off.y.abs()) > ELSEWHERE)).then_some(place)
    }

    /// The corner there, in the first of the windows that shows one.
    pub(super) fn measure(&self, image: GrayView<'_>, sizes: &[WindowSize]) -> Option<Node> {
        sizes.iter().find_map(|&size| {
            let node = settle(image, self.expected, self.steps, size)?;
            let off = in_steps(node.pixel - self.expected, self.steps)?;
            let most = self.most_off.min(size.most_off);
            let fits = node.contrast * self.polarity >= size.least_contrast * self.contrast[0]
                && node.near_contrast * self.polarity >= LEAST_NEAR_CONTRAST * self.contrast[1]
                && off.x.abs() <= most
                && off.y.abs() <= most;
            let alternates = |reach, contrast| alternates(image, &node, self, reach, contrast);
            (fits
                && alternates(size.reach, node.contrast)
                && alternates(NEAR.min(size.reach), node.near_contrast))
            .then_some(node)
        })
    }
}

/// A position beside a corner at which nothing was found, to be searched for farther off.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    place: Prediction,
    /// The corner it lies beside, and along which of the steps, forward or back.
    from: Node,
    axis: usize,
    forward: f32,
}

impl Stretch {
    /// The position from the corner (i, j) of `grid` towards (di, dj), if it is free.
    fn from(grid: &Grid, (i, j): (i32, i32), (di, dj): (i32, i32)) -> Option<Self> {
        let (from, (i, j)) = (grid.get(i, j)?, (i + di, j + dj));
        if grid.get(i, j).is_some() || !grid.holds(i, j) {
            return None;
        }
        let axis = usize::from(dj != 0);
        Some(Self {
            place: Prediction::by_neighbors(grid, i, j)?,
            from,
            axis,
            forward: (di + dj) as f32,
        })
    }

    /// The corner there: at a candidate of the right polarity, with an edge all the way to it.
    fn measure(
        &self,
        image: GrayView<'_>,
        candidates: &[Candidate],
        neighborhood: &Neighborhood,
    ) -> Option<Node> {
        let Prediction { expected, steps, polarity, .. } = self.place;
        let way = |k: usize| steps[k] / steps[k].norm().max(1e-3);
        let edges = if polarity > 0.0 { [way(0), way(1)] } else { [way(1), way(0)] };
        let turn = |a: Vec2, b: Vec2| (a.x * b.y - a.y * b.x).abs();
        let fits = |candidate: &Candidate| {
            turn(candidate.edges[0], edges[0]) < MOST_TURN
                && turn(candidate.edges[1], edges[1]) < MOST_TURN
                && in_steps(candidate.pixel - expected, steps).is_some_and(|off| {
                    let (along, aside) =
                        if self.axis == 0 { (off.x, off.y) } else { (off.y, off.x) };
                    aside.abs() < MOST_ASIDE
                        && (-MOST_NEARER..MOST_FARTHER).contains(&(along * self.forward))
                })
        };
        let reach =
            MOST_FARTHER * steps[self.axis].norm() + MOST_ASIDE * steps[1 - self.axis].norm();
        let at = candidates[neighborhood.nearest(candidates, expected, reach, fits)?].pixel;
        let mut steps = steps;
        steps[self.axis] = (at - self.from.pixel) * self.forward;
        let node =
            Prediction { expected: at, steps, ..self.place }.measure(image, &WINDOWS[..1])?;
        // Beyond +i, the square on the side of +v has the opposite of the farther corner's
        // polarity; a quarter turn changes the sign.
        let (aside, sign) =
            if self.axis == 0 { (steps[1], self.forward) } else { (steps[0], self.forward) };
        let contrast = -0.5 * (node.contrast.abs() + self.from.contrast.abs()) * polarity * sign;
        is_edge(image, self.from.pixel, node.pixel, aside, contrast)
            .filter(|&holds| holds)
            .map(|_| node)
    }
}

/// The corner at `expected`, refined in the image.
pub(super) fn settle(
    image: GrayView<'_>,
    expected: Vec2,
    steps: [Vec2; 2],
    size: WindowSize,
) -> Option<Node> {
    let window = |center, reach| window(center, steps, reach, size.most_px).inside(image, 0.25);
    let first = window(expected, size.reach)?.measure_above(image, LEAST_FIRST_SCORE)?;
    let mut cross = window(first.center, size.reach)?.measure(image)?;
    let mut before = first.score;
    // A corner far from its prediction comes nearer with every iteration.
    while cross.score < size.least_score {
        if cross.score < before + LEAST_GAIN {
            return None;
        }
        before = cross.score;
        cross = window(cross.center, size.reach)?.measure(image)?;
    }
    // Uneven light or an occluder disturbs a narrow window less than a wide one.
    let near = window(cross.center, NEAR)?.measure_above(image, LEAST_NEAR_SCORE)?;
    let sharp = near.contrast / cross.contrast > LEAST_NARROW_CONTRAST;
    let pixel = if sharp { near.center } else { cross.center };
    let tight = size.reach < WIDE.reach;
    Some(Node {
        pixel,
        contrast: cross.contrast,
        near_contrast: near.contrast,
        score: cross.score,
        tight,
    })
}

/// Moves each corner of `grid`, found on a coarser level and scaled to this one, to where `image`
/// shows it. A corner that is not found there is searched for where its neighbors predict it.
pub(super) fn sharpen_all(
    image: GrayView<'_>,
    grid: &mut Grid,
    sizes: &[WindowSize],
    reaches: &[f32],
) {
    grid.suspect.clear();
    for index in 0..grid.members.len() {
        let (i, j) = grid.members[index];
        if let (Some(node), Some(steps)) = (grid.get(i, j), grid.steps(i, j)) {
            match sharpen(image, &node, steps, reaches) {
                Some(sharp) => grid.set(i, j, sharp),
                None => grid.suspect.push((i, j)),
            }
        }
    }
    for index in 0..grid.suspect.len() {
        let (i, j) = grid.suspect[index];
        if let Some(node) =
            Prediction::by_neighbors(grid, i, j).and_then(|place| place.measure(image, sizes))
        {
            grid.set(i, j, node);
        }
    }
}

/// The corner of `node` where `image` shows it, in windows of `reaches` in turn. `None` if the
/// first shows none.
pub(super) fn sharpen(
    image: GrayView<'_>,
    node: &Node,
    steps: [Vec2; 2],
    reaches: &[f32],
) -> Option<Node> {
    let mut seen = None;
    for &reach in reaches {
        let center = seen.unwrap_or(node.pixel);
        match window(center, steps, reach, WIDE.most_px)
            .inside(image, 0.25)
            .and_then(|window| window.measure(image))
        {
            Some(cross)
                if cross.score > LEAST_NARROW_SCORE
                    && cross.contrast / node.contrast > LEAST_NARROW_CONTRAST =>
            {
                seen = Some(cross.center);
            }
            _ => break,
        }
    }
    seen.map(|pixel| Node { pixel, ..*node })
}

fn window(center: Vec2, [u, v]: [Vec2; 2], reach: f32, most_px: f32) -> CrossWindow {
    let shortest = u.norm().min(v.norm()).max(1e-3);
    CrossWindow::on_board(center, u, v, reach.max(LEAST_REACH_PX / shortest), most_px)
}

fn alternates(
    image: GrayView<'_>,
    node: &Node,
    place: &Prediction,
    reach: f32,
    contrast: f32,
) -> bool {
    let window = window(node.pixel, place.steps, 0.8 * reach, f32::MAX).inside(image, 0.1);
    window
        .and_then(|window| window.alternation(image))
        .is_some_and(|depth| depth * place.polarity >= LEAST_ALTERNATION * contrast.abs())
}

/// Mean contrast of the known corners up to `reach` lines from (i, j), and the same very near to
/// them.
fn contrast_near(grid: &Grid, i: i32, j: i32, reach: i32) -> [f32; 2] {
    let (mut wide, mut near, mut count) = (0.0, 0.0, 0.0);
    for dj in -reach..=reach {
        for di in -reach..=reach {
            if let Some(node) = grid.get(i + di, j + dj) {
                wide += node.contrast.abs();
                near += node.near_contrast.abs();
                count += 1.0;
            }
        }
    }
    [wide, near].map(|sum| sum / f32::max(count, 1.0))
}
