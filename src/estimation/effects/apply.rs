//! Adds board shape and motion to a plain fit, one of lens and poses only.

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::effect::CandidateEffects;
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::effects::fit::{Corners, Effects, fit_effects, fit_same_effects};
use crate::estimation::effects::score_tests::plausible;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::problem::{BoardShape, CameraOptions, Shutter};
use crate::estimation::robust::Loss;
use crate::geometry::pixel::ImageSize;

/// Continues the fit of one camera with the board's shape and motion, as far as the views show
/// them. Returns the fit unchanged where they show neither.
pub(crate) fn with_effects(fit: CameraFit, size: ImageSize, options: &CameraOptions) -> CameraFit {
    with_effects_from(fit, None, size, options)
}

/// As [`with_effects`], starting from the effects `found` in another fit of the same views.
pub(crate) fn with_effects_from(
    fit: CameraFit,
    found: Option<&EffectsFit>,
    size: ImageSize,
    options: &CameraOptions,
) -> CameraFit {
    let Some(candidates) = candidates(&fit, options) else { return fit };
    let sides = [size.width, size.height].map(f64::from);
    let Some(Effects { found, shutter_step }) = fit_effects(&fit, found, sides, candidates) else {
        return fit;
    };
    let with = found.and_then(|found| continued(&fit, size, found));
    CameraFit { shutter_step, ..with.unwrap_or(fit) }
}

/// Continues a plain fit with the same effects that were `found` with another lens on the same
/// corners. Two lenses can then be compared: neither gains from motion that is fitted to a single
/// view.
pub(crate) fn with_same_effects(
    fit: &CameraFit,
    found: &EffectsFit,
    size: ImageSize,
) -> Option<CameraFit> {
    let same = fit_same_effects(fit, found, f64::from(size.height))?;
    let (observations, faults) = (fit.observations.clone(), fit.faults.clone());
    continued(fit, size, (same, Corners { observations, faults, limit: fit.robust.limit }))
}

/// Whether the residuals of a plain fit of one camera hint at effects that [`with_effects`]
/// searches for.
pub(crate) fn may_have_effects(fit: &CameraFit, size: ImageSize, options: &CameraOptions) -> bool {
    let size = [size.width, size.height].map(f64::from);
    candidates(fit, options).and_then(|candidates| plausible(fit, size, candidates)).is_some()
}

/// The effects to search for. `None` where the options ask for none, or the fit cannot have any.
fn candidates(fit: &CameraFit, options: &CameraOptions) -> Option<CandidateEffects> {
    let candidates = CandidateEffects {
        shape: options.board_shape != BoardShape::Flat && options.measured_board.is_none(),
        motion: options.shutter != Shutter::Global,
        is_shape_required: options.board_shape == BoardShape::Free,
        is_motion_required: options.shutter == Shutter::Rolling,
    };
    let can_have = !fit.is_exact() && fit.layout.sensors.len() == 1;
    (can_have && (candidates.shape || candidates.motion)).then_some(candidates)
}

fn continued(
    plain: &CameraFit,
    size: ImageSize,
    (found, corners): (EffectsFit, Corners),
) -> Option<CameraFit> {
    let rows = f64::from(size.height);
    let mut observations = found.moved_observations(&plain.layout, &corners.observations, rows);
    for (observation, fault) in observations.iter_mut().zip(&corners.faults) {
        if fault.is_some() {
            observation.used.fill(false);
        }
    }
    let state = found.state.fixed.clone();
    let mut fit = plain.clone();
    let mut minimum = Minimum::start(&plain.layout, state, &observations, Loss::Squares)?;
    if found.shutter_agreement < 1.0 {
        let stop = Stop { lambda: 0.0, ..Stop::default() };
        // The mean of two minima is only a few steps from a minimum of its own.
        minimum = minimum.descend(&plain.layout, &observations, Loss::Squares, stop);
    }
    fit.robust.minimum = minimum;
    fit.robust.limit = corners.limit;
    fit.observations = observations;
    fit.faults = corners.faults;
    fit.effects = Some(found);
    Some(fit)
}
