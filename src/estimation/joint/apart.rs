//! What each sight says by itself at one state: its own normal equations, kept apart, so that those
//! of any of the sights can be put together without looking at a corner again.

use crate::estimation::joint::linearize::{Columns, LocalEquations, linearize_sight};
use crate::estimation::joint::normal::{NormalEquations, chain};
use crate::estimation::joint::{Layout, Sight, State};
use crate::estimation::robust::Loss;

/// Looks at the sights in `which`, with plain squares: one entry per sight, empty for the others.
/// `None` where a corner that takes part cannot be projected.
pub(crate) fn looked_at(
    (layout, state): (&Layout, &State),
    sights: &[Sight],
    which: &[usize],
) -> Option<Vec<LocalEquations>> {
    let mut apart: Vec<LocalEquations> = sights.iter().map(|_| LocalEquations::default()).collect();
    let (mut columns, mut residuals) = (Columns::default(), Vec::new());
    for index in which {
        let sight = &sights[*index];
        residuals.resize(sight.points.len(), [0.0; 2]);
        let results = (residuals.as_mut_slice(), &mut apart[*index]);
        if !linearize_sight((layout, state), sight, Loss::Squares, &mut columns, results) {
            return None;
        }
    }
    Some(apart)
}

/// The normal equations of some of the sights, without residuals: `parts` are pairs of a sight, by
/// its place in `apart`, and of the instant, counted from 0 to below `instants`, that it stands
/// for.
pub(crate) fn together(
    apart: &[LocalEquations],
    (layout, state): (&Layout, &State),
    sights: &[Sight],
    (parts, instants): (impl Iterator<Item = (usize, usize)>, usize),
) -> NormalEquations {
    let mut equations = NormalEquations::empty(layout.len, instants);
    for (index, instant) in parts {
        let (local, sight) = (&apart[index], &sights[index]);
        if local.columns == 0 {
            continue;
        }
        let chained = layout.sensors[sight.sensor]
            .pose_at
            .map(|_| chain(state, (sight.sensor, sight.instant)));
        equations.cost += local.cost;
        equations.add(layout, (sight.sensor, instant), chained, local);
    }
    equations.mirror();
    equations
}
