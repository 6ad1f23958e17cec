//! A corner under light of its own: a highlight, or the edge of a shadow.
//!
//! Such light is smooth, but gray values are a power of it and saturate at white. So the pattern t
//! is fitted in light: m(x, y) + c(x, y)·t, with a mean m of third order and a contrast c of first
//! order over the window. Residuals are in gray levels, which are γ-th roots of light. Where the
//! image is at white, a model that is brighter has no residual (a censored observation: Tobin
//! 1958).

use nalgebra::{SMatrix, SVector};

use crate::detection::refine::corner_model::{CornerModel, OFFSETS};
use crate::detection::refine::fit::{CornerFit, position_covariance};
use crate::detection::refine::normal_equations::{
    CornerEquations, Linearized, ModelColumns, Noise, RESIDUAL, Residuals,
};
use crate::detection::refine::power::power;
use crate::detection::refine::samples::Samples;

/// Terms of the mean: 1, x, y, x², xy, y², x³, x²y, xy², y³; of the contrast: 1, x, y.
const MEAN_TERMS: usize = 10;
const CONTRAST_TERMS: usize = 3;
const TERMS: usize = MEAN_TERMS + CONTRAST_TERMS;
/// The directions and sharpness of the two edges, which come first; their offsets come last.
const SHAPES: usize = 4;
const UNKNOWNS: usize = SHAPES + TERMS + 2;
/// The derivatives of a sample by all unknowns, then its residual, padded to whole vectors.
const ROOM: usize = (UNKNOWNS + 1).next_multiple_of(LANES);
const LANES: usize = 4;
/// Samples whose products are summed at once: their rows stay in the processor's nearest cache.
/// Chosen, not swept.
const BATCH: usize = 64;
/// White, in gray levels, and the level from which on a sample counts as saturated.
const WHITE: f64 = 255.0;
const AT_WHITE: f32 = 254.5;
/// The least light of a model, that of a gray level of 2: below, the slope of a root has no bound.
const DARKEST: f64 = 2.0;
/// Prior standard deviation of each term but the constant ones, in amplitudes, as in
/// [`super::shading`].
const LIGHT_STD: f64 = 1.0;
/// The least contrast that this is relative to, in light with white as 1: that of the first four
/// gray levels, since the core of a highlight may have none.
const LEAST_CONTRAST: f64 = 1e-4;
/// The least number of samples below white to determine all unknowns and the residuals' scale.
const FEWEST_SAMPLES: f64 = 3.0 * UNKNOWNS as f64;
/// Linearizations at each tolerance (with one, errors under highlights were larger by half), and
/// the most at the last one (chosen, not swept).
const ROUNDS: usize = 2;
const LAST_ROUNDS: usize = 6;

/// What to fit.
#[derive(Clone, Copy)]
pub(super) struct LocalLightFit<'a> {
    pub samples: &'a Samples,
    pub noise: &'a Noise,
    /// Added to the tolerance, fit by fit, in amplitudes.
    pub tolerances: &'a [f64],
    /// Half the window's extent, in samples.
    pub reach: f64,
    /// Gray values to this power are proportional to light.
    pub power: f64,
    /// The iteration ends with a step below this, in standard deviations of the blur.
    pub enough: f64,
}

/// A corner and its light.
#[derive(Clone, Copy)]
struct LitCorner {
    corner: CornerModel,
    light: [f64; TERMS],
}

impl LocalLightFit<'_> {
    /// Fits corner and light from `start`; `None` where the samples do not determine them.
    pub fn fit(&self, start: CornerModel, columns: &mut ModelColumns) -> Option<CornerFit> {
        let amplitude = start.amplitude.abs();
        let mut lit = self.from(&start);
        for tolerance in self.tolerances {
            let tolerance = self.noise.tolerance + tolerance * amplitude;
            for _ in 0..ROUNDS {
                let sums = self.linearize(&lit, tolerance, columns);
                lit = lit.moved_by(&sums.solve(&lit)?.0);
            }
        }
        for round in 1..=LAST_ROUNDS {
            let sums = self.linearize(&lit, self.noise.tolerance, columns);
            let (step, offset_covariance) = sums.solve(&lit)?;
            let moved = lit.moved_by(&step);
            let last_step = f64::hypot(
                moved.corner.center[0] - lit.corner.center[0],
                moved.corner.center[1] - lit.corner.center[1],
            );
            lit = moved;
            let sharpness = lit.corner.sharpness[0].max(lit.corner.sharpness[1]);
            if last_step * sharpness < self.enough || round == LAST_ROUNDS {
                return (sums.below_white > FEWEST_SAMPLES)
                    .then(|| self.answer(&start, &lit, &sums, last_step, offset_covariance));
            }
        }
        None
    }

    /// `model` in light that is constant over the window.
    fn from(&self, model: &CornerModel) -> LitCorner {
        let half = model.amplitude.abs();
        let light = |gray: f64| (gray.clamp(DARKEST, WHITE) / WHITE).powf(self.power);
        let (black, white) = (light(model.level - half), light(model.level + half));
        let mut lit = LitCorner { corner: pattern(model), light: [0.0; TERMS] };
        lit.light[0] = (white + black) / 2.0;
        lit.light[MEAN_TERMS] = model.amplitude.signum() * (white - black) / 2.0;
        lit
    }

    /// The normal equations at `lit`, with this tolerance to outliers in gray levels.
    fn linearize(&self, lit: &LitCorner, tolerance: f64, columns: &mut ModelColumns) -> Sums {
        // Linearizes the pattern itself: without noise and outliers every weight is 1.
        let plain = Noise { black: 1.0, white: 1.0, tolerance: 1e6 };
        let linearized = Linearized { samples: self.samples, noise: &plain, with_flat: false };
        linearized.at(&lit.corner, columns, &mut CornerEquations::default());
        let mut sums = Sums::default();
        pulp::Arch::new().dispatch(LitSummation {
            what: self,
            lit,
            tolerance2: tolerance * tolerance,
            columns,
            sums: &mut sums,
        });
        sums
    }

    fn answer(
        &self,
        start: &CornerModel,
        lit: &LitCorner,
        sums: &Sums,
        last_step: f64,
        offset_covariance: [f64; 3],
    ) -> CornerFit {
        let residuals =
            Residuals { squares: sums.squares, effective: sums.effective, ..Residuals::default() };
        let mean_square = sums.squares / (sums.below_white - UNKNOWNS as f64).max(1.0)
            * (1.0 + 4.0 * self.noise.variance() / self.noise.tolerance.powi(2));
        CornerFit {
            model: CornerModel {
                level: start.level,
                amplitude: start.amplitude,
                gamma_term: start.gamma_term,
                gradient: start.gradient,
                ..lit.corner
            },
            residuals,
            mean_square,
            residual_rms: (mean_square * self.noise.variance()).sqrt(),
            covariance: position_covariance(offset_covariance, &lit.corner),
            last_step,
        }
    }
}

/// The pattern of `model`, −1 … 1.
fn pattern(model: &CornerModel) -> CornerModel {
    CornerModel { level: 0.0, amplitude: 1.0, gamma_term: 0.0, gradient: [0.0; 2], ..*model }
}

impl LitCorner {
    /// Half the difference of white and black at the corner.
    fn contrast(&self) -> f64 {
        self.light[MEAN_TERMS].abs()
    }

    fn moved_by(&self, step: &SVector<f64, UNKNOWNS>) -> Self {
        let mut moved = *self;
        for (term, by) in moved.light.iter_mut().zip(step.iter().skip(SHAPES)) {
            *term += by;
        }
        let mut of_corner = [0.0; OFFSETS + 2];
        for k in 0..SHAPES {
            of_corner[k] = step[k];
        }
        for k in 0..2 {
            of_corner[OFFSETS + k] = step[SHAPES + TERMS + k];
        }
        moved.corner = pattern(&self.corner.moved_by(&of_corner));
        moved
    }
}

/// Sums over a window's samples.
struct Sums {
    /// Products of each column with those from its own whole vector on.
    products: [[f64; ROOM]; ROOM],
    /// Sum of the squares of the residuals below white, in units of the noise, and the effective
    /// number of samples.
    squares: f64,
    effective: f64,
    /// The effective number of samples below white.
    below_white: f64,
}

impl Default for Sums {
    fn default() -> Self {
        Self { products: [[0.0; ROOM]; ROOM], squares: 0.0, effective: 0.0, below_white: 0.0 }
    }
}

impl Sums {
    /// The step, and the covariance of the two offsets per unit of noise: xx, xy, yy.
    fn solve(&self, lit: &LitCorner) -> Option<(SVector<f64, UNKNOWNS>, [f64; 3])> {
        let product = |row: usize, col: usize| self.products[row.min(col)][row.max(col)];
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(product);
        let mut right = SVector::<f64, UNKNOWNS>::from_fn(|row, _| product(row, UNKNOWNS));
        let prior = (LIGHT_STD * lit.contrast().max(LEAST_CONTRAST)).powi(-2);
        for (k, term) in lit.light.iter().enumerate() {
            if k != 0 && k != MEAN_TERMS {
                normal[(SHAPES + k, SHAPES + k)] += prior;
                right[SHAPES + k] -= prior * term;
            }
        }
        for k in 0..UNKNOWNS {
            normal[(k, k)] *= 1.0 + 1e-6;
        }
        let factors = normal.cholesky()?;
        let step = factors.solve(&right);
        let (a, b) = (UNKNOWNS - 2, UNKNOWNS - 1);
        let mut covariance = SMatrix::<f64, UNKNOWNS, 2>::zeros();
        (covariance[(a, 0)], covariance[(b, 1)]) = (1.0, 1.0);
        factors.solve_mut(&mut covariance);
        let covariance = [covariance[(a, 0)], covariance[(b, 0)], covariance[(b, 1)]];
        Some((step, covariance))
    }
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct LitSummation<'a> {
    what: &'a LocalLightFit<'a>,
    lit: &'a LitCorner,
    tolerance2: f64,
    columns: &'a ModelColumns,
    sums: &'a mut Sums,
}

impl pulp::NullaryFnOnce for LitSummation<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { what, lit, tolerance2, columns, sums } = self;
        let noise = what.noise;
        let [xs, ys] = what.samples.places();
        let values = columns.values(RESIDUAL);
        let patterns = columns.values(SHAPES + 1);
        let by_shapes: [&[f32]; SHAPES] = std::array::from_fn(|k| columns.values(k));
        let by_offsets = [OFFSETS, OFFSETS + 1].map(|k| columns.values(k));
        let (root, sign) = (1.0 / what.power, lit.light[MEAN_TERMS].signum());
        let least = (DARKEST / WHITE).powf(what.power);
        let middle = (noise.black + noise.white) / 2.0;
        let slope = sign * (noise.white - noise.black) / 2.0;
        let (mut rows, mut filled) = ([[0.0; ROOM]; BATCH], 0);
        for (slot, (x, y)) in xs.iter().zip(ys).enumerate() {
            let t = f64::from(patterns[slot]);
            let value = f64::from(values[slot]) + t;
            let terms = terms(f64::from(*x) / what.reach, f64::from(*y) / what.reach);
            let (mean, contrast) = mean_and_contrast(&lit.light, &terms);
            let light = (mean + contrast * t).max(least);
            let gray = WHITE * power(light, root);
            let silent = value > f64::from(AT_WHITE) && gray > f64::from(AT_WHITE);
            let residual = if silent { 0.0 } else { value - gray };
            let std = middle + slope * t;
            let doubt = tolerance2 / (tolerance2 + residual * residual);
            let trust = doubt / std;
            let by_light = if silent { 0.0 } else { trust * root * gray / light };
            let by_pattern = by_light * contrast;
            let row = &mut rows[filled];
            for k in 0..SHAPES {
                row[k] = by_pattern * f64::from(by_shapes[k][slot]);
            }
            for k in 0..MEAN_TERMS {
                row[SHAPES + k] = by_light * terms[k];
            }
            for k in 0..CONTRAST_TERMS {
                row[SHAPES + MEAN_TERMS + k] = by_light * t * terms[k];
            }
            for k in 0..2 {
                row[SHAPES + TERMS + k] = by_pattern * f64::from(by_offsets[k][slot]);
            }
            let weighted = trust * residual;
            row[UNKNOWNS] = weighted;
            let inlier = doubt * doubt;
            sums.effective += inlier;
            // Saturated samples have no noise: they do not contribute to the residuals' scale.
            if value <= f64::from(AT_WHITE) {
                sums.squares += weighted * weighted;
                sums.below_white += inlier;
            }
            filled += 1;
            if filled == BATCH {
                add_products(&rows, &mut sums.products);
                filled = 0;
            }
        }
        add_products(&rows[..filled], &mut sums.products);
    }
}

/// Adds each row's products of its columns with those from their own whole vector on.
#[inline(always)]
fn add_products(rows: &[[f64; ROOM]], products: &mut [[f64; ROOM]; ROOM]) {
    add_products_of::<0>(rows, products);
    add_products_of::<4>(rows, products);
    add_products_of::<8>(rows, products);
    add_products_of::<12>(rows, products);
    add_products_of::<16>(rows, products);
}

/// Those of the columns of the vector that begins with `FIRST`, two at a time: as many sums as stay
/// in registers from one sample to the next.
#[inline(always)]
fn add_products_of<const FIRST: usize>(rows: &[[f64; ROOM]], products: &mut [[f64; ROOM]; ROOM]) {
    for first in [FIRST, FIRST + 2] {
        let mut sums = [[0.0; ROOM]; 2];
        for row in rows {
            for k in FIRST..ROOM {
                sums[0][k] += row[first] * row[k];
                sums[1][k] += row[first + 1] * row[k];
            }
        }
        for k in FIRST..ROOM {
            products[first][k] += sums[0][k];
            products[first + 1][k] += sums[1][k];
        }
    }
}

#[inline(always)]
fn terms(x: f64, y: f64) -> [f64; MEAN_TERMS] {
    let (x2, y2) = (x * x, y * y);
    [1.0, x, y, x2, x * y, y2, x2 * x, x2 * y, x * y2, y2 * y]
}

/// Written out, as iterator adapters are not always inlined.
#[inline(always)]
fn mean_and_contrast(light: &[f64; TERMS], terms: &[f64; MEAN_TERMS]) -> (f64, f64) {
    let [one, x, y, x2, xy, y2, x3, x2y, xy2, y3, of_pattern, x_of_pattern, y_of_pattern] = light;
    let linear = one + x * terms[1] + y * terms[2];
    let square = x2 * terms[3] + xy * terms[4] + y2 * terms[5];
    let cubic = x3 * terms[6] + x2y * terms[7] + xy2 * terms[8] + y3 * terms[9];
    let contrast = of_pattern + x_of_pattern * terms[1] + y_of_pattern * terms[2];
    (linear + square + cubic, contrast)
}

#[cfg(test)]
#[path = "local_light_tests.rs"]
mod tests;
