//! A robust fit, insensitive to wrong corners and wrong views: Huber's loss while the scale of the
//! residuals falls, then plain least squares over the inliers, selected again until the selection
//! no longer changes.

use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::robust::{Loss, median_scale};
use crate::estimation::view_fault::ViewFault;

/// Residual limit of an inlier, in standard deviations: four in a million Gaussian ones exceed it.
pub(crate) const LIMIT: f64 = 5.0;

/// Where Huber's loss becomes linear, in standard deviations.
const HUBER_STDS: f64 = 2.0;

/// With a smaller part of outliers, the result of plain least squares suffices to separate them.
const FEW_OUTLIERS_PART: f64 = 0.005;

/// Stops once the scale of the residuals is known to a few percent. There is little damping, since
/// a start from the closed form is close, and more would cost an additional step.
const ROUGH_STOP: Stop = Stop { max_steps: 50, decrease: 0.0, part: 0.02, lambda: 1e-4 };

/// A view with a smaller part of inliers has wrong labels, rather than some wrong corners.
const MIN_USED_PART: f64 = 0.6;

/// Residuals below this, in units of each corner's standard deviation, are rounding.
pub(crate) const ROUNDING: f64 = 1e-8;

/// A fit that has converged.
#[derive(Debug, Clone)]
pub(crate) struct RobustFit {
    pub(crate) minimum: Minimum,
    /// The largest residual of an inlier, in units of each corner's relative standard deviation.
    pub(crate) limit: f64,
}

/// Fits from `start`. Selects `used` of the observations whose `faults` entry is `None`, and adds
/// faults of views with too few inliers. `None` where nothing can be projected or everything was
/// rejected.
pub(crate) fn robust_fit(
    layout: &Layout,
    start: State,
    observations: &mut [BoardObservation],
    faults: &mut [Option<ViewFault>],
) -> Option<RobustFit> {
    let at_start: Vec<Vec<[f64; 2]>> =
        observations.iter().map(|observation| start.residuals(layout, observation)).collect();
    select(observations, &at_start, f64::INFINITY, faults);
    let mut scale = scale_of(observations, &at_start).max(ROUNDING);
    let clean = part_beyond(LIMIT * scale, observations, &at_start) < FEW_OUTLIERS_PART;
    let mut loss = if clean { Loss::Squares } else { huber(scale) };
    let minimum = Minimum::start(layout, start, observations, loss)?;
    let mut minimum = minimum.descend(layout, observations, loss, ROUGH_STOP);
    for _ in 0..12 {
        let next = scale_of(observations, &minimum.equations.residuals).max(ROUNDING);
        let settled = next > 0.8 * scale
            || part_beyond(LIMIT * next, observations, &minimum.equations.residuals)
                < FEW_OUTLIERS_PART;
        scale = next;
        if settled {
            break;
        }
        select(observations, &minimum.equations.residuals, f64::INFINITY, faults);
        loss = huber(scale);
        minimum = Minimum::start(layout, minimum.state, observations, loss)?.descend(
            layout,
            observations,
            loss,
            ROUGH_STOP,
        );
    }
    for round in 0..10 {
        let changed = select(observations, &minimum.equations.residuals, LIMIT * scale, faults);
        if round > 0 && !changed {
            break;
        }
        // Huber's loss whose linear part no residual reaches is least squares.
        let was_squares = match loss {
            Loss::Squares => true,
            Loss::Huber { scale } => {
                part_beyond(scale, observations, &minimum.equations.residuals) == 0.0
            }
        };
        if changed || !was_squares {
            minimum = Minimum::start(layout, minimum.state, observations, Loss::Squares)?;
        }
        loss = Loss::Squares;
        minimum =
            minimum.descend(layout, observations, loss, Stop { lambda: 0.0, ..Stop::default() });
        scale = scale_of(observations, &minimum.equations.residuals).max(ROUNDING);
    }
    let anything = observations.iter().any(|observation| observation.used.contains(&true));
    anything.then_some(RobustFit { minimum, limit: LIMIT * scale })
}

fn huber(scale: f64) -> Loss {
    Loss::Huber { scale: HUBER_STDS * scale }
}

/// Whether the residuals show that a rejected view is good after all: nine of ten corners are
/// within `limit`. With wrong labels, few are.
pub(crate) fn is_explained(residuals: &[[f64; 2]], limit: f64) -> bool {
    let inliers = residuals.iter().filter(|[x, y]| x.hypot(*y) <= limit).count();
    10 * inliers >= 9 * residuals.len()
}

/// The scale of the residuals of all views without a fault.
pub(crate) fn scale_of(observations: &[BoardObservation], residuals: &[Vec<[f64; 2]>]) -> f64 {
    let used = observations
        .iter()
        .zip(residuals)
        .filter(|(observation, _)| observation.used.contains(&true));
    median_scale(used.flat_map(|(_, residuals)| residuals.iter().copied()))
}

/// The part of the used corners whose residuals exceed `limit`.
fn part_beyond(limit: f64, observations: &[BoardObservation], residuals: &[Vec<[f64; 2]>]) -> f64 {
    let corners = || {
        observations
            .iter()
            .zip(residuals)
            .flat_map(|(s, r)| s.used.iter().zip(r))
            .filter(|(used, _)| **used)
    };
    let beyond = corners().filter(|(_, [x, y])| x * x + y * y > limit * limit).count();
    beyond as f64 / corners().count().max(1) as f64
}

/// Selects the inliers: corners that can be projected, with residuals within `limit`. Returns
/// whether the selection changed.
pub(crate) fn select(
    observations: &mut [BoardObservation],
    residuals: &[Vec<[f64; 2]>],
    limit: f64,
    faults: &mut [Option<ViewFault>],
) -> bool {
    let mut changed = false;
    for ((observation, residuals), fault) in observations.iter_mut().zip(residuals).zip(faults) {
        let within = |[x, y]: &[f64; 2]| x.is_finite() && (*x * *x + *y * *y) <= limit * limit;
        let good = residuals.iter().filter(|r| within(r)).count();
        let points = residuals.len();
        if fault.is_none() && (good as f64) < MIN_USED_PART * points as f64 {
            let mean_std = observation.inverse_std.iter().map(|inverse| 1.0 / inverse).sum::<f64>()
                / points as f64;
            *fault = Some(ViewFault::Outliers {
                outliers: points - good,
                points,
                limit_px: limit * mean_std,
            });
        }
        for (used, residual) in observation.used.iter_mut().zip(residuals) {
            let next = fault.is_none() && within(residual);
            changed |= next != *used;
            *used = next;
        }
    }
    changed
}
