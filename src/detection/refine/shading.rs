//! Light that varies over one corner's window: a highlight, or the edge of a shadow.
//!
//! A highlight adds light to black and white alike, and its slope is taken for an offset of the
//! edges: as functions of the distances to the two edges, an offset of one edge is even in its own
//! distance and odd in the other's, and so is a slope. The board's polynomial over all corners
//! cannot follow it. Where a corner fits worse than the others, a polynomial of third order over
//! its own window is fitted to the model's residuals and subtracted; the model is fitted again, and
//! so on, while the tolerance to outliers narrows. A last step solves for both together and gives
//! the corner's covariance: the model's alone would take the light as known.

use nalgebra::{SMatrix, SVector};

use crate::detection::refine::corner_model::{OFFSETS, UNKNOWNS};
use crate::detection::refine::normal_equations::{ModelColumns, RESIDUAL};
use crate::detection::refine::samples::Samples;

/// Terms: x, y, x², xy, y², x³, x²y, xy², y³, and x and y times the pattern.
const TERMS: usize = 11;
/// The terms that light adds to black and white alike.
const LIGHT_TERMS: usize = 9;
/// Columns of the derivatives by the mean of black and white and by half their difference.
const BY_LEVEL: usize = 4;
const BY_AMPLITUDE: usize = 5;
/// Weak prior on the terms, as a fraction of the samples' weight: it keeps undetermined terms at 0.
const PRIOR_WEIGHT_PART: f64 = 1e-6;

/// Subtracts from `samples` the light in the residuals of their last fit, whose linearization is in
/// `columns`. `reach`: half the window's extent, in samples.
pub(super) fn take_off_shading(samples: &mut Samples, columns: &ModelColumns, reach: f64) {
    let trust = columns.values(BY_LEVEL);
    let (pattern, residuals) = (columns.values(BY_AMPLITUDE), columns.values(RESIDUAL));
    // Each column is multiplied by the root of the sample's weight, which is the derivative by the
    // level.
    let at = |slot: usize| {
        let weight = trust.get(slot).copied().unwrap_or(0.0);
        let over = if weight > 0.0 { 1.0 / weight } else { 0.0 };
        let of = |column: &[f32]| f64::from(column.get(slot).copied().unwrap_or(0.0) * over);
        (f64::from(weight * weight), of(pattern), of(residuals))
    };
    let mut sums = LightSums::default();
    pulp::Arch::new().dispatch(LightSummation { samples, columns, reach, sums: &mut sums });
    let LightSums { products, total } = sums;
    let mut normal = SMatrix::<f64, TERMS, TERMS>::from_fn(|row, col| products[row][col]);
    let right = SVector::<f64, TERMS>::from_fn(|row, _| products[row][TERMS]);
    for term in 0..TERMS {
        normal[(term, term)] += PRIOR_WEIGHT_PART * total;
    }
    let Some(factors) = normal.cholesky() else { return };
    let shading = factors.solve(&right);
    let mut slot = 0;
    samples.change(|x, y, value| {
        let (_, pattern, _) = at(slot);
        slot += 1;
        let terms = basis(f64::from(x) / reach, f64::from(y) / reach, pattern);
        value - shading.dot(&SVector::from(terms)) as f32
    });
}

/// Prior standard deviation of each term, in amplitudes: over a window, a highlight varies by about
/// the difference of black and white. Where a small window does not determine the light, this keeps
/// it from absorbing the edge (swept: from 0.3 to no bound the rms of hard images of two salts is
/// within 11 % of that at 1).
const LIGHT_STD: f64 = 1.0;

/// Unknowns of the light and of the corner together.
const JOINT: usize = TERMS + UNKNOWNS;

/// One step of corner and light together.
pub(super) struct JointStep {
    /// The step in the corner's unknowns.
    pub step: [f64; UNKNOWNS],
    /// Covariance of the two edges' offsets per unit of noise: xx, xy, yy.
    pub offset_covariance: [f64; 3],
}

/// The step in corner and light that minimizes the residuals of the linearization in `columns`.
/// `amplitude`: half the difference of white and black, in gray levels.
///
/// Alternating fits converge slowly, and their covariance takes the light as known. `None` where
/// the samples do not determine both.
pub(super) fn joint_step(
    samples: &mut Samples,
    columns: &ModelColumns,
    reach: f64,
    amplitude: f64,
) -> Option<JointStep> {
    let mut sums = JointSums::default();
    pulp::Arch::new().dispatch(JointSummation { samples, columns, reach, sums: &mut sums });
    let mut normal = SMatrix::<f64, JOINT, JOINT>::from_fn(|row, col| sums.products[row][col]);
    let right = SVector::<f64, JOINT>::from(sums.right);
    for k in 0..JOINT {
        normal[(k, k)] *= 1.0 + PRIOR_WEIGHT_PART;
    }
    // The terms of the pattern are relative to its amplitude already.
    for k in 0..TERMS {
        let unit = if k < LIGHT_TERMS { amplitude } else { 1.0 };
        normal[(k, k)] += (LIGHT_STD * unit).powi(-2);
    }
    let factors = normal.cholesky()?;
    let solution = factors.solve(&right);
    let step = std::array::from_fn(|k| solution[TERMS + k]);
    let (a, b) = (TERMS + OFFSETS, TERMS + OFFSETS + 1);
    // The columns of the inverse for the two offsets.
    let mut covariance = SMatrix::<f64, JOINT, 2>::zeros();
    (covariance[(a, 0)], covariance[(b, 1)]) = (1.0, 1.0);
    factors.solve_mut(&mut covariance);
    let offset_covariance = [covariance[(a, 0)], covariance[(b, 0)], covariance[(b, 1)]];
    Some(JointStep { step, offset_covariance })
}

#[inline(always)]
fn basis(x: f64, y: f64, pattern: f64) -> [f64; TERMS] {
    let (x2, y2) = (x * x, y * y);
    [x, y, x2, x * y, y2, x2 * x, x2 * y, x * y2, y2 * y, pattern * x, pattern * y]
}

/// Sums over a window's samples, of which the lower half is read.
#[derive(Default)]
struct LightSums {
    /// Products of each pair of terms, and of each term with the residual.
    products: [[f64; TERMS + 1]; TERMS],
    /// The samples' weight.
    total: f64,
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct LightSummation<'a> {
    samples: &'a Samples,
    columns: &'a ModelColumns,
    reach: f64,
    sums: &'a mut LightSums,
}

impl pulp::NullaryFnOnce for LightSummation<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { samples, columns, reach, sums } = self;
        let [xs, ys] = samples.places();
        let trust = columns.values(BY_LEVEL).iter();
        let left = columns.values(BY_AMPLITUDE).iter().zip(columns.values(RESIDUAL));
        for (((x, y), weight), (pattern, residual)) in xs.iter().zip(ys).zip(trust).zip(left) {
            let over = if *weight > 0.0 { 1.0 / weight } else { 0.0 };
            let (pattern, residual) = (f64::from(pattern * over), f64::from(residual * over));
            let weight = f64::from(weight * weight);
            let light = basis(f64::from(*x) / reach, f64::from(*y) / reach, pattern);
            let mut terms = [residual; TERMS + 1];
            terms[..TERMS].copy_from_slice(&light);
            sums.total += weight;
            for (products, term) in sums.products.iter_mut().zip(light) {
                let weighted = weight * term;
                for (product, other) in products.iter_mut().zip(terms) {
                    *product += weighted * other;
                }
            }
        }
    }
}

/// The same of light and corner together.
struct JointSums {
    products: [[f64; JOINT]; JOINT],
    right: [f64; JOINT],
}

impl Default for JointSums {
    fn default() -> Self {
        Self { products: [[0.0; JOINT]; JOINT], right: [0.0; JOINT] }
    }
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct JointSummation<'a> {
    samples: &'a Samples,
    columns: &'a ModelColumns,
    reach: f64,
    sums: &'a mut JointSums,
}

impl pulp::NullaryFnOnce for JointSummation<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { samples, columns, reach, sums } = self;
        let [xs, ys] = samples.places();
        for (slot, (x, y)) in xs.iter().zip(ys).enumerate() {
            let mut row = [0.0; JOINT];
            for k in 0..UNKNOWNS {
                row[TERMS + k] = f64::from(columns.values(k)[slot]);
            }
            let (weight, pattern) = (row[TERMS + BY_LEVEL], row[TERMS + BY_AMPLITUDE]);
            let pattern = if weight > 0.0 { pattern / weight } else { 0.0 };
            let light = basis(f64::from(*x) / reach, f64::from(*y) / reach, pattern);
            for k in 0..TERMS {
                row[k] = weight * light[k];
            }
            let residual = f64::from(columns.values(RESIDUAL)[slot]);
            for k in 0..JOINT {
                sums.right[k] += row[k] * residual;
                for other in 0..JOINT {
                    sums.products[k][other] += row[k] * row[other];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::detection::refine::corner_model::CornerModel;
    use crate::detection::refine::fit::{CornerFit, FitOptions, fit};
    use crate::detection::refine::normal_equations::{CornerEquations, Linearized, Noise};
    use crate::detection::refine::window::Window;
    use crate::imaging::gray::GrayImage;

    const REACH: f64 = 14.0;
    const NOISE: Noise = Noise { black: 1.0, white: 1.0, tolerance: 1e6 };
    const AMPLITUDE: f64 = 60.0;
    const MODEL: CornerModel = CornerModel {
        center: [0.3, -0.2],
        along: [[0.980_067, 0.198_669], [-0.099_833, 0.995_004]],
        sharpness: [0.9, 0.8],
        curvature: [0.0; 2],
        level: 120.0,
        amplitude: AMPLITUDE,
        gamma_term: 5.0,
        gradient: [0.0; 2],
    };

    /// Samples of `MODEL` under light of its own, a polynomial of up to 6 gray levels a term, with
    /// noise of one gray level.
    fn seen(seed: u64) -> Samples {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let axes = [[REACH, 0.0], [0.0, REACH]];
        let window = Window {
            origin: [20.0, 20.0],
            axes,
            extent: [1.0; 2],
            strip_px: f64::INFINITY,
            bin: 1,
        };
        let mut samples = Samples::default();
        samples.gather(GrayImage::filled(41, 41, 0).view(), &window);
        let (mut columns, mut equations) = (ModelColumns::default(), CornerEquations::default());
        let linearized = Linearized { samples: &samples, noise: &NOISE, with_flat: false };
        linearized.at(&MODEL, &mut columns, &mut equations);
        let light =
            SVector::<f64, TERMS>::from_fn(
                |k, _| if k < LIGHT_TERMS { 6.0 * normal() } else { 0.0 },
            );
        let mut modeled = columns.values(RESIDUAL).iter();
        samples.change(|x, y, value| {
            let lit =
                light.dot(&SVector::from(basis(f64::from(x) / REACH, f64::from(y) / REACH, 0.0)));
            let modeled = value - modeled.next().copied().unwrap_or(0.0);
            modeled + (lit + normal()) as f32
        });
        samples
    }

    /// The last fit after four rounds, and the covariance of its offsets.
    fn fitted(samples: &mut Samples) -> (CornerFit, [f64; 3]) {
        let options = FitOptions { iterations: [2, 8], enough: 1e-3, alike: 0.0, with_flat: false };
        let (mut columns, mut model) = (ModelColumns::default(), MODEL);
        for _ in 0..4 {
            model = fit(samples, model, &NOISE, &options, &mut columns).unwrap().model;
            take_off_shading(samples, &columns, REACH);
        }
        let mut last = fit(samples, model, &NOISE, &options, &mut columns).unwrap();
        let mut equations = CornerEquations::default();
        let linearized = Linearized { samples, noise: &NOISE, with_flat: false };
        linearized.at(&last.model, &mut columns, &mut equations);
        let joint = joint_step(samples, &columns, REACH, AMPLITUDE).unwrap();
        last.model = last.model.moved_by(&joint.step);
        (last, joint.offset_covariance)
    }

    #[test]
    fn offsets_scatter_as_predicted_when_the_light_is_unknown_too() {
        const SEEDS: u64 = 200;
        let (mut squares, mut squares_of_known, mut mean) = (0.0, 0.0, [0.0; 2]);
        for seed in 0..SEEDS {
            let (fit, [xx, _, yy]) = fitted(&mut seen(seed));
            let off = [0, 1].map(|k| fit.model.center[k] - MODEL.center[k]);
            let offsets = MODEL.normals().map(|[x, y]| x * off[0] + y * off[1]);
            squares += offsets[0].powi(2) / xx + offsets[1].powi(2) / yy;
            let [xx, _, yy] = fit.covariance;
            squares_of_known += off[0].powi(2) / xx + off[1].powi(2) / yy;
            (0..2).for_each(|k| mean[k] += off[k] / SEEDS as f64);
        }
        let [z, z_of_known] =
            [squares, squares_of_known].map(|sum| (sum / (2 * SEEDS) as f64).sqrt());
        assert!((0.9..1.1).contains(&z), "{z}");
        assert!(z_of_known > 1.3, "{z_of_known}");
        assert!(mean.iter().all(|off| off.abs() < 0.003), "{mean:?}");
    }
}
