//! Fits the corner model to its samples: weighted least squares by Levenberg–Marquardt.

use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::elimination::solve;
use crate::detection::refine::normal_equations::{
    CornerEquations, Linearized, ModelColumns, Noise, Residuals,
};
use crate::detection::refine::samples::Samples;

/// How to fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct FitOptions {
    /// The least number of linearizations, unless the start was `alike`, and the greatest.
    pub iterations: [usize; 2],
    /// Stop when a step moves the corner by less than this, in standard deviations of the blur:
    /// convergence is quadratic, so the remaining error is its square.
    pub enough: f64,
    /// If the first step changes no other unknown by more than this, relatively or in radians, one
    /// linearization is enough.
    pub alike: f64,
    /// Whether the residuals where the pattern is flat are wanted.
    pub with_flat: bool,
}

/// A fitted corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct CornerFit {
    /// The model.
    pub model: CornerModel,
    /// How well it fits, before the last step.
    pub residuals: Residuals,
    /// Mean square of the residuals after the last step, in units of the noise: predicted by the
    /// linearization, and corrected for the unknowns and the robust weights.
    pub mean_square: f64,
    /// The same as gray levels.
    pub residual_rms: f64,
    /// Covariance of the corner's position per unit of noise: xx, xy, yy, in squared samples.
    pub covariance: [f64; 3],
    /// How far the last step moved the corner, in samples.
    pub last_step: f64,
}

impl CornerFit {
    /// Standard deviation of the corner's position per axis, in samples. The noise is estimated
    /// from this fit's own residuals, so that misfit makes the corner less certain.
    pub fn position_std(&self) -> f64 {
        let [xx, _, yy] = self.covariance;
        ((xx + yy) / 2.0 * self.mean_square).sqrt()
    }
}

/// If the final damping is greater, the covariance is computed again without it: chosen, not swept.
const HARDLY_DAMPED: f64 = 1e-2;
/// Marquardt's λ of the first step, as a part of each diagonal element, and its factors after a
/// step that raised the mean square and after one that did not: chosen, not swept.
const START_DAMPING: f64 = 1e-4;
const DAMPING_RISE: f64 = 10.0;
const DAMPING_FALL: f64 = 0.3;
/// A step that raises the mean square by more than this factor is taken back; less may be the
/// robust weights', which change with each linearization. Chosen, not swept.
const WORSE: f64 = 1.02;

/// Fits from `start`. On return, `columns` hold the linearization before the last step. `None`
/// where the samples do not determine a corner.
pub(super) fn fit(
    samples: &Samples,
    start: CornerModel,
    noise: &Noise,
    options: &FitOptions,
    columns: &mut ModelColumns,
) -> Option<CornerFit> {
    let mut model = start;
    let mut damping = START_DAMPING;
    let mut best = start;
    let (mut first, mut second) = (CornerEquations::default(), CornerEquations::default());
    let (mut equations, mut next) = (&mut first, &mut second);
    let [least, most] = options.iterations;
    let linearized = Linearized { samples, noise, with_flat: options.with_flat };
    for iteration in 1..=most {
        linearized.at(&model, columns, next);
        let is_worse = iteration > 1
            && next.residuals.mean_square() > WORSE * equations.residuals.mean_square();
        if is_worse {
            damping *= DAMPING_RISE;
        } else {
            damping *= DAMPING_FALL;
            best = model;
            std::mem::swap(&mut equations, &mut next);
        }
        let solved = solve(&equations.products, damping)?;
        model = best.moved_by(&solved.step);
        let last_step =
            length([model.center[0] - best.center[0], model.center[1] - best.center[1]]);
        let sharpness = best.sharpness[0].max(best.sharpness[1]);
        let rests = last_step * sharpness < options.enough;
        if (rests && (iteration >= least || model.is_like(&best, options.alike)))
            || iteration == most
        {
            let residuals = equations.residuals;
            // Damping would make the covariance too small.
            let undamped = (damping > HARDLY_DAMPED).then(|| solve(&equations.products, 0.0));
            let last_covariance =
                undamped.flatten().map_or(solved.last_covariance, |it| it.last_covariance);
            if is_worse {
                linearized.at(&best, columns, next);
            }
            let mean_square = noise.corrected(&residuals, solved.left);
            return Some(CornerFit {
                model,
                residuals,
                mean_square,
                residual_rms: (mean_square * noise.variance()).sqrt(),
                covariance: position_covariance(last_covariance, &model),
                last_step,
            });
        }
    }
    None
}

/// The covariance of the corner's position, from that of the edges' offsets (xx, xy, yy).
pub(super) fn position_covariance([aa, ab, bb]: [f64; 3], model: &CornerModel) -> [f64; 3] {
    let (a, b) = (model.center_move([1.0, 0.0]), model.center_move([0.0, 1.0]));
    let moves =
        |i: usize, j: usize| a[i] * a[j] * aa + (a[i] * b[j] + b[i] * a[j]) * ab + b[i] * b[j] * bb;
    [moves(0, 0), moves(0, 1), moves(1, 1)]
}
