//! The fit of one lens model to a reconstruction, and which model the images call for.

use nalgebra::{DMatrix, DVector};

use crate::calibration::scene::altered_images::averaged_over_alterations;
use crate::calibration::scene::fitted_lens::{FITTING, LensFit};
use crate::calibration::scene::refusal::SceneRefusal;
use crate::estimation::problem::{GivenParameter, LensChoice};
use crate::estimation::scene::bundle::{Bundle, SceneState};
use crate::estimation::scene::covariance::lens_covariance;
use crate::estimation::scene::reconstruction::Reconstruction;
use crate::estimation::scene::robust_bundle::fit_robustly;
use crate::geometry::lens::{Lens, LensModel};

/// Models with more coefficients are not compared by `auto`: scenes do not determine eight.
const MOST_COEFFICIENTS: usize = 5;

/// A larger model is taken if it lowers the cost by more than this, per parameter, in squared
/// standard deviations that count how observations err together: of models that are no better one
/// in 500.
const LEAST_GAIN_PER_PARAMETER: f64 = 6.0;

/// Fits a lens according to `choice`.
pub(super) fn fit_lens(
    start: &Reconstruction,
    choice: LensChoice,
    given: &[GivenParameter],
) -> Result<LensFit, SceneRefusal> {
    match choice {
        LensChoice::Model(model) => fit_model(start, model, given),
        LensChoice::Auto => choose(start, given),
    }
}

fn choose(start: &Reconstruction, given: &[GivenParameter]) -> Result<LensFit, SceneRefusal> {
    let knows = |model: &LensModel| {
        let names = Lens::parameter_names(*model);
        given.iter().all(|given| names.contains(&given.name.as_str()))
    };
    let mut fits: Vec<LensFit> = Vec::new();
    let mut refusal = SceneRefusal::NoFit;
    let mut compared: Vec<LensModel> = determined_models().filter(knows).collect();
    // A smaller polynomial is a larger one with coefficients fixed at exactly 0, which real lenses
    // do not have: its principal point would absorb tangential distortion. Where the images leave
    // coefficients open, the priors bound them.
    let largest = largest_polynomial(start, &compared);
    compared.retain(|model| Some(*model) == largest || !is_polynomial(start, *model));
    compared.sort_by_key(|model| model.facts().auto_order);
    for model in compared {
        match fit_model(start, model, given) {
            Ok(fit) => fits.push(fit),
            Err(error) => refusal = error,
        }
    }
    // All models are compared on the observations and the noise of the model that fits best.
    let Some(closest) =
        fits.iter().min_by(|a, b| a.fit.noise_factor.total_cmp(&b.fit.noise_factor))
    else {
        return Err(refusal);
    };
    let bundle = &closest.fit.bundle;
    let costs: Vec<f64> = fits
        .iter()
        .map(|fit| {
            if std::ptr::eq(fit, closest) {
                return bundle.cost(&closest.fit.state);
            }
            let mut state = closest.fit.state.clone();
            state.lens = fit.fit.state.lens;
            let own = Bundle { free: fit.fit.bundle.free.clone(), ..bundle.clone() };
            own.cost(&own.minimize(state, FITTING))
        })
        .collect();
    let is_beaten = |small: usize| {
        (small + 1..fits.len()).any(|large| {
            let extra =
                fits[large].fit.bundle.free.len() as f64 - fits[small].fit.bundle.free.len() as f64;
            let gain = costs[small] - costs[large];
            gain > LEAST_GAIN_PER_PARAMETER * extra.max(1.0)
        })
    };
    let chosen = (0..fits.len()).find(|k| !is_beaten(*k)).unwrap_or(0);
    let between = between_models(&fits, &costs, chosen);
    let mut fit = fits.swap_remove(chosen);
    fit.covariance.matrix += between;
    Ok(fit)
}

/// The models that scenes can determine.
fn determined_models() -> impl Iterator<Item = LensModel> {
    LensModel::compared().filter(|model| model.coefficient_names().len() <= MOST_COEFFICIENTS)
}

fn largest_polynomial(start: &Reconstruction, models: &[LensModel]) -> Option<LensModel> {
    let polynomials = models.iter().copied().filter(|model| is_polynomial(start, *model));
    polynomials.max_by_key(|model| model.coefficient_names().len())
}

/// The bundle of `start` and its state, with as much distortion free as scenes can determine.
pub(super) fn with_free_distortion(start: &Reconstruction) -> (Bundle, SceneState) {
    let (mut bundle, mut state) = (start.bundle.clone(), start.state.clone());
    let models: Vec<LensModel> = determined_models().collect();
    let lens = largest_polynomial(start, &models)
        .and_then(|model| Lens::from_parameters(model, &first_guess(start, model)));
    state.lens = lens.unwrap_or(state.lens);
    bundle.free = (0..state.lens.parameters().len()).filter(|k| *k != Lens::SKEW).collect();
    (bundle, state)
}

/// What the choice between models adds to the covariance of the chosen one's camera matrix: the
/// squared differences to the other models by their Akaike weights (K. Burnham and D. Anderson,
/// *Multimodel inference*, 2004, equation 4). Coefficients of different models are not compared.
fn between_models(fits: &[LensFit], costs: &[f64], chosen: usize) -> DMatrix<f64> {
    let criterion = |k: usize| costs[k] + 2.0 * fits[k].fit.bundle.free.len() as f64;
    let least = (0..fits.len()).map(criterion).fold(f64::INFINITY, f64::min);
    let likelihood = |k: usize| (-0.5 * (criterion(k) - least)).exp();
    let sum: f64 = (0..fits.len()).map(likelihood).sum();
    let free = &fits[chosen].fit.bundle.free;
    let own = fits[chosen].fit.state.lens.parameters();
    let mut covariance = DMatrix::zeros(free.len(), free.len());
    for (k, fit) in fits.iter().enumerate() {
        let other = fit.fit.state.lens.parameters();
        let difference = DVector::from_iterator(
            free.len(),
            free.iter()
                .map(|p| if *p < Lens::FIRST_COEFFICIENT { other[*p] - own[*p] } else { 0.0 }),
        );
        covariance += &difference * difference.transpose() * (likelihood(k) / sum);
    }
    covariance
}

/// Fits `model`, all parameters but skew and the `given` ones free.
fn fit_model(
    start: &Reconstruction,
    model: LensModel,
    given: &[GivenParameter],
) -> Result<LensFit, SceneRefusal> {
    let (mut parameters, names) = (first_guess(start, model), Lens::parameter_names(model));
    let mut free: Vec<usize> = (0..parameters.len()).filter(|k| *k != Lens::SKEW).collect();
    for GivenParameter { name, value } in given {
        let unknown = || SceneRefusal::UnknownParameter { name: name.clone(), model };
        let index = names.iter().position(|known| known == name).ok_or_else(unknown)?;
        parameters[index] = *value;
        free.retain(|k| *k != index);
    }
    let mut state = start.state.clone();
    state.lens = Lens::from_parameters(model, &parameters).ok_or(SceneRefusal::NoFit)?;
    let bundle = Bundle { free, ..start.bundle.clone() };
    let mut fit = fit_robustly(bundle, state, FITTING);
    let alone = lens_covariance(&fit.bundle, &fit.state, 1.0).ok_or(SceneRefusal::NoFit)?;
    // Observations with correlated errors carry less information than as many independent ones:
    // they are weighted down against the priors, and between models.
    let widened = alone.shared;
    fit.bundle.rescaled(widened.sqrt());
    fit.state = fit.bundle.minimize(fit.state, FITTING);
    let covariance =
        lens_covariance(&fit.bundle, &fit.state, widened).ok_or(SceneRefusal::NoFit)?;
    Ok(averaged_over_alterations(LensFit { fit, covariance, cropped: 0.0, stretched: 0.0 }))
}

/// Whether `model` belongs to the family of Brown's polynomials.
fn is_polynomial(start: &Reconstruction, model: LensModel) -> bool {
    let mut parameters = start.bundle.prior.mean(model);
    parameters[..Lens::FIRST_COEFFICIENT]
        .copy_from_slice(&start.state.lens.parameters()[..Lens::FIRST_COEFFICIENT]);
    Lens::from_parameters(model, &parameters)
        .is_some_and(|lens| lens.distortion.as_rational().is_some())
}

/// The camera matrix of `start` with the most likely coefficients of the model.
fn first_guess(start: &Reconstruction, model: LensModel) -> Vec<f64> {
    let known = start.state.lens.parameters();
    let mut parameters = start.bundle.prior.mean(model);
    parameters[..Lens::FIRST_COEFFICIENT].copy_from_slice(&known[..Lens::FIRST_COEFFICIENT]);
    if !is_polynomial(start, model) {
        parameters.truncate(Lens::FIRST_COEFFICIENT);
        parameters.extend(model.straight());
    } else if let (Some(own), Some(first)) =
        (parameters.get_mut(Lens::FIRST_COEFFICIENT), known.get(Lens::FIRST_COEFFICIENT))
    {
        *own = *first;
    }
    parameters
}
