//! Fits of several lens models to the same views, each started again from the results of others.
//!
//! With the shape of an uneven board in the model, the cost has more than one minimum. A plain fit
//! of a large model to a board that is assumed flat ends far from the true lens, and the search for
//! the board's shape then starts from there. On photographs of a board bent by 2.5 mm the rational
//! model ended with five times the residual variance of brown, which it contains.

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::apply::{with_effects_from, with_same_effects};
use crate::estimation::joint::free_lens::Given;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::{BoardObservation, State};
use crate::estimation::lens_choice::nearest_lens::nearest_lens;
use crate::estimation::problem::CameraOptions;
use crate::estimation::robust::Loss;
use crate::estimation::robust_fit::RobustFit;
use crate::geometry::pixel::ImageSize;

/// Starts each of the fits `with` effects again from the closest fit, and from those of models that
/// it contains, where their residuals are smaller than its own. `plain` are the fits without
/// effects, of the same models.
pub(crate) fn start_from_each_other(
    plain: &[CameraFit],
    with: &mut [CameraFit],
    size: ImageSize,
    options: &CameraOptions,
) {
    let closest = closest_of(with);
    for fit in 0..with.len() {
        for other in (0..with.len()).filter(|other| *other != fit) {
            let is_held = with[fit].lens().model().holds(with[other].lens().model());
            let is_closer = residual_variance(&with[other]) < residual_variance(&with[fit]);
            if !is_closer || !(is_held || other == closest) {
                continue;
            }
            let from = (&plain[other], &with[other]);
            if let Some(again) = started_from(&with[fit], from, size, options) {
                with[fit] = again;
            }
        }
    }
}

/// The index of the closest among fits of the same views: that with the least sum of squares,
/// truncated for all of them at the smallest inlier limit among them (the MSAC cost of P. H. S.
/// Torr, A. Zisserman, *MLESAC*, 2000). By the scale of its own inliers alone, a lens that is too
/// simple would appear closest once it has rejected the views that show its misfit.
pub(crate) fn closest_of(fits: &[CameraFit]) -> usize {
    let limit = fits.iter().map(|fit| fit.robust.limit).fold(f64::INFINITY, f64::min);
    let cost = |fit| squares_of_views(fit, limit * limit).into_iter().sum();
    let costs: Vec<f64> = fits.iter().map(cost).collect();
    (0..fits.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or_default()
}

/// Per view, the sum of the squared residuals of all corners, each truncated at `most`; corners
/// that the fit does not use count as outliers.
pub(crate) fn squares_of_views(fit: &CameraFit, most: f64) -> Vec<f64> {
    let views = fit.observations.iter().zip(&fit.robust.minimum.equations.residuals);
    let of_view = |(observation, residuals): (&BoardObservation, &Vec<[f64; 2]>)| -> f64 {
        let used = observation.used.iter().zip(residuals).filter(|(used, _)| **used);
        let squares = used.map(|(_, [x, y])| (x * x + y * y).min(most));
        let outliers = observation.used.iter().filter(|used| !**used).count();
        squares.sum::<f64>() + outliers as f64 * most
    };
    views.map(of_view).collect()
}

/// The observations of a fit, with the inliers of another fit of the same views.
pub(crate) fn with_corners_of(fit: &CameraFit, other: &CameraFit) -> Vec<BoardObservation> {
    let pairs = fit.observations.iter().zip(&other.observations);
    pairs.map(|(own, other)| BoardObservation { used: other.used.clone(), ..own.clone() }).collect()
}

/// The variance of the residuals, as a factor on the corners' own variances.
fn residual_variance(fit: &CameraFit) -> f64 {
    fit.effects.as_ref().map_or_else(|| fit.noise_square(), |effects| effects.noise_square)
}

/// A fit of the same model, started from the result of another; `None` where it does not fit more
/// closely to as many views.
fn started_from(
    fit: &CameraFit,
    from: (&CameraFit, &CameraFit),
    size: ImageSize,
    options: &CameraOptions,
) -> Option<CameraFit> {
    let start = start_at(fit, from)?;
    let again = with_effects_from(start, from.1.effects.as_ref(), size, options);
    let is_better = residual_variance(&again) < residual_variance(fit)
        && again.good_views().len() >= fit.good_views().len();
    is_better.then_some(again)
}

/// The plain fit of the model of `fit` at the result of another model, given `plain` and `with`
/// effects.
fn start_at(fit: &CameraFit, (plain, with): (&CameraFit, &CameraFit)) -> Option<CameraFit> {
    let free = &fit.layout.sensors[0].lens;
    let held = Given::held(free, fit.lens());
    let lens = nearest_lens(with.lens(), free, &held, &with.some_points_in_camera())?;
    let state = State { lenses: vec![lens], ..with.robust.minimum.state.clone() };
    let observations = with_corners_of(plain, with);
    let minimum = Minimum::start(&fit.layout, state, &observations, Loss::Squares)?;
    let robust = RobustFit { minimum, limit: with.robust.limit };
    Some(CameraFit::new(fit.layout.clone(), robust, observations, with.faults.clone()))
}

/// Fits of all models with the same effects as the closest fit: on the same corners, but each with
/// its own shape of the board and its own motion. Without common effects, a fit with more motion
/// would have smaller held-out errors, because each view's motion is fitted to the view itself.
/// Where there is no such fit, the one `with` its own effects.
pub(crate) fn with_common_effects(
    plain: &[CameraFit],
    with: &[CameraFit],
    size: ImageSize,
) -> Vec<CameraFit> {
    let closest = closest_of(with);
    let from = (&plain[closest], &with[closest]);
    let common = |(k, own): (usize, &CameraFit)| {
        if k == closest {
            return own.clone();
        }
        let start = start_at(own, from);
        let same = start.and_then(|start| match &from.1.effects {
            Some(found) => with_same_effects(&start, found, size),
            None => Some(plain[k].clone()),
        });
        same.unwrap_or_else(|| own.clone())
    };
    with.iter().enumerate().map(common).collect()
}
