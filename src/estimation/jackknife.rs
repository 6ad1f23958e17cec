//! The covariance of a lens by a jackknife, where the scatter between views exceeds that of their
//! corners: repeated solves without some of the views (J. Tukey, *Bias and confidence in not quite
//! large samples*, 1958; over groups of views where there are many). The first-order influences of
//! views (`clustered_covariance`) keep the inliers fixed, as well as the variances of the board's
//! shape and of motion, where these are in the model. On photographs they change with the views,
//! and the lens with them.

use nalgebra::{DMatrix, DVector};

use crate::estimation::camera_estimate::CameraEstimate;
use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::effects::apply::with_effects_from;
use crate::estimation::effects::effects_fit::EffectsFit;
use crate::estimation::problem::{
    BoardView, CameraOptions, CameraProblem, CameraStart, LensChoice,
};
use crate::estimation::start::Prepared;

/// The largest number of solves. The standard deviation from this many is itself uncertain by an
/// eighth. With sixteen, those of 24 photographs depended on which views were left out together:
/// 0.55 to 0.79 px in cx.
const MAX_SOLVES: usize = 32;

/// Fewer solves determine no standard deviation.
const MIN_SOLVES: usize = 5;

/// The estimate, with the covariance of its lens from solves without some of the views where views
/// differ significantly. `problem` is what was solved, with the standard deviations in use.
pub(crate) fn with_jackknife(
    problem: &CameraProblem,
    options: &CameraOptions,
    estimate: CameraEstimate,
    fit: &CameraFit,
) -> CameraEstimate {
    if !(estimate.variance_inflation > 1.0) || fit.layout.sensors.len() > 1 {
        return estimate;
    }
    let weight = weight_of_views(fit).unwrap_or(0.0);
    let Some(by_solves) = jackknife(problem, options, &estimate, fit) else { return estimate };
    // Replaces only the part that comes from the scatter between views: where that is hardly
    // significant, the solves differ by chance.
    let mut lens_covariance = &estimate.lens_covariance * (1.0 - weight) + by_solves * weight;
    if let Some(between_models) = &fit.between_models {
        // All solves use the same model, so they do not show its uncertainty.
        lens_covariance += between_models * weight;
    }
    if let Some(step) = &fit.shutter_step {
        // Restores the shutter's part to 1 − weight, as in the estimate.
        lens_covariance += step * step.transpose() * (weight * (1.0 - weight));
    }
    CameraEstimate { lens_covariance, ..estimate }
}

fn weight_of_views(fit: &CameraFit) -> Option<f64> {
    if let Some(effects) = &fit.effects {
        return Some(effects.weight_of_views);
    }
    let at = &fit.layout.sensors[0];
    Some(FitCovariance::of(fit)?.block(at.lens_at..at.lens_at + at.lens.free.len()).weight)
}

/// The jackknife covariance of the lens's parameters (B. Efron, C. Stein, *The jackknife estimate
/// of variance*, 1981, with groups of views); `None` where too few solves succeed.
fn jackknife(
    problem: &CameraProblem,
    options: &CameraOptions,
    estimate: &CameraEstimate,
    fit: &CameraFit,
) -> Option<DMatrix<f64>> {
    let good: Vec<usize> =
        (0..problem.views.len()).filter(|view| estimate.views[*view].fault.is_none()).collect();
    scatter_without_views(good.len(), |is_kept| {
        let kept = good.iter().enumerate().filter(|(k, _)| is_kept(*k));
        let kept: Vec<usize> = kept.map(|(_, view)| *view).collect();
        lens_of(&kept, problem, options, estimate, fit.effects.as_ref())
    })
}

/// The jackknife covariance of what `solve` returns when it uses only the views, by index below
/// `views`, for which its argument is true; `None` where too few solves succeed.
pub(crate) fn scatter_without_views(
    views: usize,
    mut solve: impl FnMut(&dyn Fn(usize) -> bool) -> Option<DVector<f64>>,
) -> Option<DMatrix<f64>> {
    let groups = views.min(MAX_SOLVES);
    let without = |group: usize| solve(&|view| view % groups != group);
    let estimates: Vec<DVector<f64>> = (0..groups).filter_map(without).collect();
    if estimates.len() < MIN_SOLVES {
        return None;
    }
    let count = estimates.len() as f64;
    let mean = estimates.iter().sum::<DVector<f64>>() / count;
    let off = estimates.iter().map(|estimate| estimate - &mean);
    let sum: DMatrix<f64> = off.map(|off| &off * off.transpose()).sum();
    // A group without which no solve succeeds is assumed to have as much influence as the others.
    Some(sum * ((count - 1.0) / count * (groups as f64 / count)))
}

/// The lens from some of the views, starting from the effects that were `found` with all of them.
/// It shows how views change one minimum, not in which of several minima a search ends.
fn lens_of(
    kept: &[usize],
    problem: &CameraProblem,
    options: &CameraOptions,
    estimate: &CameraEstimate,
    found: Option<&EffectsFit>,
) -> Option<DVector<f64>> {
    let views: Vec<BoardView> = kept.iter().map(|view| problem.views[*view].clone()).collect();
    let pose = |view: &usize| estimate.views[*view].camera_from_board;
    let options = CameraOptions {
        lens: LensChoice::Model(estimate.lens.model()),
        start: Some(CameraStart {
            lens: estimate.lens,
            camera_from_board: kept.iter().map(pose).collect(),
            noise_floor_px: estimate.noise_floor_px,
        }),
        ..options.clone()
    };
    let problem = CameraProblem { image_size: problem.image_size, views };
    let mut prepared = Prepared::of(&problem);
    prepared.name_copies(&options);
    if let Some(board) = &options.measured_board {
        prepared.place_on(board).ok()?;
    }
    let fit = fit_camera(&mut prepared, estimate.lens.model(), &options).ok()?;
    let found = found.map(|found| found.of_views(kept));
    let fit = with_effects_from(fit, found.as_ref(), problem.image_size, &options);
    Some(DVector::from_vec(fit.lens().parameters().to_vec()))
}
