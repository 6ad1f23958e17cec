//! Another lens of the same model that fits the views nearly as closely.
//!
//! A double sphere lens with ξ = 0 projects the same, to first order, with other focal lengths
//! ([`ModelFacts::focal_coefficient`](crate::geometry::lens::model::ModelFacts)). So the cost has a
//! ridge near ξ = 0 and a minimum on either side of it: lenses of fx 330, ξ 0.3 and of fx 217,
//! ξ −0.14 project alike to 0.01 px up to 60 degrees off the axis. A descent ends on the side that
//! it happens to begin on, and what one minimum says of its own deviations does not reach the other.

use crate::estimation::camera_fit::{CameraFit, fit_again};
use crate::estimation::joint::State;
use crate::estimation::joint::free_lens::FreeLens;
use crate::estimation::lens_trial::in_standard_errors;
use crate::estimation::nearest_lens::{WeightedPoint, nearest_from};
use crate::estimation::normal_probability::normal_probability;
use crate::estimation::start::Prepared;
use crate::estimation::starts_from_other_lenses::squares_of_views;
use crate::geometry::lens::Lens;

/// A search on the other side begins at least and at most this far from ξ = 0. With 0.2 it begins
/// beyond the ridge, which is flat near 0; beyond 0.6 few rays are seen. Chosen, not swept.
const BEGINS: [f64; 2] = [0.2, 0.6];

/// A lens that is less likely is left out: beyond three standard deviations. Chosen, not swept.
const LEAST_PROBABILITY: f64 = 0.001;

/// Another lens of the model that was asked for, which fits the views nearly as closely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherMinimum {
    /// The lens.
    pub lens: Lens,
    /// How likely it is, up to 0.5: by the likelihood of the corners, or that with other views of
    /// the same kind it would fit more closely than the estimated one, whichever is greater.
    pub probability: f64,
}

/// The closer fit of those on either side of the ridge, and the other one where the views do not
/// decide between them. `fit` as it is where its model has no ridge, or parameters that are given leave
/// none.
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
    // Where corners err by themselves the likelihood says it; where views err as a whole they
    // scatter, which the likelihood does not know of. Differences that are next to nothing may all
    // have one sign by chance.
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
    let [least, most] = BEGINS;
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
