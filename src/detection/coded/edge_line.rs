//! An edge that is measured at several places along it, and the straight line through these
//! measurements.
//!
//! Places where something occludes the edge are outliers (P. J. Rousseeuw and A. M. Leroy: Robust
//! Regression and Outlier Detection, 1987).

use crate::detection::measure::edges::sample;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

/// Places along an edge at which it is measured (chosen, not swept), and how many of them must be
/// inliers: half, since fewer may be on the edge of something else.
pub(super) const PLACES: usize = 12;
const LEAST_PLACES: usize = PLACES / 2;
/// Samples across an edge at each place.
const ACROSS: usize = 16;
/// Samples at either end of these that are entirely black or white.
const OUTER: usize = ACROSS / 4;
/// The fraction of an edge's contrast by which the black or white of one place may differ from the
/// median. From 0.1 to 0.15 the same corners are answered; from 0.25 on, some under glare that are
/// 1 px off.
const MOST_UNEVEN: f32 = 0.15;
/// The median absolute deviation of a normal distribution, in standard deviations.
pub(super) const NORMAL_MEDIAN: f32 = 0.6745;
/// An offset with a residual of more than this many standard deviations is an outlier: of normal
/// ones, one in 80 (Rousseeuw and Leroy).
pub(super) const OUTLIER_STDS: f32 = 2.5;

/// The distance of an edge from its prediction, in pixels along the axis that crosses it; and its
/// variance, if each place has a variance of 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    pub px: f32,
    pub variance: f32,
}

/// The line through an edge's places.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgeLine {
    /// At the start of the places.
    pub here: Offset,
    /// At the other end.
    pub there: Offset,
    /// Covariance of the two offsets.
    pub covariance: f32,
}

/// One place of an edge.
#[derive(Debug, Clone, Copy)]
struct EdgePlace {
    /// The distance along the edge, and the offset from the prediction across it, in pixels.
    along: f32,
    off: f32,
    /// The gray on the near side and on the far side of the edge.
    grays: [f32; 2],
}

/// The places of one edge; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct EdgePlaces {
    places: Vec<EdgePlace>,
    sorted: Vec<f32>,
}

impl EdgePlaces {
    /// Forgets all places.
    pub(super) fn clear(&mut self) {
        self.places.clear();
    }

    /// Adds the place at `center` of `image`, `along` pixels from the start, sampled `half_px` to
    /// either side in the direction `across`.
    pub(super) fn measure(
        &mut self,
        image: GrayView<'_>,
        center: Vec2,
        along: f32,
        across: Vec2,
        half_px: f32,
    ) {
        self.places.extend(EdgePlace::measure(image, center, along, across, half_px));
    }

    /// Keeps the places whose black and white are like the median's; `None` if black is not darker
    /// than white.
    pub(super) fn keep_alike(&mut self, bright: f32) -> Option<()> {
        if self.places.len() < LEAST_PLACES {
            return None;
        }
        let grays =
            [0, 1].map(|k| median(&mut self.sorted, self.places.iter().map(|it| it.grays[k])));
        let contrast = (grays[1] - grays[0]) * bright;
        let most = MOST_UNEVEN * contrast;
        self.places.retain(|it| (0..2).all(|k| (it.grays[k] - grays[k]).abs() <= most));
        (contrast > 0.0).then_some(())
    }

    /// The straight line through the offsets of `places`: its offset at the start, and at
    /// `length_px` from it. `None` if there are too few inliers.
    pub(super) fn line(&mut self, length_px: f32) -> Option<EdgeLine> {
        if self.places.len() < LEAST_PLACES {
            return None;
        }
        let Self { places, sorted } = self;
        // Repeated medians (A. F. Siegel, 1982): up to half of the places may be outliers.
        let mut slopes = [0.0; PLACES];
        for (slope, a) in slopes.iter_mut().zip(places.iter()) {
            let others = places.iter().filter(|b| b.along != a.along);
            *slope = median(sorted, others.map(|b| (b.off - a.off) / (b.along - a.along)));
        }
        let count = places.len();
        let slope = median(sorted, slopes[..count].iter().copied());
        let start = median(sorted, places.iter().map(|it| it.off - slope * it.along));
        let rest = |it: &EdgePlace| (it.off - start - slope * it.along).abs();
        // With few places the median residual underestimates the scatter (Rousseeuw and Leroy).
        let few = 1.0 + 5.0 / (count - 2) as f32;
        let most = OUTLIER_STDS * few * median(sorted, places.iter().map(rest)) / NORMAL_MEDIAN;
        places.retain(|it| rest(it) <= most);
        let n = places.len();
        if n < LEAST_PLACES {
            return None;
        }
        let mean = |of: fn(&EdgePlace) -> f32| places.iter().map(of).sum::<f32>() / n as f32;
        let (along, off) = (mean(|it| it.along), mean(|it| it.off));
        let (mut squares, mut products) = (0.0, 0.0);
        for it in places.iter() {
            squares += (it.along - along).powi(2);
            products += (it.along - along) * (it.off - off);
        }
        let slope = products / squares;
        let covariance = |a: f32, b: f32| 1.0 / n as f32 + (a - along) * (b - along) / squares;
        let offset =
            |at: f32| Offset { px: off + slope * (at - along), variance: covariance(at, at) };
        slope.is_finite().then(|| EdgeLine {
            here: offset(0.0),
            there: offset(length_px),
            covariance: covariance(0.0, length_px),
        })
    }
}

impl EdgePlace {
    /// Measures the edge at `center` in `image`, `along` pixels from the start.
    fn measure(
        image: GrayView<'_>,
        center: Vec2,
        along: f32,
        across: Vec2,
        half_px: f32,
    ) -> Option<Self> {
        let mut grays = [0.0; ACROSS];
        for (nth, gray) in grays.iter_mut().enumerate() {
            let part = (2 * nth + 1) as f32 / ACROSS as f32 - 1.0;
            *gray = sample(image, center + across * (part * half_px))?;
        }
        let mean = |of: &[f32]| of.iter().sum::<f32>() / of.len() as f32;
        let [near, far] = [mean(&grays[..OUTER]), mean(&grays[ACROSS - OUTER..])];
        // The mean over a step that is off-center is closer to the gray on its wider side.
        let off = half_px * (near + far - 2.0 * mean(&grays)) / (far - near);
        (off.abs() <= 0.5 * half_px).then_some(Self { along, off, grays: [near, far] })
    }
}

/// The median of `values`, sorted in `buffer`; 0 if there are none.
pub(super) fn median(buffer: &mut Vec<f32>, values: impl Iterator<Item = f32>) -> f32 {
    buffer.clear();
    buffer.extend(values);
    let middle = buffer.len() / 2;
    if buffer.is_empty() { 0.0 } else { *buffer.select_nth_unstable_by(middle, f32::total_cmp).1 }
}
