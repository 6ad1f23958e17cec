//! How well the images determine the lens: the covariance of the lens from that of everything, and
//! from what observations that err together do to it.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::estimation::scene::bundle::{Bundle, CameraMotion, SceneState};
use crate::estimation::scene::clusters::SharedErrors;

/// What is known of the lens.
#[derive(Debug, Clone, PartialEq)]
pub struct LensCovariance {
    /// Of the free parameters, in their order, in squared pixels and so on; with everything below.
    pub matrix: DMatrix<f64>,
    /// What it is if each observation errs by itself, with the standard deviations that it has.
    pub independent: DMatrix<f64>,
    /// The factor on the variances because observations err together, the mean over all directions,
    /// 1 or more.
    pub shared: f64,
    /// What of `shared` the observations' standard deviations have in them.
    pub widened: f64,
}

/// The covariance of the lens at the minimum `state` of `bundle`, whose observations have standard
/// deviations √`widened` times their true ones; `None` where something is not determined at all.
///
/// Observations err together by image (motion blur, rolling shutter), by part of the scene (what
/// moves, surfaces seen at a slant, edges before a background, wrong matches) and by region of the
/// image (what the lens model does not follow).
pub fn lens_covariance(
    bundle: &Bundle,
    state: &SceneState,
    widened: f64,
) -> Option<LensCovariance> {
    let reduced = bundle.reduced(state, 0.0);
    let kept = kept_parameters(bundle, state);
    let matrix = reduced.matrix.select_rows(&kept).select_columns(&kept);
    let covariance = matrix.cholesky()?.inverse();
    let lens = bundle.free.len();
    let independent = covariance.view((0, 0), (lens, lens)).into_owned();
    let positive = (0..lens).all(|k| independent[(k, k)] > 0.0);
    if !positive || independent.iter().any(|v| !v.is_finite()) {
        return None;
    }
    if lens == 0 {
        let matrix = independent.clone();
        return Some(LensCovariance { matrix, independent, shared: 1.0, widened });
    }
    let root = independent.clone().cholesky()?.l();
    let whitening = root.clone().try_inverse()?;
    let mut steps = DMatrix::zeros(bundle.size(state.cameras_from_scene.len()), lens);
    let whitened = covariance.columns(0, lens) * whitening.transpose();
    for (row, column) in kept.iter().enumerate() {
        steps.row_mut(*column).copy_from(&whitened.row(row));
    }
    let errors = SharedErrors::of(bundle, state, &steps, widened);
    // Priors say what they say; observations by themselves say more than their deviations do.
    let least = 1.0 / widened;
    let known = DMatrix::identity(lens, lens) - &errors.observed * (1.0 - least) + &errors.excess;
    let mut known = SymmetricEigen::new(known);
    known.eigenvalues.iter_mut().for_each(|value| *value = value.max(least));
    let matrix = &root * known.recompose() * root.transpose();
    let shared = (1.0 + errors.mean() * widened).max(1.0);
    Some(LensCovariance { matrix, independent, shared, widened })
}

/// All parameters but the one that fixes the scene's scale.
fn kept_parameters(bundle: &Bundle, state: &SceneState) -> Vec<usize> {
    let fixed = scale_parameter(bundle, state);
    let size = bundle.size(state.cameras_from_scene.len());
    (0..size).filter(|k| Some(*k) != fixed).collect()
}

/// The parameter that fixes the scene's scale: the longest coordinate of the translation of the
/// camera farthest from the first. `None` where there is no scale.
pub(super) fn scale_parameter(bundle: &Bundle, state: &SceneState) -> Option<usize> {
    let first = state.cameras_from_scene[0];
    let distance = |k: &usize| {
        let moved = state.cameras_from_scene[*k] * first.inverse();
        moved.translation().norm()
    };
    let farthest = (1..state.cameras_from_scene.len())
        .max_by(|a, b| distance(a).total_cmp(&distance(b)))
        .filter(|_| bundle.motion == CameraMotion::Moving);
    let camera = farthest?;
    let longest = state.cameras_from_scene[camera].translation().iamax();
    Some(bundle.pose_start(camera)? + 3 + longest)
}
