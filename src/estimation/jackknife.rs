//! The covariance of a lens by a jackknife: repeated solves without some of the views (J. Tukey,
//! *Bias and confidence in not quite large samples*, 1958; over groups of views where there are
//! many). It replaces the stated covariance as far as the scatter between views exceeds that of
//! their corners.
//!
//! The first-order influences of views (`clustered_covariance`) keep the inliers fixed. With the
//! board's shape and motion in the model they also keep which effects there are and their variances.
//! On photographs these change with the views, and the lens with them: on 18 photographs whose
//! influences were as by chance, the solves without one of them scattered by 2.5 times the stated
//! standard deviation. So with effects the scatter of the solves is tested too.

use nalgebra::{DMatrix, DVector};

use crate::estimation::camera_estimate::CameraEstimate;
use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::effects::apply::with_effects_from;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::{BoardObservation, State};
use crate::estimation::problem::{
    BoardView, CameraOptions, CameraProblem, CameraStart, LensChoice,
};
use crate::estimation::robust::Loss;
use crate::estimation::robust_fit::RobustFit;
use crate::estimation::start::Prepared;
use crate::estimation::view_influence::LeftOutByChance;

/// The largest number of solves. The standard deviation from this many is itself uncertain by an
/// eighth. With sixteen, those of 24 photographs depended on which views were left out together:
/// 0.55 to 0.79 px in cx.
const MAX_SOLVES: usize = 32;

/// Fewer solves determine no standard deviation.
const MIN_SOLVES: usize = 5;

/// With effects in the model, solves without this many views decide whether a jackknife is needed:
/// the views that are expected to have the most influence. Not swept.
const FIRST_SOLVES: usize = 5;

/// The estimate, with the covariance of its lens from solves without some of the views where views
/// differ significantly. `problem` is what was solved, with the standard deviations in use.
pub(crate) fn with_jackknife(
    problem: &CameraProblem,
    options: &CameraOptions,
    estimate: CameraEstimate,
    fit: &CameraFit,
) -> CameraEstimate {
    if fit.layout.sensors.len() > 1 {
        return estimate;
    }
    let solves = Solves { problem, options, estimate: &estimate, fit };
    let scatter = if estimate.variance_inflation > 1.0 {
        solves.jackknife().map(|by_solves| (by_solves, first_order_weight(fit).unwrap_or(0.0)))
    } else {
        solves.beyond_chance()
    };
    let Some((by_solves, weight)) = scatter else { return estimate };
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

/// The weight of the scatter between views by their first-order influences.
fn first_order_weight(fit: &CameraFit) -> Option<f64> {
    if let Some(effects) = &fit.effects {
        return Some(effects.weight_of_views);
    }
    let at = &fit.layout.sensors[0];
    Some(FitCovariance::of(fit)?.block(at.lens_at..at.lens_at + at.lens.free.len()).weight)
}

/// Solves without some of the views.
#[derive(Clone, Copy)]
struct Solves<'a> {
    problem: &'a CameraProblem,
    options: &'a CameraOptions,
    estimate: &'a CameraEstimate,
    fit: &'a CameraFit,
}

impl Solves<'_> {
    fn good_views(self) -> Vec<usize> {
        let is_good = |view: &usize| self.estimate.views[*view].fault.is_none();
        (0..self.problem.views.len()).filter(is_good).collect()
    }

    /// The jackknife covariance of the lens's parameters (B. Efron, C. Stein, *The jackknife
    /// estimate of variance*, 1981, with groups of views); `None` where too few solves succeed.
    fn jackknife(self) -> Option<DMatrix<f64>> {
        let good = self.good_views();
        scatter_without_views(good.len(), |is_kept| {
            let kept = good.iter().enumerate().filter(|(k, _)| is_kept(*k));
            let kept: Vec<usize> = kept.map(|(_, view)| *view).collect();
            self.lens_of(&kept)
        })
    }

    /// The jackknife covariance and its weight, where effects are in the model and solves without
    /// one view scatter by more than chance. Single views may decide which effects there are, which
    /// first-order influences do not show. Of more than [`MAX_SOLVES`] views one hardly does.
    fn beyond_chance(self) -> Option<(DMatrix<f64>, f64)> {
        let effects = self.fit.effects.as_ref()?;
        let (good, by_chance) = (self.good_views(), &effects.left_out_by_chance);
        if !(MIN_SOLVES..=MAX_SOLVES).contains(&good.len()) || by_chance.len() != good.len() {
            return None;
        }
        let free = &self.fit.layout.sensors[0].lens.free;
        let known = effects.lens_covariance.clone().cholesky()?;
        let all = DVector::from_vec(self.fit.lens().parameters().to_vec());
        let prepared = prepared(self.problem, self.options)?;
        let moved = |position: &usize| {
            let kept = good.iter().filter(|view| **view != good[*position]);
            let kept: Vec<usize> = kept.copied().collect();
            let lens = self.continued(&prepared, &kept).or_else(|| self.lens_of(&kept))?;
            let moved = (lens - &all).select_rows(free);
            Some((by_chance[*position], moved.dot(&known.solve(&moved))))
        };
        let mut first: Vec<usize> = (0..good.len()).collect();
        first.sort_by(|a, b| by_chance[*b].square.total_cmp(&by_chance[*a].square));
        first.truncate(FIRST_SOLVES);
        let (expected, seen): (Vec<_>, Vec<f64>) = first.iter().filter_map(moved).unzip();
        if LeftOutByChance::weight(&expected, seen.iter().sum()) == 0.0 {
            return None;
        }
        let by_solves = self.jackknife()?;
        let of_free = by_solves.select_rows(free).select_columns(free);
        // The jackknife covariance is 1 − 1/n times the sum of squared changes.
        let count = good.len() as f64;
        let seen = known.solve(&of_free).trace() * count / (count - 1.0);
        let weight = LeftOutByChance::weight(by_chance, seen);
        (weight > 0.0).then_some((by_solves, weight))
    }

    /// The lens from some of the views, starting from the effects that were found with all of them.
    /// It shows how views change one minimum, not in which of several minima a search ends.
    fn lens_of(self, kept: &[usize]) -> Option<DVector<f64>> {
        let Self { problem, estimate, fit, .. } = self;
        let views: Vec<BoardView> = kept.iter().map(|view| problem.views[*view].clone()).collect();
        let pose = |view: &usize| estimate.views[*view].camera_from_board;
        let options = CameraOptions {
            lens: LensChoice::Model(estimate.lens.model()),
            start: Some(CameraStart {
                lens: estimate.lens,
                camera_from_board: kept.iter().map(pose).collect(),
                noise_floor_px: estimate.noise_floor_px,
            }),
            ..self.options.clone()
        };
        let problem = CameraProblem { image_size: problem.image_size, views };
        let mut prepared = prepared(&problem, &options)?;
        let plain = fit_camera(&mut prepared, estimate.lens.model(), &options).ok()?;
        let found = fit.effects.as_ref().map(|found| found.of_views(kept));
        let fit = with_effects_from(plain, found.as_ref(), problem.image_size, &options);
        Some(DVector::from_vec(fit.lens().parameters().to_vec()))
    }

    /// As [`Self::lens_of`], but starting from the lens and the poses with effects, which takes half
    /// the time. `None` where these views show no effect. It may stay in a minimum that a search
    /// would not find: on 13 photographs the standard deviations from such solves are an eighth to a
    /// quarter smaller.
    fn continued(self, prepared: &Prepared, kept: &[usize]) -> Option<DVector<f64>> {
        let found = self.fit.effects.as_ref()?.of_views(kept);
        let start = restricted(self.fit, prepared, kept)?;
        let fit = with_effects_from(start, Some(&found), self.problem.image_size, self.options);
        fit.effects.is_some().then(|| DVector::from_vec(fit.lens().parameters().to_vec()))
    }
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

fn prepared(problem: &CameraProblem, options: &CameraOptions) -> Option<Prepared> {
    let mut prepared = Prepared::of(problem);
    prepared.name_copies(options);
    if let Some(board) = &options.measured_board {
        prepared.place_on(board).ok()?;
    }
    Some(prepared)
}

/// `fit`, restricted to some of its views, with the board as it was stated. It is no minimum: the
/// effects that belong to it are not in it.
fn restricted(fit: &CameraFit, all: &Prepared, kept: &[usize]) -> Option<CameraFit> {
    let observation = |(k, view): (usize, &usize)| BoardObservation {
        frame_set: k,
        used: fit.observations[*view].used.clone(),
        ..all.observations[*view].clone()
    };
    let observations: Vec<BoardObservation> = kept.iter().enumerate().map(observation).collect();
    let of_all = &fit.robust.minimum.state;
    let pose = |view: &usize| of_all.rig_from_board[fit.observations[*view].frame_set];
    let state = State { rig_from_board: kept.iter().map(pose).collect(), ..of_all.clone() };
    let minimum = Minimum::start(&fit.layout, state, &observations, Loss::Squares)?;
    let robust = RobustFit { minimum, limit: fit.robust.limit };
    Some(CameraFit::new(fit.layout.clone(), robust, observations, vec![None; kept.len()]))
}
