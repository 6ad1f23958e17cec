//! The fit of some of the frame sets, starting from the fit of all, and the errors of other frame
//! sets under it. For a single camera a frame set is a view.

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::linearize::LocalEquations;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::per_observation::assemble;
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::robust::Loss;

/// A fit of some views ends within 0.03 standard deviations of its minimum, which is close enough
/// for a comparison, or for halves.
const COMPARED_STOP: Stop = Stop { max_steps: 50, decrease: 1e-3, part: 0.0, lambda: 0.0 };

/// Where a step's cost equals the predicted one within this part, the problem is linear there, and
/// the step leads to its minimum.
const AS_PREDICTED_PART: f64 = 0.01;

/// The fit of some of the frame sets, starting from the fit of all, with the separate equations
/// `local`. Each frame set is given by the indices of its observations in `chosen`.
pub(crate) fn refit(
    fit: &CameraFit,
    chosen: &[BoardObservation],
    local: &[LocalEquations],
    frame_sets: &[Vec<usize>],
) -> Minimum {
    let all = &fit.robust.minimum.state;
    let parts = || {
        let numbered = frame_sets.iter().enumerate();
        numbered.flat_map(|(k, indices)| indices.iter().map(move |index| (*index, k)))
    };
    let observations: Vec<BoardObservation> = parts()
        .map(|(index, k)| BoardObservation { frame_set: k, ..chosen[index].clone() })
        .collect();
    let pose = |indices: &Vec<usize>| all.rig_from_board[chosen[indices[0]].frame_set];
    let state = State { rig_from_board: frame_sets.iter().map(pose).collect(), ..all.clone() };
    let equations = assemble(local, fit.minimum_point(), chosen, parts(), frame_sets.len());
    let start = Minimum { state, equations, steps: 0 };
    start.descend(&fit.layout, &observations, Loss::Squares, COMPARED_STOP)
}

/// The sum of squared pixel errors of `sensor` in one frame set, at the best pose of the board for
/// all its observations `seen`, with the lenses and sensor poses of `under`.
pub(crate) fn squares_under<'a>(
    under: &State,
    fit: &CameraFit,
    seen: impl Iterator<Item = &'a BoardObservation> + Clone,
    sensor: usize,
) -> Option<f64> {
    let own = seen.clone().position(|observation| observation.sensor == sensor)?;
    let pose = fit.robust.minimum.state.rig_from_board[seen.clone().next()?.frame_set];
    let observations: Vec<BoardObservation> =
        seen.map(|observation| BoardObservation { frame_set: 0, ..observation.clone() }).collect();
    let layout = Layout::of_known_sensors(&under.lenses).ended_by(&fit.layout.interrupt);
    let state = State { rig_from_board: vec![pose], ..under.clone() };
    let loss = Loss::Squares;
    let mut minimum = Minimum::start(&layout, state, &observations, loss)?;
    let step = minimum.equations.solve(0.0)?;
    let stepped = minimum.state.stepped(&layout, &step.global, &step.frame_sets)?;
    let mut residuals: Vec<Vec<[f64; 2]>> =
        observations.iter().map(|observation| stepped.residuals(&layout, observation)).collect();
    let cost: f64 = observations.iter().zip(&residuals).map(|(o, r)| used_squares(o, r)).sum();
    // A step that ends as predicted needs no second one.
    let predicted = minimum.equations.cost - step.predicted_decrease;
    if !cost.is_finite() || (cost - predicted).abs() > AS_PREDICTED_PART * cost {
        let stop = Stop { lambda: 0.0, decrease: 1e-4, ..Stop::default() };
        minimum = minimum.descend(&layout, &observations, loss, stop);
        residuals = minimum.equations.residuals;
    }
    let in_pixels: Vec<[f64; 2]> = residuals[own]
        .iter()
        .zip(&observations[own].inverse_std)
        .map(|(residual, inverse_std)| residual.map(|r| r / inverse_std))
        .collect();
    Some(used_squares(&observations[own], &in_pixels)).filter(|squares| squares.is_finite())
}

/// The sum of the squares of these residuals over the corners in use.
fn used_squares(observation: &BoardObservation, residuals: &[[f64; 2]]) -> f64 {
    let used = residuals.iter().zip(&observation.used).filter(|(_, used)| **used);
    used.map(|([x, y], _)| x * x + y * y).sum()
}
