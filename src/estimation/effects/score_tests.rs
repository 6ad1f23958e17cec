//! Which effects are plausible: score tests (C. R. Rao, 1948) of a smooth board shape, of each
//! corner's own offset and of motion, at the plain minimum. They take less time than one step, and
//! for a flat board and a global shutter nothing else is computed.

use nalgebra::DMatrix;

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::effect::CandidateEffects;
use crate::estimation::effects::state::{EffectsState, Scene};
use crate::estimation::effects::system::{System, ViewPart};

/// A sum of squares that exceeds its expectation by this many standard deviations is a hint.
const HINT: f64 = 2.0;

/// The effects of `candidates` that the residuals hint at; `None` for none.
pub(super) fn plausible(
    fit: &CameraFit,
    [_, rows]: [f64; 2],
    candidates: CandidateEffects,
) -> Option<CandidateEffects> {
    let good = fit.some_views();
    let basis = BoardBasis::of(&fit.observations, false)?;
    let (layout, observations) = (&fit.layout, &fit.observations);
    let (good, basis) = (&good, &basis);
    let scene = Scene { layout, basis, observations, good, rows, by_columns: None, moves: true };
    let plain = fit.robust.minimum.state.clone();
    let state = EffectsState::without_effects(plain, basis, observations.len());
    let system = System::at(scene, &state)?;
    let noise_square = fit.noise_square();
    let smooth = smooth_shape(&system, layout.len)
        .is_none_or(|square| is_significant(square / noise_square, basis.len() as f64));
    let shape = smooth || are_point_offsets_significant(&system, noise_square);
    let motion = is_significant(motion(&system) / noise_square, 6.0 * good.len() as f64);
    let candidates = CandidateEffects {
        shape: candidates.shape && (shape || candidates.is_shape_required),
        motion: candidates.motion && (motion || candidates.is_motion_required),
        ..candidates
    };
    (candidates.shape || candidates.motion).then_some(candidates)
}

fn is_significant(square: f64, count: f64) -> bool {
    square > count + HINT * (2.0 * count).sqrt()
}

/// gᵀ H⁻¹ g of the smooth shapes, lens and poses eliminated.
fn smooth_shape(system: &System, lens: usize) -> Option<f64> {
    let size = system.gradient.len();
    let scale = system.global.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
    let scaled = DMatrix::from_fn(size, size, |i, j| system.global[(i, j)] * scale[i] * scale[j]);
    let gradient = system.gradient.component_mul(&scale);
    let decrease = |size: usize| -> Option<f64> {
        let gradient = gradient.rows(0, size).into_owned();
        let block = scaled.view((0, 0), (size, size)).into_owned();
        Some(gradient.dot(&block.cholesky()?.solve(&gradient)))
    };
    Some(decrease(size)? - decrease(lens)?)
}

/// Σ |L⁻¹ g|² over the motion of every view, its pose eliminated.
fn motion(system: &System) -> f64 {
    let of_view = |view: &ViewPart| {
        let factor = view.motion.cholesky()?;
        Some(view.motion_gradient.dot(&factor.solve(&view.motion_gradient)))
    };
    system.views.iter().filter_map(of_view).sum()
}

/// Whether offsets of single points, each the same in all views, would explain more than chance.
fn are_point_offsets_significant(system: &System, noise_square: f64) -> bool {
    let (square, count) = point_offset_square(system);
    is_significant(square / noise_square, count)
}

/// Whether they would explain more than is expected by chance. Where the board has a shape, a hint
/// is not needed: of 18 photographs, removing one ended it, and without the offsets the focal length
/// changed by 2.7 standard deviations.
pub(super) fn may_have_point_offsets(system: &System, noise_square: f64) -> bool {
    let (square, count) = point_offset_square(system);
    square / noise_square > count
}

/// Σ g² / h over the points' own x and y, and the number of these.
fn point_offset_square(system: &System) -> (f64, f64) {
    let seen =
        || system.point_offset_scores.iter().filter(|score| score[2] > 0.0 && score[3] > 0.0);
    let square = seen().map(|[x, y, xx, yy]| x * x / xx + y * y / yy).sum();
    (square, 2.0 * seen().count() as f64)
}
