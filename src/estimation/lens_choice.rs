//! Chooses the lens model: the smallest that no larger one beats on held-out views.
//!
//! A larger model beats it if its held-out error is smaller and if it moves projections somewhere
//! in the image by more than its own uncertainty there. The second condition is needed because a
//! smaller error on a few views is chance one time in six, and because held-out views say nothing
//! of image corners that no view reached, where badly determined parameters do most harm. Of models
//! of which neither holds the other, projections differ beyond the views in any case: the larger
//! must be better beyond chance.

use nalgebra::DMatrix;

use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::effects::apply::{may_have_effects, with_effects};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::linearize::LocalEquations;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::per_observation::{assemble, linearize_each};
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State};
use crate::estimation::lens_pole::has_pole;
use crate::estimation::problem::CameraOptions;
use crate::estimation::robust::Loss;
use crate::estimation::start::Prepared;
use crate::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;

/// The held-out error of one lens model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensTrial {
    /// The model.
    pub model: LensModel,
    /// Root mean square error on views that were not fitted to, in pixels, once each of those views
    /// has its own pose.
    pub held_out_rms_px: f64,
    /// How many parameters were estimated.
    pub parameters: usize,
}

/// The views are dealt into at most this many parts, each held out once.
const FOLDS: usize = 10;

/// How much smaller the error on held-out views must be, in standard errors
/// ([`gain_in_standard_errors`]).
const HELD_OUT: f64 = 1.0;

/// How far projections must move somewhere in the image, in the larger model's standard
/// deviations there.
const MOVED: f64 = 2.5;

/// As [`HELD_OUT`], of two models of which neither holds the other: their projections always differ
/// beyond the views, so that only held-out views decide. Chosen for one chance in forty and not
/// swept: with it 271 of 288 simulated worlds that were run once were given the true model.
const BETTER_BEYOND_CHANCE: f64 = 2.0;

/// A model whose error on held-out views is this many times that of the best, each with lens and
/// poses alone, is not the lens's, whatever the board's shape and motion are: a larger lens takes
/// up a part of them at most. In 288 simulated worlds the true model's error was up to 1.5 times
/// that of the best: this is twice as much.
const HOPELESS: f64 = 3.0;

/// Projections that move this far decide even where views are too few for [`HELD_OUT`] to say more
/// than which is better.
const MOVED_FAR: f64 = 4.0;

/// The image is compared on this many columns of pixels.
pub(crate) const COLUMNS: u32 = 12;

/// A step's cost is as it was predicted within this part: the problem is linear there, and the step
/// its minimum.
const AS_PREDICTED: f64 = 0.01;

/// A fit of some views is good enough for a comparison, or for halves, at 0.03 standard deviations
/// from its minimum.
const COMPARED: Stop = Stop { max_steps: 50, decrease: 1e-3, part: 0.0, lambda: 0.0 };

/// Views used in the comparison at most; more do not separate the models further.
const MAX_VIEWS: usize = 100;

/// The fit of the chosen model.
pub(crate) struct ChosenLens {
    /// Lens and poses alone.
    pub(crate) plain: CameraFit,
    /// With what the views show of the board's shape and motion.
    pub(crate) full: CameraFit,
    pub(crate) compared: Vec<LensTrial>,
}

/// Fits every model and chooses one. Where the views show more than lens and poses, models are
/// compared each with the board's shape and the motion that it finds: without, a larger lens is
/// better because it takes them up (of 96 simulated worlds with an uneven board 50 were given
/// another lens than the true one, and errors of up to 4,000 times).
pub(crate) fn choose_lens(
    prepared: &mut Prepared,
    options: &CameraOptions,
) -> Result<ChosenLens, EstimationError> {
    let mut fits = sound_fits(prepared, options)?;
    let size = prepared.image_size;
    let full_of = |fit: &CameraFit| with_effects(fit.clone(), size, options);
    let plain = Choice::among(&fits, size);
    let may_have_effects = |fit: &usize| may_have_effects(&fits[*fit], size, options);
    if plain.trials.is_empty() || ![plain.chosen, plain.closest].iter().any(may_have_effects) {
        let chosen = fits.swap_remove(plain.chosen);
        return Ok(ChosenLens { full: full_of(&chosen), plain: chosen, compared: plain.trials });
    }
    let errors = plain.trials.iter().map(|trial| trial.held_out_rms_px);
    let limit_px = HOPELESS * errors.fold(f64::INFINITY, f64::min);
    let (hopeless, able): (Vec<LensTrial>, Vec<LensTrial>) =
        plain.trials.iter().partition(|trial| trial.held_out_rms_px > limit_px);
    fits.retain(|fit| able.iter().any(|trial| trial.model == fit.lens().model()));
    let mut with: Vec<CameraFit> = fits.iter().map(full_of).collect();
    let Choice { chosen, trials, .. } = Choice::among(&with, size);
    let compared = hopeless.into_iter().chain(trials).collect();
    let (plain, full) = (fits.swap_remove(chosen), with.swap_remove(chosen));
    Ok(ChosenLens { plain, full, compared })
}

/// The fits of all models that have one; those without a pole in the image, where there are any.
fn sound_fits(
    prepared: &mut Prepared,
    options: &CameraOptions,
) -> Result<Vec<CameraFit>, EstimationError> {
    let mut fits = Vec::new();
    let mut refusal = None;
    for model in LensModel::compared() {
        match fit_camera(prepared, model, options) {
            Ok(fit) => fits.push(fit),
            Err(error) => refusal = Some(error),
        }
    }
    let is_sound = |fit: &CameraFit| !has_pole(fit.lens(), prepared.image_size);
    if fits.iter().any(is_sound) {
        fits.retain(is_sound);
    }
    if fits.is_empty() { Err(refusal.unwrap_or(EstimationError::NoFit)) } else { Ok(fits) }
}

/// Which of some fits of the same views is chosen.
struct Choice {
    chosen: usize,
    /// The one that fits most closely; it separates outliers best.
    closest: usize,
    trials: Vec<LensTrial>,
}

impl Choice {
    fn among(fits: &[CameraFit], size: ImageSize) -> Self {
        let limit = |fit: &usize| fits[*fit].robust.limit;
        let closest =
            (0..fits.len()).min_by(|a, b| limit(a).total_cmp(&limit(b))).unwrap_or_default();
        let views = compared_views(&fits[closest]);
        let grid = PixelGrid::over(size, COLUMNS);
        let observations: Vec<Vec<BoardObservation>> =
            fits.iter().map(|fit| with_corners_of(fit, &fits[closest])).collect();
        let mut trials: Vec<(usize, Trial<'_>)> = (0..fits.len())
            .filter_map(|k| {
                let is_good = |view: &usize| fits[k].faults[*view].is_none();
                let views: Vec<usize> = views.iter().copied().filter(is_good).collect();
                Some((k, Trial::of(&fits[k], &observations[k], &views, grid)?))
            })
            .collect();
        trials.sort_by_key(|(_, trial)| trial.fit.lens().model().facts().auto_place);
        let is_enough = |k: &usize| {
            !trials[k + 1..].iter().any(|(_, larger)| larger.is_worth_more(&trials[*k].1))
        };
        let chosen = (0..trials.len()).find(is_enough).map_or(closest, |k| trials[k].0);
        let summary = |(k, trial): &(usize, Trial<'_>)| LensTrial {
            model: trial.fit.lens().model(),
            held_out_rms_px: trial.rms_px(&observations[*k]),
            parameters: trial.fit.layout.sensors[0].lens.free.len(),
        };
        Self { chosen, closest, trials: trials.iter().map(summary).collect() }
    }
}

/// The observations of a fit, with the corners that another one of the same views uses.
fn with_corners_of(fit: &CameraFit, other: &CameraFit) -> Vec<BoardObservation> {
    let pairs = fit.observations.iter().zip(&other.observations);
    pairs.map(|(own, other)| BoardObservation { used: other.used.clone(), ..own.clone() }).collect()
}

/// The used views of a fit, or enough of them, evenly.
pub(crate) fn compared_views(fit: &CameraFit) -> Vec<usize> {
    let views = fit.good_views();
    views.iter().step_by(views.len().div_ceil(MAX_VIEWS).max(1)).copied().collect()
}

/// A model's fit with its errors on held-out views.
pub(crate) struct Trial<'a> {
    pub(crate) fit: &'a CameraFit,
    views: Vec<usize>,
    /// The sum of squared pixel errors of each of `views`.
    squares: Vec<f64>,
    /// Of the lens parameters; `None` where they are not determined.
    covariance: Option<DMatrix<f64>>,
    grid: PixelGrid,
}

impl<'a> Trial<'a> {
    /// Of the corners that `chosen` uses in `views`.
    pub(crate) fn of(
        fit: &'a CameraFit,
        chosen: &[BoardObservation],
        views: &[usize],
        grid: PixelGrid,
    ) -> Option<Self> {
        let squares = held_out_squares(fit, chosen, views, FOLDS)?;
        Some(Self { fit, views: views.to_vec(), squares, covariance: fit.lens_covariance(), grid })
    }

    /// The root mean square of its errors, in pixels.
    pub(crate) fn rms_px(&self, chosen: &[BoardObservation]) -> f64 {
        let used = |view: &usize| chosen[*view].used.iter().filter(|used| **used).count();
        let corners: usize = self.views.iter().map(used).sum();
        (self.squares.iter().sum::<f64>() / corners.max(1) as f64).sqrt()
    }

    /// Whether it is to be preferred to `smaller`, which is preferred where they do not differ.
    pub(crate) fn is_worth_more(&self, smaller: &Self) -> bool {
        let nested = self.fit.lens().model().holds(smaller.fit.lens().model());
        self.predicts_better_than(smaller)
            && (nested || self.gain_over(smaller) > BETTER_BEYOND_CHANCE)
    }

    /// Whether it is likely to be nearer to the lens than `smaller` is.
    pub(crate) fn predicts_better_than(&self, smaller: &Self) -> bool {
        let gain = self.gain_over(smaller);
        let moved = || self.moves_projections_of(smaller.fit.lens()).unwrap_or(0.0);
        gain > 0.0 && moved() > if gain > HELD_OUT { MOVED } else { MOVED_FAR }
    }

    fn gain_over(&self, smaller: &Self) -> f64 {
        gain_in_standard_errors(&self.squares_beside(smaller))
    }

    /// The squares of a smaller model and of this one in each view that both were fitted to.
    fn squares_beside(&self, smaller: &Self) -> Vec<[f64; 2]> {
        let of_smaller = |view: &usize| {
            let at = smaller.views.iter().position(|other| other == view)?;
            Some(smaller.squares[at])
        };
        let pairs = self.views.iter().zip(&self.squares);
        pairs.filter_map(|(view, own)| Some([of_smaller(view)?, *own])).collect()
    }

    fn moves_projections_of(&self, other: &Lens) -> Option<f64> {
        moves_projections((self.fit.lens(), self.covariance.as_ref()?), other, self.grid)
    }
}

/// Whether a fit moves the projections of a smaller model's lens far enough to be worth more, if
/// held-out views agree: without, they need not be asked.
pub(crate) fn may_be_worth_more(fit: &CameraFit, smaller: &Lens, grid: PixelGrid) -> bool {
    let moved = fit
        .lens_covariance()
        .and_then(|covariance| moves_projections((fit.lens(), &covariance), smaller, grid));
    moved.is_some_and(|moved| moved > MOVED)
}

/// How far the projections of a lens are from those of `other` at most, in its own standard
/// deviations at that pixel.
fn moves_projections(
    (lens, covariance): (&Lens, &DMatrix<f64>),
    other: &Lens,
    grid: PixelGrid,
) -> Option<f64> {
    let own = projection_uncertainty(lens, covariance, grid, Distance::Infinity)?;
    let moved = projection_difference(lens, other, grid, &own.weights);
    let seen = moved.iter().zip(&own.square_px2).filter_map(|(moved, own)| Some((*moved, (*own)?)));
    // Where the other lens sees nothing, it differs by more than any number.
    let in_stds = |(moved, own): (Option<[f64; 2]>, f64)| {
        moved.map_or(f64::INFINITY, |[x, y]| f64::sqrt((x * x + y * y) / own))
    };
    Some(seen.map(in_stds).fold(0.0, f64::max))
}

/// The mean per view of the logarithm of how many times smaller the errors of `larger_model` are
/// than those of `smaller_model`, in standard errors of that mean: each view is weighed by its own
/// noise, so that those with large errors do not decide alone.
fn gain_in_standard_errors(squares: &[[f64; 2]]) -> f64 {
    let n = squares.len() as f64;
    let logarithm = |square: f64| square.max(f64::MIN_POSITIVE).ln();
    let gains: Vec<f64> =
        squares.iter().map(|[smaller, larger]| logarithm(*smaller) - logarithm(*larger)).collect();
    let mean = gains.iter().sum::<f64>() / n;
    let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    mean / (variance / n).sqrt().max(f64::MIN_POSITIVE)
}

/// Per view, the sum of squared pixel errors under a lens fitted without it. `None` where a part
/// cannot be fitted.
pub(crate) fn held_out_squares(
    fit: &CameraFit,
    chosen: &[BoardObservation],
    views: &[usize],
    folds: usize,
) -> Option<Vec<f64>> {
    let mut squares = vec![0.0; views.len()];
    let folds = folds.min(views.len());
    let local = linearize_each((&fit.layout, &fit.robust.minimum.state), chosen, views)?;
    for fold in 0..folds {
        let kept: Vec<usize> =
            (0..views.len()).filter(|k| k % folds != fold).map(|k| views[k]).collect();
        let lens = refit(fit, (chosen, &local), &kept).state.lenses[0];
        for k in (fold..views.len()).step_by(folds) {
            squares[k] = squares_under(&lens, fit, &chosen[views[k]])?;
        }
    }
    Some(squares)
}

/// The fit of some of the views, from the fit of all, from their separate equations `local`.
pub(crate) fn refit(
    fit: &CameraFit,
    (chosen, local): (&[BoardObservation], &[LocalEquations]),
    views: &[usize],
) -> Minimum {
    let all = &fit.robust.minimum.state;
    let observations: Vec<BoardObservation> = views
        .iter()
        .enumerate()
        .map(|(k, view)| BoardObservation { frame_set: k, ..chosen[*view].clone() })
        .collect();
    let state = State {
        rig_from_board: views.iter().map(|view| all.rig_from_board[*view]).collect(),
        ..all.clone()
    };
    let parts = views.iter().enumerate().map(|(k, view)| (*view, k));
    let equations = assemble(local, (&fit.layout, all), chosen, (parts, views.len()));
    let start = Minimum { state, equations, steps: 0 };
    start.descend(&fit.layout, &observations, Loss::Squares, COMPARED)
}

/// The sum of squared pixel errors of one view at its best pose under `lens`.
pub(crate) fn squares_under(
    lens: &Lens,
    fit: &CameraFit,
    observation: &BoardObservation,
) -> Option<f64> {
    let all = &fit.robust.minimum.state;
    let layout = Layout::new(
        vec![FreeLens { model: lens.model(), free: Vec::new(), square_pixels: false }],
        None,
    )
    .ended_by(&fit.layout.interrupt);
    let pose = all.rig_from_board[observation.frame_set];
    let state = State { lenses: vec![*lens], rig_from_board: vec![pose], ..all.clone() };
    let observations = [BoardObservation { frame_set: 0, ..observation.clone() }];
    let loss = Loss::Squares;
    let mut minimum = Minimum::start(&layout, state, &observations, loss)?;
    let step = minimum.equations.solve(0.0)?;
    let mut residuals = minimum
        .state
        .stepped(&layout, &step.global, &step.frame_sets)?
        .residuals(&layout, &observations[0]);
    let used =
        || observation.used.iter().enumerate().filter(|(_, used)| **used).map(|(corner, _)| corner);
    let cost: f64 = used().map(|corner| residuals[corner]).map(|[x, y]| x * x + y * y).sum();
    // A step that ends as it was predicted needs no second one.
    let predicted = minimum.equations.cost - step.predicted_decrease;
    if !cost.is_finite() || (cost - predicted).abs() > AS_PREDICTED * cost {
        minimum = minimum.descend(
            &layout,
            &observations,
            loss,
            Stop { lambda: 0.0, decrease: 1e-4, ..Stop::default() },
        );
        residuals.clone_from(&minimum.equations.residuals[0]);
    }
    let squares = |corner: usize| {
        residuals[corner].map(|r| (r / observation.inverse_std[corner]).powi(2)).iter().sum::<f64>()
    };
    let squares: f64 = used().map(squares).sum();
    squares.is_finite().then_some(squares)
}
