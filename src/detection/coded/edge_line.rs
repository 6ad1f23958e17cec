//! An edge measured across in several places, and the straight line through them.
//!
//! Places where something covers the edge are outliers (P. J. Rousseeuw and A. M. Leroy: Robust
//! Regression and Outlier Detection, 1987).

use crate::detection::measure::cross::Vec2;
use crate::detection::measure::edges::sample;
use crate::imaging::gray::GrayView;

/// Places along an edge in which it is measured, and how many of them must agree: half, fewer may
/// be something else's edge.
pub(super) const PLACES: usize = 12;
const LEAST_PLACES: usize = PLACES / 2;
/// Samples across an edge in each place.
const ACROSS: usize = 16;
/// Samples at either end of these that are black or white alone.
const OUTER: usize = ACROSS / 4;
/// The part of an edge's contrast by which one place's black or white may differ from the median.
/// From 0.1 to 0.15 the same corners are answered; from 0.25 on, some under glare that are 1 px
/// off.
const MOST_UNEVEN: f32 = 0.15;
/// The median distance from a median, in standard deviations of a normal distribution.
pub(super) const DEVIATIONS: f32 = 0.6745;
/// An offset farther off than this many standard deviations is an outlier.
pub(super) const OUTLYING: f32 = 2.5;

/// How far an edge is from where it is expected: in pixels, along the axis that crosses it; and the
/// variance of that, for places that have a variance of 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    pub px: f32,
    pub variance: f32,
}

/// The line through an edge's places.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgeLine {
    /// Where the places are counted from.
    pub here: Offset,
    /// So many pixels from there.
    pub there: Offset,
    /// Covariance of the two.
    pub covariance: f32,
}

/// One place of an edge.
#[derive(Debug, Clone, Copy)]
struct EdgePlace {
    /// How far along the edge, and how far from the prediction across, in pixels.
    along: f32,
    off: f32,
    /// Gray on the near side of the axis across, and on the far one.
    grays: [f32; 2],
}

/// The places of one edge; buffers are kept.
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

    /// Adds what `image` shows at `center`, `along` pixels from where places are counted, `half_px`
    /// to either side in the direction `across`.
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

    /// Keeps of `places` those whose black and white are as at most of them; `None` if black is not
    /// darker than white.
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

    /// The straight line through the offsets of `places`: its offsets at its start and so many
    /// pixels from it. `None` if too few agree.
    pub(super) fn line(&mut self, length_px: f32) -> Option<EdgeLine> {
        if self.places.len() < LEAST_PLACES {
            return None;
        }
        let Self { places, sorted } = self;
        // Repeated medians (A. F. Siegel, 1982): half of the places may be anything.
        let mut slopes = [0.0; PLACES];
        for (slope, a) in slopes.iter_mut().zip(places.iter()) {
            let others = places.iter().filter(|b| b.along != a.along);
            *slope = median(sorted, others.map(|b| (b.off - a.off) / (b.along - a.along)));
        }
        let count = places.len();
        let slope = median(sorted, slopes[..count].iter().copied());
        let start = median(sorted, places.iter().map(|it| it.off - slope * it.along));
        let rest = |it: &EdgePlace| (it.off - start - slope * it.along).abs();
        // With few places the median residual is too small (Rousseeuw and Leroy).
        let few = 1.0 + 5.0 / (count - 2) as f32;
        let most = OUTLYING * few * median(sorted, places.iter().map(rest)) / DEVIATIONS;
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
    /// What `image` shows across a side at `center`, so far along it.
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
        // Of a step so far off, the mean is that much nearer to the gray on its other side.
        let off = half_px * (near + far - 2.0 * mean(&grays)) / (far - near);
        (off.abs() <= 0.5 * half_px).then_some(Self { along, off, grays: [near, far] })
    }
}

/// The median of `values`, sorted in `buffer`; 0 of none.
pub(super) fn median(buffer: &mut Vec<f32>, values: impl Iterator<Item = f32>) -> f32 {
    buffer.clear();
    buffer.extend(values);
    let middle = buffer.len() / 2;
    if buffer.is_empty() { 0.0 } else { *buffer.select_nth_unstable_by(middle, f32::total_cmp).1 }
}
