//! Whether the images are crops of what the camera took. The principal point of a whole image is
//! near its middle, that of a crop anywhere. The lens is fitted under both priors, and the fits are
//! averaged by their posterior probability. Where the images determine the principal point poorly,
//! its standard deviation thus follows from the prior probability of a crop.

use nalgebra::DVector;

use crate::calibration::scene::fitted_lens::{FITTING, LensFit};
use crate::estimation::scene::covariance::lens_covariance;
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

/// The fit under the prior of whole images, `whole`, averaged with the fit under the prior of
/// crops. The more probable fit is the estimate; the covariance is that of the mixture about it.
pub(super) fn averaged_over_cropping(whole: LensFit) -> LensFit {
    if whole.fit.bundle.prior.cropped {
        return LensFit { cropped: 1.0, ..whole };
    }
    let Some(part) = as_part(&whole) else { return whole };
    let beforehand = cropped_beforehand(whole.fit.bundle.prior.image_size);
    let ratio = (log_evidence(&part) - log_evidence(&whole)).exp();
    let odds = ratio * beforehand / (1.0 - beforehand);
    let cropped = if odds.is_finite() { odds / (1.0 + odds) } else { 1.0 };
    let (own, other, of_other) =
        if cropped > 0.5 { (part, whole, 1.0 - cropped) } else { (whole, part, cropped) };
    let parameters = [&own, &other].map(|fit| fit.fit.state.lens.parameters());
    let free = &own.fit.bundle.free;
    let difference = free.iter().map(|k| parameters[1][*k] - parameters[0][*k]);
    let difference = DVector::from_iterator(free.len(), difference);
    let mut fit = LensFit { cropped, ..own };
    let of_both =
        &other.covariance.matrix + &difference * difference.transpose() - &fit.covariance.matrix;
    fit.covariance.matrix += of_both * of_other;
    fit
}

/// The same fit under the prior of crops; `None` where the principal point is given, or where that
/// leaves parameters undetermined.
fn as_part(whole: &LensFit) -> Option<LensFit> {
    if center_parameters(whole) == 0 {
        return None;
    }
    let mut part = whole.clone();
    part.fit.bundle.prior.cropped = true;
    part.fit.state = part.fit.bundle.minimize(part.fit.state, FITTING);
    let widened = part.covariance.widened;
    part.covariance = lens_covariance(&part.fit.bundle, &part.fit.state, widened)?;
    Some(part)
}

/// How many coordinates of the principal point are estimated.
fn center_parameters(fit: &LensFit) -> usize {
    fit.fit.bundle.free.iter().filter(|k| [Lens::CX, Lens::CY].contains(k)).count()
}

/// The logarithm of the evidence of the observations under a fit's prior, by Laplace's
/// approximation, up to a constant that both fits share.
fn log_evidence(fit: &LensFit) -> f64 {
    let bundle = &fit.fit.bundle;
    let Some(root) = fit.covariance.independent.clone().cholesky() else {
        return f64::NEG_INFINITY;
    };
    let log_volume: f64 = root.l().diagonal().iter().map(|side| side.ln()).sum();
    let prior = center_parameters(fit) as f64 * bundle.prior.center_std_px().ln();
    log_volume - prior - 0.5 * bundle.cost(&fit.fit.state)
}
