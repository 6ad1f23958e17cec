//! Levenberg–Marquardt: damping by the gain ratio, the actual over the predicted decrease of the
//! cost.
//!
//! K. Madsen, H. B. Nielsen, O. Tingleff, *Methods for non-linear least squares problems*, 2004,
//! section 3.2, with Marquardt's scaling by the diagonal.

use crate::estimation::joint::linearize::Columns;
use crate::estimation::joint::normal::{NormalEquations, Step, linearize, linearize_within};
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::robust::Loss;

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stop {
    /// The largest number of steps. Default: 50.
    pub(crate) max_steps: usize,
    /// Converged below this predicted decrease of the cost, in units of one residual's mean cost. A
    /// decrease of d corresponds to √d standard deviations of the estimate. Default: 1e-6.
    pub(crate) decrease: f64,
    /// The same as a part of the whole cost. Default: 0.
    pub(crate) part: f64,
    /// Damping of the first step. Default: 1e-3.
    pub(crate) lambda: f64,
}

impl Default for Stop {
    fn default() -> Self {
        Self { max_steps: 50, decrease: 1e-6, part: 0.0, lambda: 1e-3 }
    }
}

/// A state with its normal equations.
#[derive(Debug, Clone)]
pub(crate) struct Minimum {
    pub(crate) state: State,
    pub(crate) equations: NormalEquations,
    /// Number of linearizations, of accepted and rejected steps.
    pub(crate) steps: usize,
}

/// Residuals this small, in standard deviations, are rounding: the data is exact.
const EXACT_STDS: f64 = 1e-11;

impl Minimum {
    /// The start of an iteration. `None` where a used corner cannot be projected.
    pub(crate) fn start(
        layout: &Layout,
        start: State,
        observations: &[BoardObservation],
        loss: Loss,
    ) -> Option<Self> {
        let equations = linearize(layout, &start, observations, loss)?;
        Some(Self { state: start, equations, steps: 1 })
    }

    /// Iterates to the nearest minimum.
    pub(crate) fn descend(
        self,
        layout: &Layout,
        observations: &[BoardObservation],
        loss: Loss,
        stop: Stop,
    ) -> Self {
        let residual_count: usize =
            observations.iter().map(|s| 2 * s.used.iter().filter(|used| **used).count()).sum();
        let Self { state, equations, steps } = self;
        let mut columns = Columns::default();
        let linearize =
            |state: &State| linearize_within(layout, state, observations, loss, &mut columns);
        let stepped =
            |state: &State, step: &Step| state.stepped(layout, &step.global, &step.frame_sets);
        let (state, equations, more) =
            walk((state, equations), residual_count, stop, (linearize, stepped));
        Self { state, equations, steps: steps + more }
    }
}

/// Iterates from a state, given with its normal equations, to the nearest minimum. The last value
/// returned is the number of linearizations.
pub(crate) fn walk<S>(
    (mut state, mut equations): (S, NormalEquations),
    residual_count: usize,
    stop: Stop,
    (mut linearize, stepped): (
        impl FnMut(&S) -> Option<NormalEquations>,
        impl Fn(&S, &Step) -> Option<S>,
    ),
) -> (S, NormalEquations, usize) {
    let (mut lambda, mut growth, mut steps) = (stop.lambda, 2.0, 0);
    for _ in 0..stop.max_steps {
        let mean_cost = equations.cost / residual_count.max(1) as f64;
        if mean_cost < EXACT_STDS * EXACT_STDS {
            break;
        }
        let step = equations.solve(lambda);
        let predicted = step.as_ref().map_or(f64::INFINITY, |step| step.predicted_decrease);
        if predicted <= (stop.decrease * mean_cost).max(stop.part * equations.cost) {
            break;
        }
        let trial = step.as_ref().and_then(|step| {
            let next = stepped(&state, step)?;
            let equations = linearize(&next)?;
            Some((next, equations))
        });
        steps += 1;
        match trial {
            Some((next, at_next)) if at_next.cost <= equations.cost => {
                let gain = (equations.cost - at_next.cost) / predicted;
                (state, equations) = (next, at_next);
                lambda = if gain > 0.75 {
                    lambda * 0.1
                } else {
                    lambda * (1.0 - (2.0 * gain - 1.0).powi(3)).max(0.1)
                };
                if lambda < 1e-9 {
                    lambda = 0.0;
                }
                growth = 2.0;
            }
            _ => {
                lambda = lambda.max(1e-6) * growth;
                growth *= 2.0;
            }
        }
        if lambda > 1e12 {
            break;
        }
    }
    (state, equations, steps)
}
