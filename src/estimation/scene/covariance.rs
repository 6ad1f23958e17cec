//! How well the images determine the lens: its covariance, everything else marginalized, with the
//! effect of errors that observations have in common.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::estimation::scene::bundle::{Bundle, CameraMotion, SceneState};
use crate::estimation::scene::clusters::SharedErrors;

/// The uncertainty of the lens.
#[derive(Debug, Clone, PartialEq)]
pub struct LensCovariance {
    /// The covariance of the free parameters, in their order, in squared pixels and so on. It
    /// includes common errors.
    pub matrix: DMatrix<f64>,
    /// The covariance if each observation has an independent error of its stated standard
    /// deviation.
    pub independent: DMatrix<f64>,
    /// Variance inflation by common errors: the mean factor over all directions, 1 or more.
    pub shared: f64,
    /// The part of `shared` that the observations' standard deviations already include.
    pub widened: f64,
}

/// The covariance of the lens at the minimum `state` of `bundle`, whose observations have standard
/// deviations √`widened` times their true ones; `None` where a parameter is not determined at all.
///
/// Observations have errors in common by image (motion blur, rolling shutter), by part of the scene
/// (moving objects, slanted surfaces, edges before a background, wrong matches) and by region of
/// the image (where the lens model does not fit).
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
    // The priors' part stays as it is. That of independent errors is smaller than stated, by
    // `widened`.
    let least = 1.0 / widened;
    let known = DMatrix::identity(lens, lens) - &errors.observed * (1.0 - least) + &errors.excess;
    let mut known = SymmetricEigen::new(known);
    known.eigenvalues.iter_mut().for_each(|value| *value = value.max(least));
    let matrix = &root * known.recompose() * root.transpose();
    let shared = (1.0 + errors.mean() * widened).max(1.0);
    Some(LensCovariance { matrix, independent, shared, widened })
}

/// All parameters except the one that fixes the scene's scale.
fn kept_parameters(bundle: &Bundle, state: &SceneState) -> Vec<usize> {
    let fixed = scale_parameter(bundle, state);
    let size = bundle.size(state.cameras_from_scene.len());
    (0..size).filter(|k| Some(*k) != fixed).collect()
}

/// The parameter that is held to fix the scene's scale: the largest coordinate of the translation
/// of the camera farthest from the first. `None` where there is no scale.
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
