//! What the surroundings of a keypoint show, as 128 whole numbers (Lowe 2004, section 6).

use std::f32::consts::TAU;

use crate::features::extrema::Extremum;
use crate::features::orientation::Gradients;

/// Numbers of a descriptor: 4 × 4 places, 8 directions each.
pub const LENGTH: usize = PLACES * PLACES * DIRECTIONS;

const PLACES: usize = 4;
const DIRECTIONS: usize = 8;

/// The side of one of the 4 × 4 places, in keypoint scales.
const PLACE_SCALES: f32 = 3.0;

/// No number is greater than this part of the whole: bright reflections count for no more.
const CLIP: f32 = 0.2;

/// A descriptor of unit length has this length in whole numbers: the largest number that occurs
/// then fits a byte.
pub const UNIT: f32 = 512.0;

/// The distribution of gradients around a keypoint, as the square roots of RootSIFT in units of
/// 1 / [`UNIT`]: Euclidean distances of these are Hellinger distances of the histograms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Descriptor(pub [u8; LENGTH]);

/// Places with one more on each side, which takes what falls outside.
const PADDED: usize = PLACES + 2;

type Histogram = [[[f32; DIRECTIONS]; PADDED]; PADDED];

/// The descriptor of `extremum` seen along `angle`.
pub(super) fn describe(gradients: &Gradients, extremum: &Extremum, angle: f64) -> Descriptor {
    let padded =
        pulp::Arch::new().dispatch(Accumulate { gradients, extremum, angle: angle as f32 });
    let mut histogram = [0.0_f32; LENGTH];
    for (place, into) in histogram.chunks_exact_mut(DIRECTIONS).enumerate() {
        into.copy_from_slice(&padded[1 + place / PLACES][1 + place % PLACES]);
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
        // Places are numbered by their middles, from the padding on.
        let (half, first) = (PLACES as f32 * 0.5, PLACES as f32 * 0.5 + 0.5);
        let columns = range(center_x, gradients.width);
        let mut histogram = [[[0.0; DIRECTIONS]; PADDED]; PADDED];
        for y in range(center_y, gradients.height) {
            let dy = y as f32 - center_y;
            let start = y * gradients.width;
            let row = &gradients.values[start..start + gradients.width];
            for x in columns.clone() {
                let dx = x as f32 - center_x;
                let (u, v) = (cos * dx + sin * dy, cos * dy - sin * dx);
                let (column, row_place) = (u + first, v + first);
                let inside = column > 0.0
                    && row_place > 0.0
                    && column < (PADDED - 1) as f32
                    && row_place < (PADDED - 1) as f32;
                if !inside {
                    continue;
                }
                let [length, direction] = row[x];
                let weight = length * falloff((u * u + v * v) / (half * half));
                let relative = direction - angle;
                let relative = if relative < 0.0 { relative + TAU } else { relative };
                let relative = relative * (DIRECTIONS as f32 / TAU);
                spread(&mut histogram, [row_place, column, relative], weight);
            }
        }
        histogram
    }
}

/// exp(−t / 2), the Gaussian as wide as half the window, as (1 − t / 16)⁸: within 0.04 where the
/// window ends and without a call.
#[inline(always)]
fn falloff(t: f32) -> f32 {
    let quarter = 1.0 - t * 0.0625;
    let squared = quarter * quarter;
    (squared * squared) * (squared * squared)
}

/// Adds `weight` to the two nearest rows, columns and directions, by how near they are; rows and
/// columns from 0 to below [`PADDED`] − 1, directions from 0.
#[inline(always)]
fn spread(into: &mut Histogram, [row, column, direction]: [f32; 3], weight: f32) {
    let (first_row, first_column) = (row as usize, column as usize);
    let (r, c) = (row - first_row as f32, column - first_column as f32);
    let whole = direction as usize;
    let d = direction - whole as f32;
    let (here, next) = (whole % DIRECTIONS, (whole + 1) % DIRECTIONS);
    for (row, part) in [(first_row, weight * (1.0 - r)), (first_row + 1, weight * r)] {
        for (column, part) in [(first_column, part * (1.0 - c)), (first_column + 1, part * c)] {
            let place = &mut into[row.min(PADDED - 1)][column.min(PADDED - 1)];
            place[here] += part * (1.0 - d);
            place[next] += part * d;
        }
    }
}
