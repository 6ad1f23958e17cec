//! Gradients, and the dominant directions around a keypoint (Lowe 2004, section 5).

use std::f32::consts::TAU;

use crate::features::extrema::Extremum;
use crate::features::plane::Plane;

/// Bins of the histogram of directions.
const BINS: usize = 36;

/// The standard deviation of the histogram's Gaussian window, in keypoint scales.
const WINDOW_SIGMA: f64 = 1.5;

/// Peaks of at least this height relative to the highest are directions of their own.
const LEAST_PEAK: f32 = 0.8;

/// The largest number of directions of one keypoint: a third one hardly ever matches.
const MAX_DIRECTIONS: usize = 2;

/// Length and direction (0 to 2π) of the luma gradient at each pixel; undefined at the border.
#[derive(Default)]
pub(super) struct Gradients {
    pub width: usize,
    pub height: usize,
    /// Row by row, with [`Self::PADDING`] additional values, as are the directions.
    pub lengths: Vec<f32>,
    /// In the same order.
    pub directions: Vec<f32>,
}

impl Gradients {
    /// The number of pixels that can be read starting from any pixel.
    pub const PADDING: usize = 16;

    /// Computes the gradients of `plane`.
    pub fn fill(&mut self, plane: &Plane) {
        (self.width, self.height) = (plane.width, plane.height);
        let len = plane.values.len() + Self::PADDING;
        self.lengths.resize(len, 0.0);
        self.directions.resize(len, 0.0);
        pulp::Arch::new().dispatch(Fill { plane, gradients: self });
    }
}

struct Fill<'a> {
    plane: &'a Plane,
    gradients: &'a mut Gradients,
}

impl pulp::NullaryFnOnce for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let width = self.plane.width;
        for y in 1..self.plane.height.saturating_sub(1) {
            let (above, row, below) =
                (self.plane.row(y - 1), self.plane.row(y), self.plane.row(y + 1));
            let inner = y * width + 1..(y + 1) * width - 1;
            let lengths = self.gradients.lengths[inner.clone()].iter_mut();
            let out = lengths.zip(&mut self.gradients.directions[inner]);
            let sides = row[..width - 2].iter().zip(&row[2..]);
            let ends = above[1..].iter().zip(&below[1..]);
            for (((length, angle), (left, right)), (up, down)) in out.zip(sides).zip(ends) {
                let (dx, dy) = (right - left, down - up);
                (*length, *angle) = ((dx * dx + dy * dy).sqrt(), direction(dy, dx));
            }
        }
    }
}

/// atan2 in 0 to 2π within 1e-4: M. Abramowitz and I. A. Stegun, *Handbook of mathematical
/// functions*, 4.4.49, without branches.
#[inline(always)]
fn direction(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = (ax.min(ay), ax.max(ay).max(1e-20));
    let a = low / high;
    let s = a * a;
    let polynomial = ((0.079_331 * s - 0.288_679) * s + 0.995_354) * a;
    let angle = if ay > ax { TAU / 4.0 - polynomial } else { polynomial };
    let angle = if x < 0.0 { TAU / 2.0 - angle } else { angle };
    if y < 0.0 { TAU - angle } else { angle }
}

/// The dominant directions around `extremum`, strongest first, in radians.
pub(super) fn orientations(gradients: &Gradients, extremum: &Extremum) -> Vec<f64> {
    let sigma = WINDOW_SIGMA * extremum.sigma();
    let radius = (3.0 * sigma).round();
    let range = |center: f64, limit: usize| {
        let from = (center - radius).max(1.0) as usize;
        from..((center + radius) as usize + 1).min(limit.saturating_sub(1)).max(from)
    };
    let mut histogram = [0.0_f32; BINS];
    let factor = (-0.5 / (sigma * sigma)) as f32;
    let columns = range(extremum.x, gradients.width);
    for y in range(extremum.y, gradients.height) {
        let dy = y as f32 - extremum.y as f32;
        let start = y * gradients.width;
        let row = start + columns.start..start + columns.end;
        let row = gradients.lengths[row.clone()].iter().zip(&gradients.directions[row]);
        for (k, (length, angle)) in row.enumerate() {
            let dx = (columns.start + k) as f32 - extremum.x as f32;
            let bin = (angle * (BINS as f32 / TAU) + 0.5) as usize % BINS;
            histogram[bin] += length * ((dx * dx + dy * dy) * factor).exp();
        }
    }
    for _ in 0..2 {
        let last = histogram;
        for (k, value) in histogram.iter_mut().enumerate() {
            *value =
                0.25 * last[(k + BINS - 1) % BINS] + 0.5 * last[k] + 0.25 * last[(k + 1) % BINS];
        }
    }
    let highest = histogram.iter().copied().fold(0.0, f32::max);
    let mut peaks: Vec<(f32, f64)> = (0..BINS)
        .filter_map(|k| {
            let (left, at, right) =
                (histogram[(k + BINS - 1) % BINS], histogram[k], histogram[(k + 1) % BINS]);
            let is_peak = at > left && at >= right && at >= LEAST_PEAK * highest && highest > 0.0;
            let offset = f64::from(0.5 * (left - right) / (left - 2.0 * at + right));
            is_peak.then(|| (at, (k as f64 + offset) * std::f64::consts::TAU / BINS as f64))
        })
        .collect();
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.into_iter().take(MAX_DIRECTIONS).map(|(_, angle)| angle).collect()
}
