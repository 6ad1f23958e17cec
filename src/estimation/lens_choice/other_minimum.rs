//! Another lens of the same model that fits the views nearly as closely.
//!
//! A double sphere lens with ξ = 0 has, to first order, the same projection with other focal
//! lengths ([`ModelFacts::focal_coefficient`](crate::geometry::lens::model::ModelFacts)). So the
//! cost has a ridge near ξ = 0 and a minimum on either side of it: the projections of lenses of fx
//! 330, ξ 0.3 and of fx 217, ξ −0.14 are equal to 0.01 px up to 60 degrees off the axis. Iterations
//! end on the side where they start, and the covariance at one minimum does not include the other.

use crate::estimation::camera_fit::{CameraFit, fit_again};
use crate::estimation::joint::State;
use crate::estimation::joint::free_lens::FreeLens;
use crate::estimation::lens_choice::lens_trial::in_standard_errors;
use crate::estimation::lens_choice::nearest_lens::{WeightedPoint, nearest_from};
use crate::estimation::lens_choice::starts_from_other_lenses::squares_of_views;
use crate::estimation::normal_probability::normal_probability;
use crate::estimation::start::Prepared;
use crate::geometry::lens::Lens;

/// The least and the largest distance from ξ = 0 at which a search on the other side starts. With
/// 0.2 it starts beyond the ridge, which is flat near 0; beyond 0.6 few rays are in view. Chosen,
/// not swept.
const XI_STARTS: [f64; 2] = [0.2, 0.6];

/// A less probable lens is left out: this is three standard deviations. Chosen, not swept.
const LEAST_PROBABILITY: f64 = 0.001;

/// Another lens of the requested model, which fits the views nearly as closely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherMinimum {
    /// The lens.
    pub lens: Lens,
    /// Its probability, up to 0.5: by the likelihood of the corners, or the probability that with
    /// other views of the same kind it would fit more closely than the estimated one, whichever is
    /// greater.
    pub probability: f64,
}

/// The closer of the fits on both sides of the ridge, and the other one where the views do not
/// decide between them. `fit` unchanged where its model has no ridge, given parameters leave none,
/// or there is no minimum beyond it.
pub(crate) fn closer_of_two_minima(
    fit: CameraFit,
    prepared: &Prepared,
) -> (CameraFit, Option<OtherMinimum>) {
    let Some(other) = beyond_the_ridge(&fit, prepared) else { return (fit, None) };
    let limit = fit.robust.limit.min(other.robust.limit);
    let [own, of_other] = [&fit, &other].map(|fit| squares_of_views(fit, limit * limit));
    let closer = own.iter().sum::<f64>() <= of_other.iter().sum::<f64>();
    let differences: Vec<f64> = own
        .iter()
        .zip(&of_other)
        .filter(|(own, other)| **own > 0.0 || **other > 0.0)
        .map(|(own, other)| if closer { other - own } else { own - other })
        .collect();
    let (best, other) = if closer { (fit, other) } else { (other, fit) };
    // With independent corners, the likelihood is valid. With errors common to a view, which the
    // likelihood does not include, the scatter between views is. The larger of the two
    // probabilities is used, since tiny differences may all have the same sign by chance.
    let by_views = 1.0 - normal_probability(in_standard_errors(&differences));
    let odds = (-0.5 * differences.iter().sum::<f64>() / best.noise_square()).exp();
    let probability = by_views.max(odds / (1.0 + odds));
    let other = OtherMinimum { lens: *other.lens(), probability };
    (best, (probability > LEAST_PROBABILITY).then_some(other))
}

/// The minimum on the other side of the ridge; `None` where there is no ridge, or no minimum.
fn beyond_the_ridge(fit: &CameraFit, prepared: &Prepared) -> Option<CameraFit> {
    let lens = *fit.lens();
    let model = lens.model();
    let name = model.facts().focal_coefficient?;
    let at = Lens::parameter_names(model).iter().position(|known| *known == name)?;
    let free = &fit.layout.sensors[0].lens;
    if ![Lens::FX, at].iter().all(|index| free.free.contains(index)) {
        return None;
    }
    let coefficient = lens.parameters()[at];
    let [least, most] = XI_STARTS;
    let start = -coefficient.abs().clamp(least, most).copysign(coefficient);
    // The image's center is scaled by f/(1 + ξ).
    let scale = (1.0 + start) / (1.0 + coefficient);
    let mut parameters = lens.parameters();
    parameters[at] = start;
    for focal in [Lens::FX, Lens::FY].iter().filter(|index| free.moves(**index)) {
        parameters[*focal] *= scale;
    }
    let begun = Lens::from_parameters(model, &parameters)?;
    let held = FreeLens {
        free: free.free.iter().copied().filter(|index| *index != at).collect(),
        ..free.clone()
    };
    let alike = |in_camera| WeightedPoint { in_camera, weight: 1.0 };
    let seen: Vec<WeightedPoint> = fit.some_points_in_camera().into_iter().map(alike).collect();
    let begun = nearest_from(begun, &lens, &held, &seen)?;
    let state = State { lenses: vec![begun], ..fit.robust.minimum.state.clone() };
    let other = fit_again(prepared, fit, state).ok()?;
    let is_beyond = other.lens().parameters()[at] * coefficient < 0.0;
    let is_whole = other.good_views().len() >= fit.good_views().len();
    (is_beyond && is_whole).then_some(other)
}
