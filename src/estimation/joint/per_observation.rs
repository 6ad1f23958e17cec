//! The normal equations of each observation separately at one state, so that those of any subset
//! can be assembled without another pass over the corners.

use crate::estimation::joint::BoardObservation;
use crate::estimation::joint::linearize::{
    Columns, LinearizationPoint, LinearizedObservation, LocalEquations, linearize_observation,
};
use crate::estimation::joint::normal::{ChainedPose, NormalEquations};
use crate::estimation::robust::Loss;

/// Linearizes the observations in `which`, without a robust loss. The result has one entry per
/// observation, empty for the others. `None` where a used corner cannot be projected, or an
/// interrupt was requested.
pub(crate) fn linearize_each(
    at: LinearizationPoint<'_>,
    observations: &[BoardObservation],
    which: &[usize],
) -> Option<Vec<LocalEquations>> {
    let mut local_equations: Vec<LocalEquations> =
        observations.iter().map(|_| LocalEquations::default()).collect();
    let (mut columns, mut residuals) = (Columns::default(), Vec::new());
    for index in which {
        if at.layout.interrupt.is_requested() {
            return None;
        }
        let observation = &observations[*index];
        residuals.resize(observation.points.len(), [0.0; 2]);
        let into = LinearizedObservation {
            residuals: &mut residuals,
            local: &mut local_equations[*index],
        };
        if !linearize_observation(at, observation, Loss::Squares, &mut columns, into) {
            return None;
        }
    }
    Some(local_equations)
}

/// The normal equations of some of the observations, without residuals. `parts` are pairs of an
/// observation's index in `local_equations` and of its frame set in the assembled equations, less
/// than `frame_sets`.
pub(crate) fn assemble(
    local_equations: &[LocalEquations],
    at: LinearizationPoint<'_>,
    observations: &[BoardObservation],
    parts: impl Iterator<Item = (usize, usize)>,
    frame_sets: usize,
) -> NormalEquations {
    let LinearizationPoint { layout, state } = at;
    let mut equations = NormalEquations::empty(layout.len, frame_sets);
    for (index, frame_set) in parts {
        let (local, observation) = (&local_equations[index], &observations[index]);
        if local.columns == 0 {
            continue;
        }
        let chained = ChainedPose::where_posed(layout, state, observation);
        equations.cost += local.cost;
        equations.add(layout, observation.sensor, frame_set, chained, local);
    }
    equations.mirror();
    equations
}
