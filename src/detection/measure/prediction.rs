//! Measures a corner where it is predicted: by its neighbors, by the homography of the board, or by
//! the curved surface of a distorted board.
//!
//! The position, the directions of the edges and the polarity are all predicted, so a corner needs
//! no candidate.

use crate::detection::grid::curved_board::predict_on_curve;
use crate::detection::grid::perspective::Perspective;
use crate::detection::grid::{Grid, Node, in_steps};
use crate::detection::measure::Probe;
use crate::detection::measure::cross::{CrossWindow, LEAST_INSIDE};
use crate::detection::thresholds::chessboard::{MeasureThresholds, WindowThresholds};
use crate::detection::vec2::Vec2;

/// How far from a corner its four squares are sampled, as a part of the reach of the window that it
/// was measured in; and the least part of that which must lie inside the image. Chosen, not swept.
const ALTERNATION_REACH: f32 = 0.8;
const LEAST_ALTERNATION_INSIDE: f32 = 0.1;

/// Prediction of a corner: position and appearance.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct Prediction {
    /// The expected position.
    pub expected: Vec2,
    /// The steps from there to the next corner along i and along j.
    pub steps: [Vec2; 2],
    /// Sign of its contrast.
    pub polarity: f32,
    /// Contrast of its neighbors, and the same in their immediate vicinity.
    pub contrast: [f32; 2],
    /// Largest distance from the prediction, in steps.
    pub most_off: f32,
}

impl Prediction {
    /// The corner (i, j), predicted by its known neighbors.
    pub(in crate::detection) fn by_neighbors(
        grid: &Grid,
        (i, j): (i32, i32),
        thresholds: &MeasureThresholds,
    ) -> Option<Self> {
        Some(Self {
            expected: grid.predict(i, j)?,
            steps: grid.steps(i, j)?,
            polarity: grid.polarity(i, j),
            contrast: contrast_near(grid, i, j, 1),
            most_off: thresholds.most_off,
        })
    }

    /// The corner (i, j), predicted by the homography of the board.
    pub(in crate::detection) fn by_perspective(
        perspective: &Perspective,
        grid: &Grid,
        i: i32,
        j: i32,
        thresholds: &MeasureThresholds,
    ) -> Option<Self> {
        Some(Self {
            expected: perspective.predict(grid, i, j)?,
            steps: perspective.steps(i, j)?,
            polarity: grid.polarity(i, j),
            contrast: contrast_near(grid, i, j, 3),
            most_off: thresholds.most_off_far,
        })
    }

    /// The corner (i, j), predicted on a curved board, if that differs from `before`.
    pub(in crate::detection) fn on_curved_board(
        grid: &Grid,
        i: i32,
        j: i32,
        before: Option<Self>,
        thresholds: &MeasureThresholds,
    ) -> Option<Self> {
        let beside = [(1, 0), (0, 1), (-1, 0), (0, -1)]
            .into_iter()
            .any(|(di, dj)| grid.get(i + di, j + dj).is_some());
        let place = Self {
            expected: predict_on_curve(grid, i, j).filter(|_| beside)?,
            ..Self::by_neighbors(grid, (i, j), thresholds)?
        };
        let off = before.and_then(|before| in_steps(place.expected - before.expected, place.steps));
        let differs = off.is_none_or(|off| off.x.abs().max(off.y.abs()) > thresholds.elsewhere);
        differs.then_some(place)
    }

    /// The corner there, in the first of `windows` that shows one.
    pub(in crate::detection) fn measure(
        &self,
        probe: Probe<'_>,
        windows: &[WindowThresholds],
    ) -> Option<Node> {
        let thresholds = &probe.thresholds.measure;
        windows.iter().find_map(|&size| {
            let node = settle(probe, self.expected, self.steps, size)?;
            let off = in_steps(node.pixel - self.expected, self.steps)?;
            let most = self.most_off.min(size.most_off);
            let near_contrast = thresholds.least_near_contrast * self.contrast[1];
            let fits = node.contrast * self.polarity >= size.least_contrast * self.contrast[0]
                && node.near_contrast * self.polarity >= near_contrast
                && off.x.abs() <= most
                && off.y.abs() <= most;
            let alternates = |reach, contrast| self.alternates(probe, &node, reach, contrast);
            (fits
                && alternates(size.reach, node.contrast)
                && alternates(thresholds.near_reach.min(size.reach), node.near_contrast))
            .then_some(node)
        })
    }

    /// Whether the four squares around the measured corner `node` are alternately bright and dark.
    fn alternates(&self, probe: Probe<'_>, node: &Node, reach: f32, contrast: f32) -> bool {
        let thresholds = &probe.thresholds.measure;
        let window =
            window(node.pixel, self.steps, [ALTERNATION_REACH * reach, f32::MAX], thresholds);
        window
            .inside(probe.image, LEAST_ALTERNATION_INSIDE)
            .and_then(|window| window.alternation(probe.image))
            .is_some_and(|depth| {
                depth * self.polarity >= thresholds.least_alternation * contrast.abs()
            })
    }
}

/// Measures the corner near `expected` in windows of one size, moved until the score suffices, and
/// then in a narrow one.
pub(in crate::detection) fn settle(
    probe: Probe<'_>,
    expected: Vec2,
    steps: [Vec2; 2],
    size: WindowThresholds,
) -> Option<Node> {
    let (image, thresholds) = (probe.image, &probe.thresholds.measure);
    let window = |center, reach| {
        window(center, steps, [reach, size.most_px], thresholds).inside(image, LEAST_INSIDE)
    };
    let first = window(expected, size.reach)?.measure_above(image, thresholds.least_first_score)?;
    let mut cross = window(first.center, size.reach)?.measure(image)?;
    let mut before = first.score;
    // A corner far from its prediction gets closer with every iteration.
    while cross.score < size.least_score {
        if cross.score < before + thresholds.least_gain {
            return None;
        }
        before = cross.score;
        cross = window(cross.center, size.reach)?.measure(image)?;
    }
    // Uneven light or an occluder affects a narrow window less than a wide one.
    let near = window(cross.center, thresholds.near_reach)?
        .measure_above(image, thresholds.least_near_score)?;
    let sharp = near.contrast / cross.contrast > thresholds.least_narrow_contrast;
    Some(Node {
        pixel: if sharp { near.center } else { cross.center },
        contrast: cross.contrast,
        near_contrast: near.contrast,
        score: cross.score,
        tight: size.reach < probe.thresholds.windows.0[0].reach,
    })
}

/// Moves each corner of `grid`, found on a coarser level and scaled to this one, to its position in
/// this image, in windows of these `reaches`. A corner that is not found is searched for where its
/// neighbors predict it, in these `windows`.
pub(in crate::detection) fn sharpen_all(
    probe: Probe<'_>,
    grid: &mut Grid,
    windows: &[WindowThresholds],
    reaches: &[f32],
) {
    grid.suspect.clear();
    for index in 0..grid.members.len() {
        let (i, j) = grid.members[index];
        if let (Some(node), Some(steps)) = (grid.get(i, j), grid.steps(i, j)) {
            match sharpen(probe, &node, steps, reaches) {
                Some(sharp) => grid.set(i, j, sharp),
                None => grid.suspect.push((i, j)),
            }
        }
    }
    for index in 0..grid.suspect.len() {
        let (i, j) = grid.suspect[index];
        if let Some(node) = Prediction::by_neighbors(grid, (i, j), &probe.thresholds.measure)
            .and_then(|place| place.measure(probe, windows))
        {
            grid.set(i, j, node);
        }
    }
}

/// The corner of `node`, measured in windows of `reaches`, one after the other. `None` if the first
/// shows none.
fn sharpen(probe: Probe<'_>, node: &Node, steps: [Vec2; 2], reaches: &[f32]) -> Option<Node> {
    let thresholds = &probe.thresholds.measure;
    let most_px = probe.thresholds.windows.0[0].most_px;
    let mut seen = None;
    for &reach in reaches {
        let center = seen.unwrap_or(node.pixel);
        match window(center, steps, [reach, most_px], thresholds)
            .inside(probe.image, LEAST_INSIDE)
            .and_then(|window| window.measure(probe.image))
        {
            Some(cross)
                if cross.score > thresholds.least_narrow_score
                    && cross.contrast / node.contrast > thresholds.least_narrow_contrast =>
            {
                seen = Some(cross.center);
            }
            _ => break,
        }
    }
    seen.map(|pixel| Node { pixel, ..*node })
}

/// A window that reaches this many steps, but at most this many pixels.
fn window(
    center: Vec2,
    [u, v]: [Vec2; 2],
    [reach, most_px]: [f32; 2],
    thresholds: &MeasureThresholds,
) -> CrossWindow {
    let shortest = u.norm().min(v.norm()).max(1e-3);
    CrossWindow::on_board(center, u, v, reach.max(thresholds.least_reach_px / shortest), most_px)
}

/// Mean contrast of the known corners up to `reach` lines from (i, j), and the same in their
/// immediate vicinity.
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
