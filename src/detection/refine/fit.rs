//! Fitting the corner model to its samples: Levenberg and Marquardt's method on weighted squares.

use crate::detection::refine::cholesky::Cholesky;
use crate::detection::refine::corner_model::{CornerModel, UNKNOWNS};
use crate::detection::refine::normal_equations::{Columns, Noise, NormalEquations, linearise};
use crate::detection::refine::samples::Samples;

/// How to fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct FitOptions {
    /// Linearisations at most.
    pub iterations: usize,
    /// Stop when a step moves the corner by less than this, in samples.
    pub enough: f64,
    /// Whether the gradient of the light is fitted, or left as the model has it.
    pub fit_gradient: bool,
}

/// A fitted corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// The model.
    pub model: CornerModel,
    /// The last linearisation.
    pub equations: NormalEquations,
    /// Covariance of the corner's position per unit of noise: xx, xy, yy, in squared samples.
    pub covariance: [f64; 3],
}

/// Fits from `start`; `None` where the samples do not determine a corner.
pub(super) fn fit(
    samples: &Samples,
    start: CornerModel,
    noise: &Noise,
    options: &FitOptions,
    columns: &mut Columns,
) -> Option<Fit> {
    let mut model = start;
    let mut damping = 1e-3;
    let mut best: Option<(CornerModel, NormalEquations)> = None;
    for _ in 0..options.iterations {
        let equations = linearise(samples, &model, noise, columns);
        let cost = equations.squares / equations.effective.max(1.0);
        match &best {
            Some((_, known)) if cost > 1.02 * known.squares / known.effective.max(1.0) => damping *= 10.0,
            _ => {
                best = Some((model, equations));
                damping *= 0.3;
            }
        }
        let (from, equations) = best.as_ref()?;
        let step = solve(equations, damping, options.fit_gradient)?;
        model = from.moved_by(&step);
        let moved = (model.center[0] - from.center[0]).hypot(model.center[1] - from.center[1]);
        if moved < options.enough {
            break;
        }
    }
    let (_, equations) = best?;
    let covariance = position_covariance(&equations, &model, options.fit_gradient)?;
    let finite = model.center.iter().all(|v| v.is_finite());
    finite.then_some(Fit { model, equations, covariance })
}

fn prepared(equations: &NormalEquations, damping: f64, fit_gradient: bool) -> [[f64; UNKNOWNS]; UNKNOWNS] {
    let mut normal = equations.normal;
    for (k, row) in normal.iter_mut().enumerate() {
        row[k] *= 1.0 + damping;
    }
    if !fit_gradient {
        for k in [2, 3] {
            for other in 0..UNKNOWNS {
                normal[k.max(other)][k.min(other)] = 0.0;
            }
            normal[k][k] = 1.0;
        }
    }
    normal
}

fn solve(equations: &NormalEquations, damping: f64, fit_gradient: bool) -> Option<[f64; UNKNOWNS]> {
    let mut right = equations.gradient;
    if !fit_gradient {
        right[2] = 0.0;
        right[3] = 0.0;
    }
    Some(Cholesky::new(&prepared(equations, damping, fit_gradient))?.solve(&right))
}

fn position_covariance(equations: &NormalEquations, model: &CornerModel, fit_gradient: bool) -> Option<[f64; 3]> {
    let factor = Cholesky::new(&prepared(equations, 0.0, fit_gradient))?;
    let shifts = [0, 1].map(|k| {
        let mut unit = [0.0; UNKNOWNS];
        unit[k] = 1.0;
        let column = factor.solve(&unit);
        [column[0], column[1]]
    });
    // Columns of the map from shifts of the edges to moves of the corner.
    let (a, b) = (model.center_move([1.0, 0.0]), model.center_move([0.0, 1.0]));
    let moves = |i: usize, j: usize| {
        a[i] * (shifts[0][0] * a[j] + shifts[0][1] * b[j]) + b[i] * (shifts[1][0] * a[j] + shifts[1][1] * b[j])
    };
    Some([moves(0, 0), moves(0, 1), moves(1, 1)])
}
