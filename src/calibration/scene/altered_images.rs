//! Whether the images were cropped or stretched after the camera took them. The principal point of
//! a whole image is near its middle, that of a crop anywhere; pixels are square unless an image was
//! scaled by two factors. The lens is fitted under each of these priors, and the fits are averaged
//! by their posterior probability. Where the images determine the principal point or the pixels'
//! aspect poorly, the standard deviations thus follow from the prior probabilities.

use nalgebra::{DMatrix, DVector};

use crate::calibration::scene::fitted_lens::{FITTING, LensFit};
use crate::estimation::scene::covariance::lens_covariance;
use crate::estimation::scene::lens_prior::LensPrior;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

/// Prior probability that images with a camera's aspect ratio are crops.
const KNOWN_ASPECT_PRIOR: f64 = 0.03;
/// The same for another aspect ratio: some sensors have one, but most such images were cropped or
/// rectified.
const OTHER_ASPECT_PRIOR: f64 = 0.5;

/// Aspect ratios (width over height) of sensors and of their readout modes.
const SENSOR_ASPECTS: [f64; 8] =
    [1.0, 5.0 / 4.0, 4.0 / 3.0, 3.0 / 2.0, 752.0 / 480.0, 16.0 / 10.0, 16.0 / 9.0, 17.0 / 9.0];
/// Aspect ratios that differ by less are the same (relative difference): 4256 × 2832 is called 3:2
/// and 848 × 480 16:9, and the heights of reduced images are rounded.
const ASPECT_TOLERANCE: f64 = 0.0065;

/// The prior probability that images of `size` are crops.
fn cropped_beforehand(size: ImageSize) -> f64 {
    let (long, short) = (size.width.max(size.height), size.width.min(size.height).max(1));
    let shape = f64::from(long) / f64::from(short);
    let is_known =
        SENSOR_ASPECTS.iter().any(|known| (shape / known - 1.0).abs() < ASPECT_TOLERANCE);
    if is_known { KNOWN_ASPECT_PRIOR } else { OTHER_ASPECT_PRIOR }
}

/// Prior probability that images were stretched: some camera modes, video standards and programs
/// scale width and height by different factors. A guess, which matters only where the images do not
/// show the aspect: there the standard deviation of fx follows from it.
const STRETCHED_PRIOR: f64 = 0.01;

/// `plain`, the fit under the prior of whole images with square pixels, averaged with the fits
/// under the other priors. The most probable fit is the estimate; the covariance is that of the
/// mixture about it.
pub(super) fn averaged_over_alterations(plain: LensFit) -> LensFit {
    let prior = plain.fit.bundle.prior;
    let cropped = cropped_beforehand(prior.image_size);
    let or_not = |known: bool, probability: f64, is_estimated: bool| match (known, is_estimated) {
        (true, _) => vec![(true, 1.0)],
        (false, false) => vec![(false, 1.0)],
        (false, true) => vec![(false, 1.0 - probability), (true, probability)],
    };
    let croppings = or_not(prior.cropped, cropped, center_parameters(&plain) > 0);
    let stretches = or_not(prior.stretched, STRETCHED_PRIOR, estimates_aspect(&plain));
    let mut fits: Vec<(LensFit, f64)> = Vec::new();
    for (cropped, of_crop) in &croppings {
        for (stretched, of_stretch) in &stretches {
            let prior = LensPrior { cropped: *cropped, stretched: *stretched, ..prior };
            let Some(fit) = under(&plain, prior) else { continue };
            let log_weight = (of_crop * of_stretch).ln() + log_evidence(&fit);
            fits.push((fit, log_weight));
        }
    }
    mixture(fits).unwrap_or(plain)
}

/// The most probable of `fits`, each with the logarithm of its weight, with the covariance of all.
fn mixture(fits: Vec<(LensFit, f64)>) -> Option<LensFit> {
    let greatest = fits.iter().map(|(_, weight)| *weight).fold(f64::NEG_INFINITY, f64::max);
    if !greatest.is_finite() {
        return None;
    }
    let weights: Vec<f64> = fits.iter().map(|(_, weight)| (weight - greatest).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let probable = weights.iter().position(|weight| *weight >= 1.0)?;
    let own = fits[probable].0.fit.state.lens.parameters();
    let free = fits[probable].0.fit.bundle.free.clone();
    let mut covariance = DMatrix::zeros(free.len(), free.len());
    let (mut cropped, mut stretched) = (0.0, 0.0);
    for ((fit, _), weight) in fits.iter().zip(&weights) {
        let probability = weight / sum;
        let other = fit.fit.state.lens.parameters();
        let difference = free.iter().map(|k| other[*k] - own[*k]);
        let difference = DVector::from_iterator(free.len(), difference);
        covariance += (&fit.covariance.matrix + &difference * difference.transpose()) * probability;
        let LensPrior { cropped: is_crop, stretched: is_stretched, .. } = fit.fit.bundle.prior;
        cropped += if is_crop { probability } else { 0.0 };
        stretched += if is_stretched { probability } else { 0.0 };
    }
    let mut fit = fits.into_iter().nth(probable)?.0;
    fit.covariance.matrix = covariance;
    Some(LensFit { cropped, stretched, ..fit })
}

/// The same fit under another prior; `None` where that leaves parameters undetermined.
fn under(plain: &LensFit, prior: LensPrior) -> Option<LensFit> {
    if plain.fit.bundle.prior == prior {
        return Some(plain.clone());
    }
    let mut other = plain.clone();
    other.fit.bundle.prior = prior;
    other.fit.state = other.fit.bundle.minimize(other.fit.state, FITTING);
    let widened = other.covariance.widened;
    other.covariance = lens_covariance(&other.fit.bundle, &other.fit.state, widened)?;
    Some(other)
}

/// How many coordinates of the principal point are estimated.
fn center_parameters(fit: &LensFit) -> usize {
    fit.fit.bundle.free.iter().filter(|k| [Lens::CX, Lens::CY].contains(k)).count()
}

/// Whether fx or fy is estimated.
fn estimates_aspect(fit: &LensFit) -> bool {
    fit.fit.bundle.free.iter().any(|k| [Lens::FX, Lens::FY].contains(k))
}

/// The logarithm of the evidence of the observations under a fit's prior, by Laplace's
/// approximation, up to a constant that all fits share.
fn log_evidence(fit: &LensFit) -> f64 {
    let bundle = &fit.fit.bundle;
    let Some(root) = fit.covariance.independent.clone().cholesky() else {
        return f64::NEG_INFINITY;
    };
    let log_volume: f64 = root.l().diagonal().iter().map(|side| side.ln()).sum();
    let of_center = center_parameters(fit) as f64 * bundle.prior.center_std_px().ln();
    let of_aspect = if estimates_aspect(fit) { bundle.prior.aspect_std().ln() } else { 0.0 };
    log_volume - of_center - of_aspect - 0.5 * bundle.cost(&fit.fit.state)
}
