//! The motion of a board since the last image: crossings are searched for around a few of its
//! corners, and those that moved alike give the motion of all.
//!
//! The nearest crossing may be another corner of the board, or one inside a marker. The consistency
//! of corners far from each other distinguishes them, and after that the markers do.

use nalgebra::{Matrix2, Matrix3, Vector3};

use crate::detection::measure::Probe;
use crate::detection::search::candidates::{Candidate, CandidateSearch, edges_along};
use crate::detection::search::pyramid::Pyramid;
use crate::detection::search::response::{REACH, Response};
use crate::detection::thresholds::markers::MarkerTrackingThresholds;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// Half the side of the window in which a candidate is measured: there are no candidates closer to
/// the border of the searched patch.
const MARGIN: usize = 2 * REACH;

/// A corner around which crossings are searched for.
#[derive(Debug, Clone, Copy)]
pub(super) struct ReferenceCorner {
    /// Its predicted position.
    pub expected: Vec2,
    /// The narrow interval between lines along each axis there.
    pub cell: [Vec2; 2],
    /// Sign of its contrast in the grid's axes.
    pub polarity: f32,
}

/// A crossing that may be a reference corner.
#[derive(Debug, Clone, Copy)]
struct ReferenceCandidate {
    reference: usize,
    /// Its offset from the prediction.
    off: Vec2,
}

/// The offset of predictions, as a linear function over the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct PredictionOffset {
    middle: Vec2,
    off: Vec2,
    slope: Matrix2<f32>,
}

/// Searches for crossings around reference corners; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct OffsetSearch {
    pyramid: Pyramid,
    response: Response,
    candidates: CandidateSearch,
    seen: Vec<ReferenceCandidate>,
}

impl PredictionOffset {
    /// The offset of a corner from where it is `expected`.
    pub(super) fn at(&self, expected: Vec2) -> Vec2 {
        self.off + self.slope * (expected - self.middle)
    }

    /// The steps of the last image, scaled to this one.
    pub(super) fn stretched(&self, steps: [Vec2; 2]) -> [Vec2; 2] {
        steps.map(|step| step + self.slope * step)
    }

    /// Fits the offsets of `chosen` by least squares, with a prior that favors small slopes.
    fn fitted_to(
        references: &[ReferenceCorner],
        chosen: &[ReferenceCandidate],
        limits: &MarkerTrackingThresholds,
    ) -> Option<Self> {
        let count = chosen.len() as f32;
        let places = || chosen.iter().map(|it| references[it.reference].expected);
        let middle = places().fold(Vec2::zeros(), |sum, place| sum + place) / count;
        let flat = 1.0 / limits.slope.powi(2);
        let mut normal = Matrix3::from_diagonal(&Vector3::new(0.0, flat, flat));
        let mut right = [Vector3::zeros(); 2];
        for (place, one) in places().zip(chosen) {
            let terms = Vector3::new(1.0, place.x - middle.x, place.y - middle.y);
            normal += terms * terms.transpose();
            right[0] += terms * one.off.x;
            right[1] += terms * one.off.y;
        }
        let cholesky = normal.cholesky()?;
        let [x, y] = right.map(|right| cholesky.solve(&right));
        let slope = Matrix2::new(x[1], x[2], y[1], y[2]);
        Some(Self { middle, off: Vec2::new(x[0], y[0]), slope })
    }
}

impl OffsetSearch {
    /// The motion of the board, from crossings on `level` of the image around `references`; `None`
    /// if too few of these moved alike.
    pub(super) fn search(
        &mut self,
        probe: Probe<'_>,
        level: usize,
        references: &[ReferenceCorner],
    ) -> Option<PredictionOffset> {
        let limits = &probe.thresholds.marker_tracking;
        self.seen.clear();
        for (index, reference) in references.iter().enumerate() {
            self.search_around(probe, level, index, reference);
        }
        let least = (limits.least_alike * references.len() as f32).ceil() as usize;
        let mut best: Vec<ReferenceCandidate> = Vec::new();
        for guess in &self.seen {
            let chosen = self.near(references, |it| {
                let distance = references[it].expected - references[guess.reference].expected;
                (guess.off, limits.alike, limits.slope * distance.norm())
            });
            if chosen.len() > best.len() {
                best = chosen;
            }
        }
        let mut offset = None;
        // The second fit is to the crossings closest to the first fit.
        for _ in 0..2 {
            if best.len() < least.max(3) {
                return None;
            }
            let fitted = PredictionOffset::fitted_to(references, &best, limits)?;
            best = self.near(references, |it| {
                (fitted.at(references[it].expected), limits.alike / 2.0, 0.0)
            });
            offset = Some(fitted);
        }
        offset.filter(|_| best.len() >= least)
    }

    /// Collects the crossings around a reference corner that resemble it.
    fn search_around(
        &mut self,
        probe: Probe<'_>,
        level: usize,
        index: usize,
        reference: &ReferenceCorner,
    ) {
        let Self { pyramid, response, candidates, seen } = self;
        let limits = &probe.thresholds.marker_tracking;
        let image = probe.image;
        let reach = limits.reach * image.width().max(image.height()) as f32;
        let half = reach + (MARGIN << level) as f32;
        let Some((patch, origin)) = patch_of(image, reference.expected, half) else { return };
        pyramid.build(patch, level);
        let view = pyramid.level(patch, level);
        response.compute(view, 1);
        candidates.search(probe.at(view), response, 1);
        let scale = (1 << level) as f32;
        for candidate in &candidates.found {
            let pixel = candidate.pixel * scale + Vec2::repeat((scale - 1.0) / 2.0) + origin;
            let off = pixel - reference.expected;
            if off.norm() <= reach && is_alike(candidate, reference, limits.most_rotation) {
                seen.push(ReferenceCandidate { reference: index, off });
            }
        }
    }

    /// For each reference corner, the crossing closest to its offset by `expected` (the offset, and
    /// the tolerance in cells and in pixels), if it is within the tolerance.
    fn near(
        &self,
        references: &[ReferenceCorner],
        expected: impl Fn(usize) -> (Vec2, f32, f32),
    ) -> Vec<ReferenceCandidate> {
        let mut chosen: Vec<ReferenceCandidate> = Vec::with_capacity(references.len());
        let mut nearest = f32::MAX;
        for one in &self.seen {
            let (off, cells, pixels) = expected(one.reference);
            let away = one.off - off;
            let cell = references[one.reference].cell;
            let narrow = cell[0].norm().min(cell[1].norm());
            let is_same = chosen.last().is_some_and(|it| it.reference == one.reference);
            let least = if is_same { nearest } else { f32::MAX };
            let distance = away.norm();
            if distance <= cells * narrow + pixels && distance < least {
                if is_same {
                    chosen.pop();
                }
                chosen.push(*one);
                nearest = distance;
            }
        }
        chosen
    }
}

/// The part of `image` within `half` pixels of `center`, and its origin.
fn patch_of(image: GrayView<'_>, center: Vec2, half: f32) -> Option<(GrayView<'_>, Vec2)> {
    let range = |center: f32, size: usize| {
        let from = (center - half).floor().clamp(0.0, size as f32) as usize;
        let to = (center + half).ceil().clamp(0.0, size as f32) as usize;
        (from, to.saturating_sub(from))
    };
    let (left, width) = range(center.x, image.width());
    let (top, height) = range(center.y, image.height());
    if width.min(height) <= 2 * MARGIN {
        return None;
    }
    let bytes = image.bytes().get(top * image.stride() + left..)?;
    let patch = GrayView::new(width, height, image.stride(), bytes)?;
    Some((patch, Vec2::new(left as f32, top as f32)))
}

/// Whether the edges of a crossing have the directions and the polarity of the reference corner's.
fn is_alike(candidate: &Candidate, reference: &ReferenceCorner, most_rotation: f32) -> bool {
    candidate.has_edges(edges_along(reference.cell, reference.polarity), most_rotation)
}
