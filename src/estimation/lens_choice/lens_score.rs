//! Whether a larger lens model could fit better at all: a score test (C. R. Rao, *Large sample
//! tests of statistical hypotheses concerning several parameters*, 1948). It makes one step of all
//! parameters from the nearest lens of the larger model, which costs one of the hundred
//! linearizations that its fit and its comparison on held-out views take.

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::effects::lens_score::costs_beside_effects;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::normal::Step;
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State};
use crate::estimation::lens_choice::nearest_lens::nearest_lens;
use crate::estimation::problem::{CameraOptions, CameraProblem};
use crate::estimation::robust::Loss;
use crate::geometry::lens::LensModel;

/// A larger model is fitted where the gain exceeds its expectation by this many standard deviations
/// of chance. For 136 simulated lenses of the requested model gains went up to 17; for real lenses
/// that the model does not fit they start at 76.
const BEYOND_CHANCE_STDS: f64 = 8.0;

/// With fewer views the test has too little power: halves of 13 photographs whose lens is too
/// simple showed no gain beyond chance where fits of larger models predicted views better.
const MIN_VIEWS: usize = 8;

/// Whether a lens of `model` could explain residuals of `fit`, which has a smaller model. True also
/// where the test cannot decide. `stated` are the observations with the board as it was stated.
pub(crate) fn could_fit_better(
    model: LensModel,
    (fit, stated): (&CameraFit, &[BoardObservation]),
    (problem, options): (&CameraProblem, &CameraOptions),
) -> bool {
    if fit.good_views().len() < MIN_VIEWS {
        return true;
    }
    let Ok((free, given)) = FreeLens::from_options(model, options) else { return false };
    let Some(lens) = nearest_lens(fit.lens(), &free, &given, &fit.some_points_in_camera()) else {
        return true;
    };
    let layout = Layout::new(vec![free], None).ended_by(&options.interrupt);
    let costs = if fit.effects.is_some() {
        let rows = f64::from(problem.image_size.height);
        costs_beside_effects(fit, stated, rows, &layout, lens)
    } else {
        let state = State { lenses: vec![lens], ..fit.robust.minimum.state.clone() };
        Minimum::start(&layout, state, &fit.observations, Loss::Squares).map(|there| {
            let own = fit.robust.minimum.equations.cost;
            let step = there.equations.solve(0.0);
            let left = |step: &Step| there.equations.cost - step.predicted_decrease;
            [own, step.as_ref().map_or(own, left)]
        })
    };
    let Some([own, larger]) = costs else { return true };
    // Twice the log-likelihood ratio, with the variance of the noise estimated.
    let residuals: usize =
        fit.observations.iter().flat_map(|o| &o.used).filter(|used| **used).count() * 2;
    let gain = residuals as f64 * (own / larger.max(f64::MIN_POSITIVE)).ln();
    let more = layout.len.saturating_sub(fit.layout.len).max(1) as f64;
    gain > more + BEYOND_CHANCE_STDS * (2.0 * more).sqrt()
}
