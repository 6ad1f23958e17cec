//! The normal equations of each observation separately at one state, so that those of any subset
//! can be assembled without another pass over its corners.

use crate::estimation::joint::linearize::{Columns, LocalEquations, linearize_observation};
use crate::estimation::joint::normal::{ChainedPose, NormalEquations};
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::robust::Loss;

/// Linearizes the observations in `which`, with plain squares: one entry per observation, empty for
/// the others. `None` where a used corner cannot be projected.
pub(crate) fn linearize_each(
    (layout, state): (&Layout, &State),
    observations: &[BoardObservation],
    which: &[usize],
) -> Option<Vec<LocalEquations>> {
    let mut local_equations: Vec<LocalEquations> =
        observations.iter().map(|_| LocalEquations::default()).collect();
    let (mut columns, mut residuals) = (Columns::default(), Vec::new());
    for index in which {
        if layout.interrupt.is_requested() {
            return None;
        }
        let observation = &observations[*index];
        residuals.resize(observation.points.len(), [0.0; 2]);
        let results = (residuals.as_mut_slice(), &mut local_equations[*index]);
        if !linearize_observation(
            (layout, state),
            observation,
            Loss::Squares,
            &mut columns,
            results,
        ) {
            return None;
        }
    }
    Some(local_equations)
}

/// The normal equations of some of the observations, without residuals: `parts` are pairs of an
/// observation's index in `local_equations` and of the frame set, counted from 0 to below
/// `frame_sets`, that it is assembled as.
pub(crate) fn assemble(
    local_equations: &[LocalEquations],
    (layout, state): (&Layout, &State),
    observations: &[BoardObservation],
    (parts, frame_sets): (impl Iterator<Item = (usize, usize)>, usize),
) -> NormalEquations {
    let mut equations = NormalEquations::empty(layout.len, frame_sets);
    for (index, frame_set) in parts {
        let (local, observation) = (&local_equations[index], &observations[index]);
        if local.columns == 0 {
            continue;
        }
        let chained = ChainedPose::where_posed((layout, state), observation);
        equations.cost += local.cost;
        equations.add(layout, (observation.sensor, frame_set), chained, local);
    }
    equations.mirror();
    equations
}
