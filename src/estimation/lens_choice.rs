//! Which lens model: the one with the smallest error on views that it was not fitted to, and of those that no held-out
//! view tells apart from it, the one with the fewest parameters.

use crate::estimation::camera::{CameraFit, CameraOptions, fit_camera};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::{FreeLens, Layout, Sight, State};
use crate::estimation::robust::Loss;
use crate::estimation::start::Prepared;
use crate::geometry::lens::{Lens, LensModel};

/// How one lens model did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensTrial {
    /// The model.
    pub model: LensModel,
    /// Root mean square error on views that were not fitted to, in pixels, once each of those views has its own pose.
    pub held_out_rms_px: f64,
    /// How many parameters were estimated.
    pub parameters: usize,
}

/// The views are dealt into this many parts, each held out once.
const FOLDS: usize = 4;

/// Views used in the comparison at most; more would not tell the models further apart.
const MAX_VIEWS: usize = 100;

/// Fits every model, and answers the fit of the chosen one with what was compared, fewest parameters first.
pub(crate) fn choose_lens(
    prepared: &mut Prepared,
    options: &CameraOptions,
) -> Result<(CameraFit, Vec<LensTrial>), EstimationError> {
    let mut fits = Vec::new();
    let mut refusal = None;
    for model in LensModel::ALL {
        match fit_camera(prepared, model, options) {
            Ok(fit) => fits.push(fit),
            Err(error) => refusal = Some(error),
        }
    }
    // The model that fits most closely tells best which corners are wrong.
    let closest = fits.iter().min_by(|a, b| a.robust.limit.total_cmp(&b.robust.limit));
    let Some(closest) = closest.cloned() else { return Err(refusal.unwrap_or(EstimationError::NoFit)) };
    let views = closest.good_views();
    let views: Vec<usize> = views.iter().step_by(views.len().div_ceil(MAX_VIEWS).max(1)).copied().collect();
    let tried: Vec<_> =
        fits.iter().filter_map(|fit| Some((fit, held_out_squares(fit, &closest.sights, &views, FOLDS)?))).collect();
    let total = |squares: &[f64]| squares.iter().sum::<f64>();
    let best = tried.iter().min_by(|a, b| total(&a.1).total_cmp(&total(&b.1)));
    let Some((best_fit, best_squares)) = best else { return Ok((closest, Vec::new())) };
    let mut chosen = *best_fit;
    for (fit, squares) in &tried {
        let fewer = fit.layout.len < chosen.layout.len;
        if fewer && is_no_worse(squares, best_squares) {
            chosen = fit;
        }
    }
    let corners: usize = views.iter().map(|v| closest.sights[*v].used.iter().filter(|used| **used).count()).sum();
    let trial = |(fit, squares): &(&CameraFit, Vec<f64>)| LensTrial {
        model: fit.lens().model(),
        held_out_rms_px: (total(squares) / corners.max(1) as f64).sqrt(),
        parameters: fit.layout.sensors[0].lens.free.len(),
    };
    Ok((chosen.clone(), tried.iter().map(trial).collect()))
}

/// Whether the mean difference per view is within one standard error of nothing.
fn is_no_worse(squares: &[f64], best: &[f64]) -> bool {
    let n = squares.len() as f64;
    let differences: Vec<f64> = squares.iter().zip(best).map(|(a, b)| a - b).collect();
    let mean = differences.iter().sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    mean <= (variance / n).sqrt()
}

/// Per view, the sum of squared pixel errors under a lens fitted without it. `None` where a part cannot be fitted.
pub(crate) fn held_out_squares(fit: &CameraFit, chosen: &[Sight], views: &[usize], folds: usize) -> Option<Vec<f64>> {
    let mut squares = vec![0.0; views.len()];
    let folds = folds.min(views.len());
    for fold in 0..folds {
        let kept: Vec<usize> = (0..views.len()).filter(|k| k % folds != fold).map(|k| views[k]).collect();
        let lens = refit(fit, chosen, &kept)?.state.lenses[0];
        for k in (fold..views.len()).step_by(folds) {
            squares[k] = squares_under(&lens, fit, &chosen[views[k]])?;
        }
    }
    Some(squares)
}

/// The fit of some of the views, from the fit of all.
pub(crate) fn refit(fit: &CameraFit, chosen: &[Sight], views: &[usize]) -> Option<Minimum> {
    refit_within((fit, &fit.layout), chosen, views, Stop { lambda: 0.0, ..Stop::default() })
}

/// As [`refit`], with other parameters free, and until `stop`.
pub(crate) fn refit_within(
    (fit, layout): (&CameraFit, &Layout),
    chosen: &[Sight],
    views: &[usize],
    stop: Stop,
) -> Option<Minimum> {
    let all = &fit.robust.minimum.state;
    let sights: Vec<Sight> =
        views.iter().enumerate().map(|(k, view)| Sight { instant: k, ..chosen[*view].clone() }).collect();
    let state = State { rig_from_board: views.iter().map(|view| all.rig_from_board[*view]).collect(), ..all.clone() };
    Some(Minimum::start(layout, state, &sights, Loss::Squares)?.descend(layout, &sights, Loss::Squares, stop))
}

/// The sum of squared pixel errors of one view at its best pose under `lens`.
pub(crate) fn squares_under(lens: &Lens, fit: &CameraFit, sight: &Sight) -> Option<f64> {
    let all = &fit.robust.minimum.state;
    let layout = Layout::new(vec![FreeLens { model: lens.model(), free: Vec::new(), square_pixels: false }], None);
    let pose = all.rig_from_board[sight.instant];
    let state = State { lenses: vec![*lens], rig_from_board: vec![pose], ..all.clone() };
    let sights = [Sight { instant: 0, ..sight.clone() }];
    let stop = Stop { lambda: 0.0, decrease: 1e-4, ..Stop::default() };
    let loss = Loss::Squares;
    let minimum = Minimum::start(&layout, state, &sights, loss)?.descend(&layout, &sights, loss, stop);
    let corners = minimum.equations.residuals[0].iter().zip(&sight.inverse_std).zip(&sight.used);
    Some(corners.filter(|(_, used)| **used).map(|(([x, y], s), _)| (x * x + y * y) / (s * s)).sum())
}
