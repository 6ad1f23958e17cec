//! Chooses the lens model: the smallest that no larger one beats on held-out views
//! (`lens_trial`). What else compares lenses is here too: whether the model is too simple
//! (`lens_misfit`), and whether another lens of it fits as closely (`other_minimum`).

pub mod lens_misfit;
mod lens_score;
mod lens_trial;
pub(crate) mod model_averaging;
mod nearest_lens;
pub mod other_minimum;
mod starts_from_other_lenses;
pub(crate) mod without_pole;

use nalgebra::DMatrix;

use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::effects::apply::{may_have_effects, with_effects};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::BoardObservation;
use crate::estimation::lens_choice::lens_trial::Trial;
use crate::estimation::lens_choice::model_averaging::{ComparedModel, between_models};
use crate::estimation::lens_choice::starts_from_other_lenses::{
    closest_of, start_from_each_other, with_common_effects, with_corners_of,
};
use crate::estimation::lens_choice::without_pole::FitWithEffects;
use crate::estimation::lens_pole::{has_pole, has_smaller_denominator, with_smaller_denominators};
use crate::estimation::problem::CameraOptions;
use crate::estimation::start::Prepared;
use crate::estimation::uncertainty::PixelGrid;
use crate::geometry::lens::LensModel;
use crate::geometry::pixel::ImageSize;

/// The held-out error of one lens model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensTrial {
    /// The model.
    pub model: LensModel,
    /// Root mean square error on held-out views, in pixels, with a pose estimated for each.
    pub held_out_rms_px: f64,
    /// Number of estimated parameters.
    pub parameters: usize,
}

/// The held-out error, relative to that of the best model, above which a model is excluded before
/// the board's shape and motion are fitted: a larger lens absorbs a part of them at most. In 288
/// simulated worlds the true model's error was up to 1.5 times that of the best.
const MOST_ERROR_RATIO: f64 = 3.0;

/// Images are compared on this many columns of pixels.
pub(crate) const COLUMNS: u32 = 12;

/// The largest number of views in the comparison; more do not separate the models further.
const MAX_VIEWS: usize = 100;

/// The fit of the chosen model.
pub(crate) struct ChosenLens {
    pub(crate) fit: FitWithEffects,
    pub(crate) compared: Vec<LensTrial>,
}

/// Fits every model and chooses one. Where the views show more than lens and poses, each model is
/// compared with the board's shape and the motion that it finds. Otherwise a larger lens would be
/// better merely because it absorbs them (of 96 simulated worlds with an uneven board 50 were given
/// another lens than the true one, and errors of up to 4,000 times).
pub(crate) fn choose_lens(
    prepared: &mut Prepared,
    options: &CameraOptions,
) -> Result<ChosenLens, EstimationError> {
    let mut fits = sound_fits(prepared, options)?;
    let size = prepared.image_size;
    let plain = Choice::among(&fits, &fits, size);
    let may_have_effects = |fit: &usize| may_have_effects(&fits[*fit], size, options);
    if plain.trials.is_empty() || ![plain.chosen, plain.closest].iter().any(may_have_effects) {
        let chosen = fits.swap_remove(plain.chosen);
        let mut fit = FitWithEffects::of(chosen, prepared, options);
        fit.full.between_models = plain.between_models;
        return Ok(ChosenLens { fit, compared: plain.trials });
    }
    let errors = plain.trials.iter().map(|trial| trial.held_out_rms_px);
    let limit_px = MOST_ERROR_RATIO * errors.fold(f64::INFINITY, f64::min);
    let (hopeless, able): (Vec<LensTrial>, Vec<LensTrial>) =
        plain.trials.iter().partition(|trial| trial.held_out_rms_px > limit_px);
    fits.retain(|fit| able.iter().any(|trial| trial.model == fit.lens().model()));
    let mut with: Vec<CameraFit> =
        fits.iter().map(|fit| with_effects(fit.clone(), size, options)).collect();
    start_from_each_other(&fits, &mut with, size, options);
    let mut common = with_common_effects(&fits, &with, size);
    // The test is repeated: with the board's shape in the model, coefficients may cancel that did
    // not before.
    let is_sound: Vec<bool> = with
        .iter()
        .zip(&common)
        .map(|(own, common)| ![own, common].iter().any(|fit| has_pole(fit.lens(), size)))
        .collect();
    if is_sound.contains(&true) {
        for fits in [&mut fits, &mut with, &mut common] {
            let mut is_sound = is_sound.iter();
            fits.retain(|_| is_sound.next() == Some(&true));
        }
    }
    let Choice { chosen, between_models, trials, .. } = Choice::among(&common, &with, size);
    let compared = hopeless.into_iter().chain(trials).collect();
    let full = CameraFit { between_models, ..with.swap_remove(chosen) };
    let plain = fits.swap_remove(chosen);
    Ok(ChosenLens { fit: FitWithEffects { plain, full }, compared })
}

/// The fits of all models that have one, of a rational lens also with one coefficient in the
/// denominator; only those without a pole in the image, if there are any.
fn sound_fits(
    prepared: &mut Prepared,
    options: &CameraOptions,
) -> Result<Vec<CameraFit>, EstimationError> {
    let mut fits = Vec::new();
    let mut refusal = None;
    for model in LensModel::compared() {
        match fit_camera(prepared, model, options) {
            Ok(fit) => {
                let smaller = with_smaller_denominators(model, options);
                let smaller = smaller.first().filter(|_| !has_smaller_denominator(fit.lens()));
                fits.extend(smaller.and_then(|options| fit_camera(prepared, model, options).ok()));
                fits.push(fit);
            }
            Err(error) => refusal = Some(error),
        }
    }
    let is_sound = |fit: &CameraFit| !has_pole(fit.lens(), prepared.image_size);
    if fits.iter().any(is_sound) {
        fits.retain(is_sound);
    }
    if fits.is_empty() { Err(refusal.unwrap_or(EstimationError::NoFit)) } else { Ok(fits) }
}

/// The choice among fits of the same views.
struct Choice {
    chosen: usize,
    /// The covariance that the other models add to the chosen one's lens.
    between_models: Option<DMatrix<f64>>,
    /// The fit with the least residuals; it separates outliers best.
    closest: usize,
    trials: Vec<LensTrial>,
}

impl Choice {
    /// Compares models by their `fits`; the covariance between models is that of the `reported`
    /// fits.
    fn among(fits: &[CameraFit], reported: &[CameraFit], size: ImageSize) -> Self {
        let closest = closest_of(fits);
        let views = compared_views(&fits[closest]);
        let grid = PixelGrid::over(size, COLUMNS);
        let observations: Vec<Vec<BoardObservation>> =
            fits.iter().map(|fit| with_corners_of(fit, &fits[closest])).collect();
        let compared = |k: usize| {
            let trial = Trial::of(&fits[k], &observations[k], &views, grid)?;
            Some((k, ComparedModel { trial, reported: &reported[k] }))
        };
        let mut tried: Vec<(usize, ComparedModel<'_>)> =
            (0..fits.len()).filter_map(compared).collect();
        tried.sort_by_key(|(_, it)| it.trial.fit.lens().model().facts().auto_order);
        let (indices, models): (Vec<usize>, Vec<ComparedModel<'_>>) = tried.into_iter().unzip();
        // Each is compared with the best so far, since one that loses to it may still be better
        // than the smallest.
        let mut best = 0;
        for larger in 1..models.len() {
            if models[larger].trial.is_worth_more(&models[best].trial) {
                best = larger;
            }
        }
        let chosen = indices.get(best).map_or(closest, |k| *k);
        let between_models = (!models.is_empty()).then(|| between_models(&models, best));
        let summary = |(k, ComparedModel { trial, .. }): (&usize, &ComparedModel<'_>)| LensTrial {
            model: trial.fit.lens().model(),
            held_out_rms_px: trial.rms_px(&observations[*k]),
            parameters: trial.fit.layout.sensors[0].lens.free.len(),
        };
        // A single view cannot be held out: its errors would be those of the fit.
        let shown = if views.len() < 2 { 0 } else { models.len() };
        Self {
            chosen,
            between_models: between_models.flatten(),
            closest,
            trials: indices.iter().zip(&models).take(shown).map(summary).collect(),
        }
    }
}

/// The used views of a fit, or an evenly spaced sample of many.
pub(crate) fn compared_views(fit: &CameraFit) -> Vec<usize> {
    let views = fit.good_views();
    views.iter().step_by(views.len().div_ceil(MAX_VIEWS).max(1)).copied().collect()
}
