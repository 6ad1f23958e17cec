//! Whether a lens model is too simple for the lens. Its own residuals hardly show this, because the
//! board's shape, the poses and the focal length absorb the error. An automatically chosen model is
//! tested too: the choice takes a larger one only if it is better beyond chance.

use crate::estimation::camera_estimate::CameraEstimate;
use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::effects::apply::with_effects;
use crate::estimation::joint::BoardObservation;
use crate::estimation::lens_choice::lens_score::could_fit_better;
use crate::estimation::lens_choice::lens_trial::{Trial, may_be_worth_more};
use crate::estimation::lens_choice::starts_from_other_lenses::{closest_of, with_common_effects};
use crate::estimation::lens_choice::{COLUMNS, compared_views};
use crate::estimation::lens_pole::has_pole;
use crate::estimation::problem::{CameraOptions, CameraProblem};
use crate::estimation::start::Prepared;
use crate::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use crate::geometry::lens::{Lens, LensModel};

/// A larger lens model that predicts views better than the requested or chosen one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensMisfit {
    /// The larger model.
    pub model: LensModel,
    /// The error on held-out views of the model in use and of the larger one, in pixels; `None`
    /// where a model cannot predict them.
    pub held_out_rms_px: [Option<f64>; 2],
    /// The focal length under the larger model, in pixels.
    pub fx: f64,
    /// The factor on the standard deviations of the lens in use if its difference from the larger
    /// one counts as an error.
    pub widening: f64,
}

impl LensMisfit {
    /// Compares the lens model of `estimate`, requested or chosen, with the larger ones that an
    /// automatic choice compares; `None` where none of them predicts views better
    /// ([`crate::estimation::lens_choice`]).
    pub(crate) fn of(
        problem: &CameraProblem,
        options: &CameraOptions,
        estimate: &CameraEstimate,
        fit: &CameraFit,
    ) -> Option<Self> {
        let stated = estimate.lens.model();
        let order = stated.facts().auto_order?;
        let mut prepared = Prepared::of(problem);
        prepared.name_copies(options);
        if let Some(board) = &options.measured_board {
            prepared.place_on(board).ok()?;
        }
        let is_larger = |model: &LensModel| model.facts().auto_order > Some(order);
        let mut models = LensModel::compared().filter(is_larger);
        let stated_board = (fit, prepared.observations.as_slice());
        // A given coefficient is one of the requested model, not of a larger one.
        let of_larger = options.clone().without_given_coefficients(stated);
        if !models.any(|model| could_fit_better(model, stated_board, (problem, &of_larger))) {
            return None;
        }
        // Both at their minima: with fits that ended at 0.03 standard deviations no larger model
        // was preferred on nearly equal views, where brown's focal length was off by four of its
        // own.
        let own = fit_camera(&mut prepared, stated, options).ok()?;
        let fitted = |model| fit_camera(&mut prepared, model, &of_larger).ok();
        let mut larger: Vec<CameraFit> =
            LensModel::compared().filter(is_larger).filter_map(fitted).collect();
        larger.retain(|fit| !has_pole(fit.lens(), problem.image_size));
        // As in an automatic choice, the outliers are those of the model that fits most closely.
        let closest = larger.get(closest_of(&larger))?;
        let observations = &closest.observations;
        let mut views = compared_views(closest);
        // A model that does not fit may have rejected views for that reason.
        views.retain(|view| own.faults[*view].is_none());
        let grid = PixelGrid::over(problem.image_size, COLUMNS);
        let trial = |fit| Trial::of(fit, observations, &views, grid);
        // A model may be so wrong that it cannot predict some view at all.
        let of_own = trial(&own);
        let held_out_px = |trial: &Trial<'_>| trial.rms_px(observations);
        let may_be =
            |larger: &&CameraFit| of_own.is_none() || may_be_worth_more(larger, own.lens(), grid);
        let trials = larger.iter().filter(may_be).filter_map(trial);
        let better = trials
            .filter(|larger| of_own.as_ref().is_none_or(|own| larger.predicts_better_than(own)));
        let best = better.min_by(|a, b| held_out_px(a).total_cmp(&held_out_px(b)))?;
        let plain_px = [of_own.as_ref().map(held_out_px), Some(held_out_px(&best))];
        let full = with_effects(best.fit.clone(), problem.image_size, &of_larger);
        let held_out_rms_px = if fit.effects.is_some() || full.effects.is_some() {
            let plain = [own.clone(), best.fit.clone()];
            let with = [fit.clone(), full.clone()];
            let common = with_common_effects(&plain, &with, problem.image_size);
            let [own, larger] = common.as_slice() else { return None };
            beyond_effects(own, larger, views, grid)?
        } else {
            plain_px
        };
        let (model, fx) = (full.lens().model(), full.lens().matrix.fx);
        let widening = widening(estimate, full.lens(), grid)?;
        Some(Self { model, held_out_rms_px, fx, widening })
    }
}

/// The held-out errors of a lens and of a larger one, in pixels, both fitted with the same effects
/// of the board's shape and motion: otherwise a larger lens may be better only because it absorbs
/// them. `None` where the larger one is then no better.
fn beyond_effects(
    own: &CameraFit,
    larger: &CameraFit,
    mut views: Vec<usize>,
    grid: PixelGrid,
) -> Option<[Option<f64>; 2]> {
    let [of_own, of_larger] = common_corners(own, larger);
    views.retain(|view| of_own[*view].used.contains(&true));
    let own = Trial::of(own, &of_own, &views, grid)?;
    let larger = Trial::of(larger, &of_larger, &views, grid)?;
    let held_out_px = [own.rms_px(&of_own), larger.rms_px(&of_larger)];
    larger.predicts_better_than(&own).then_some(held_out_px.map(Some))
}

/// The observations of two fits of the same views, with the corners that both of them use.
fn common_corners(a: &CameraFit, b: &CameraFit) -> [Vec<BoardObservation>; 2] {
    let [mut of_a, mut of_b] = [a, b].map(|fit| fit.observations.clone());
    for (a, b) in of_a.iter_mut().zip(&mut of_b) {
        for (a, b) in a.used.iter_mut().zip(&mut b.used) {
            (*a, *b) = (*a && *b, *a && *b);
        }
    }
    [of_a, of_b]
}

/// The factor on the standard deviations of `estimate` if the mean squared difference of its
/// projections from those of `other`, in units of their variance, counts as one more variance. 1
/// for a lens of which all parameters are given.
fn widening(estimate: &CameraEstimate, other: &Lens, grid: PixelGrid) -> Option<f64> {
    let known = projection_uncertainty(
        &estimate.lens,
        &estimate.lens_covariance,
        grid,
        Distance::Infinity,
    )?;
    let moved = projection_difference(&estimate.lens, other, grid, &known.weights);
    let ratios: Vec<f64> = moved
        .iter()
        .zip(&known.square_px2)
        .filter_map(|(moved, square_px2)| {
            let [x, y] = (*moved)?;
            Some((x * x + y * y) / square_px2.filter(|square| *square > 0.0)?)
        })
        .collect();
    Some((1.0 + ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).sqrt())
}
