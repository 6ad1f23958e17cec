//! How well another lens would fit when board shape and motion are in the model too, estimated by
//! one step.

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::evidence::ReducedSystem;
use crate::estimation::effects::state::{EffectsState, Scene};
use crate::estimation::effects::system::System;
use crate::estimation::joint::{BoardObservation, Layout};
use crate::geometry::lens::Lens;

/// The costs of a fit with effects, and of the same fit with another `lens` close to its own after
/// one step of all parameters at fixed variances. The same cost twice where the views do not
/// determine the other lens. `stated` are the observations with the board as it was stated, `rows`
/// is the height of the images. `None` where the fit has no effects, or the other lens cannot
/// project all corners.
pub(crate) fn costs_beside_effects(
    fit: &CameraFit,
    stated: &[BoardObservation],
    rows: f64,
    layout: &Layout,
    lens: Lens,
) -> Option<[f64; 2]> {
    let found = fit.effects.as_ref()?;
    let (basis, good) = (&found.basis, fit.good_views());
    let observations: Vec<BoardObservation> = stated
        .iter()
        .zip(&fit.observations)
        .map(|(stated, fitted)| BoardObservation { used: fitted.used.clone(), ..stated.clone() })
        .collect();
    let scene = Scene {
        layout,
        basis,
        observations: &observations,
        good: &good,
        rows,
        by_columns: None,
        moves: found.variances.moves(),
    };
    let mut state: EffectsState = found.state.clone();
    state.fixed.lenses[0] = lens;
    let system = System::at(scene, &state)?;
    let freedom = |lens: usize| (system.residual_count as f64) - (lens + 6 * good.len()) as f64;
    let own = found.noise_square * freedom(fit.layout.len);
    let reduced = ReducedSystem::of(&system, &state, basis, layout.len, &found.variances);
    let larger = |reduced: ReducedSystem<'_>| reduced.noise_square(&state) * freedom(layout.len);
    Some([own, reduced.map_or(own, larger)])
}
