//! The descriptor of a keypoint's surroundings: 128 whole numbers (Lowe 2004, section 6).

use std::f32::consts::TAU;

use crate::features::extrema::Extremum;
use crate::features::orientation::Gradients;

/// Length of a descriptor: 4 × 4 spatial bins (places), 8 directions each.
pub const LENGTH: usize = PLACES * PLACES * DIRECTIONS;

const PLACES: usize = 4;
const DIRECTIONS: usize = 8;

/// The side of one of the 4 × 4 spatial bins, in keypoint scales.
const PLACE_SCALES: f32 = 3.0;

/// Values are clipped at this part of the descriptor's length, which limits the effect of bright
/// reflections.
const CLIP: f32 = 0.2;

/// The length of a descriptor in whole numbers: with it, the largest value that occurs fits a byte.
pub const UNIT: f32 = 512.0;

/// The histogram of gradients around a keypoint, as the square roots of RootSIFT in units of 1 /
/// [`UNIT`]: Euclidean distances of these are Hellinger distances of the histograms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Descriptor(pub [u8; LENGTH]);

/// The spatial bins with one more on each side, which receives what falls outside.
const PADDED: usize = PLACES + 2;

/// By spatial bin, row by row.
type Histogram = [[f32; DIRECTIONS]; PADDED * PADDED];

/// The descriptor of `extremum` relative to the direction `angle`.
pub(super) fn describe(gradients: &Gradients, extremum: &Extremum, angle: f64) -> Descriptor {
    let padded =
        pulp::Arch::new().dispatch(Accumulate { gradients, extremum, angle: angle as f32 });
    let mut histogram = [0.0_f32; LENGTH];
    for (place, into) in histogram.chunks_exact_mut(DIRECTIONS).enumerate() {
        into.copy_from_slice(&padded[(1 + place / PLACES) * PADDED + 1 + place % PLACES]);
    }
    let norm = |values: &[f32]| values.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
    let length = norm(&histogram);
    histogram.iter_mut().for_each(|v| *v = (*v / length).min(CLIP));
    let sum = histogram.iter().sum::<f32>().max(1e-12);
    Descriptor(histogram.map(|v| (UNIT * (v / sum).sqrt()).round().min(255.0) as u8))
}

struct Accumulate<'a> {
    gradients: &'a Gradients,
    extremum: &'a Extremum,
    angle: f32,
}

/// Number of pixels of a row that are processed together.
const LANES: usize = Gradients::PADDING;

impl pulp::NullaryFnOnce for Accumulate<'_> {
    type Output = Histogram;

    #[inline(always)]
    fn call(self) -> Histogram {
        let Self { gradients, extremum, angle } = self;
        let place = PLACE_SCALES * extremum.sigma() as f32;
        let radius = place * std::f32::consts::SQRT_2 * (PLACES as f32 + 1.0) * 0.5;
        let (cos, sin) = (angle.cos() / place, angle.sin() / place);
        let (center_x, center_y) = (extremum.x as f32, extremum.y as f32);
        let range = |center: f32, limit: usize| {
            let from = (center - radius).ceil().max(1.0) as usize;
            from..((center + radius).max(0.0) as usize + 1).min(limit.saturating_sub(1))
        };
        let columns = range(center_x, gradients.width);
        let mut histogram = [[0.0; DIRECTIONS]; PADDED * PADDED];
        for y in range(center_y, gradients.height) {
            let dy = y as f32 - center_y;
            let (left, right) = span(cos, sin, dy);
            let from = columns.start.max((center_x + left).max(0.0) as usize);
            let end = columns.end.min((center_x + right).max(0.0) as usize + 2);
            for start in (from..end).step_by(LANES) {
                let at = y * gradients.width + start;
                let Some(lengths) = gradients.lengths[at..].first_chunk() else { continue };
                let Some(directions) = gradients.directions[at..].first_chunk() else { continue };
                let shares = Shares::of(lengths, directions, angle, |k| {
                    let dx = (start as i32 + k as i32) as f32 - center_x;
                    [cos * dx + sin * dy, cos * dy - sin * dx]
                });
                for k in 0..LANES.min(end - start) {
                    shares.add(k, &mut histogram);
                }
            }
        }
        histogram
    }
}

/// The range of a row that the spatial bins cover, in pixels from the keypoint, `dy` below it;
/// `cos` and `sin` in bins per pixel.
#[inline(always)]
fn span(cos: f32, sin: f32, dy: f32) -> (f32, f32) {
    // Slightly larger, because of rounding.
    let half = (PLACES as f32 + 1.0) * 0.5 + 1e-4;
    let within = |slope: f32, offset: f32| {
        let (a, b) = ((-half - offset) / slope, (half - offset) / slope);
        (a.min(b), a.max(b))
    };
    let (u, v) = (within(cos, sin * dy), within(-sin, cos * dy));
    (u.0.max(v.0), u.1.min(v.1))
}

/// The spatial bins to which pixels of a part of a row contribute, with weights.
struct Shares {
    /// 1 inside the spatial bins, 0 outside.
    inside: [u32; LANES],
    /// The nearest spatial bin above and to the left.
    place: [u32; LANES],
    /// The nearest direction bin below.
    direction: [u32; LANES],
    /// The fraction of the distance to the next direction bin.
    beyond: [f32; LANES],
    /// The contributions to the nearest two by two spatial bins, row by row.
    parts: [[f32; LANES]; 4],
}

impl Shares {
    /// Of gradients with these lengths and directions; `at` gives the position of each, in spatial
    /// bins from the keypoint.
    #[inline(always)]
    fn of(
        lengths: &[f32; LANES],
        directions: &[f32; LANES],
        angle: f32,
        at: impl Fn(usize) -> [f32; 2],
    ) -> Self {
        let (inside, place, direction) = ([0; LANES], [0; LANES], [0; LANES]);
        let (beyond, parts) = ([0.0; LANES], [[0.0; LANES]; 4]);
        let mut shares = Self { inside, place, direction, beyond, parts };
        // Spatial bins are numbered by their centers, starting at the padding.
        let (half, first) = (PLACES as f32 * 0.5, PLACES as f32 * 0.5 + 0.5);
        let end = (PADDED - 1) as f32;
        for k in 0..LANES {
            let [u, v] = at(k);
            let (column, row) = (u + first, v + first);
            let inside = (column > 0.0) & (row > 0.0) & (column < end) & (row < end);
            shares.inside[k] = u32::from(inside);
            let weight = lengths[k] * falloff((u * u + v * v) / (half * half));
            let relative = directions[k] - angle;
            let relative = if relative < 0.0 { relative + TAU } else { relative };
            let relative = relative * (DIRECTIONS as f32 / TAU);
            let (whole_row, whole_column) = (floor(row), floor(column));
            let direction = floor(relative);
            shares.place[k] = whole(whole_row * PADDED as f32 + whole_column);
            shares.direction[k] = whole(direction);
            shares.beyond[k] = relative - direction;
            let (r, c) = (row - whole_row, column - whole_column);
            let (near, far) = (weight * (1.0 - r), weight * r);
            shares.parts[0][k] = near * (1.0 - c);
            shares.parts[1][k] = near * c;
            shares.parts[2][k] = far * (1.0 - c);
            shares.parts[3][k] = far * c;
        }
        shares
    }

    /// Adds the contributions of pixel `k`.
    #[inline(always)]
    fn add(&self, k: usize, histogram: &mut Histogram) {
        if self.inside[k] == 0 {
            return;
        }
        let (here, d) = (self.direction[k] as usize, self.beyond[k]);
        let (here, next) = (&ONLY[here % DIRECTIONS], &ONLY[(here + 1) % DIRECTIONS]);
        let mut directions = [0.0; DIRECTIONS];
        for n in 0..DIRECTIONS {
            directions[n] = here[n] * (1.0 - d) + next[n] * d;
        }
        let first = (self.place[k] as usize).min(PADDED * (PADDED - 1) - 2);
        for (place, parts) in [0, 1, PADDED, PADDED + 1].into_iter().zip(&self.parts) {
            let place = &mut histogram[first + place];
            for n in 0..DIRECTIONS {
                place[n] += parts[k] * directions[n];
            }
        }
    }
}

/// 1 in a single direction.
const ONLY: [[f32; DIRECTIONS]; DIRECTIONS] = {
    let mut only = [[0.0; DIRECTIONS]; DIRECTIONS];
    let mut k = 0;
    while k < DIRECTIONS {
        only[k][k] = 1.0;
        k += 1;
    }
    only
};

/// Adding this to a number between 0 and 2²² rounds it to a whole number.
const ROUNDING: f32 = 8_388_608.0;

/// The largest whole number not above `x`, between 0 and 2²², without a function call.
#[inline(always)]
fn floor(x: f32) -> f32 {
    let rounded = (x + ROUNDING) - ROUNDING;
    if rounded > x { rounded - 1.0 } else { rounded }
}

/// A whole number between 0 and 255 as an integer, without a function call.
#[inline(always)]
fn whole(x: f32) -> u32 {
    (x + ROUNDING).to_bits() & 0xff
}

/// exp(−t / 2), a Gaussian with a standard deviation of half the window, approximated by (1 − t /
/// 16)⁸: within 0.04 at the window's end, and without a function call.
#[inline(always)]
fn falloff(t: f32) -> f32 {
    let quarter = 1.0 - t * 0.0625;
    let squared = quarter * quarter;
    (squared * squared) * (squared * squared)
}
