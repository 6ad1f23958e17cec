//! The variance between lens models, which adds to the covariance of the chosen lens: the squared
//! differences from the other models' lenses, each weighted by its probability of being closer to
//! the true lens (J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, *Bayesian model
//! averaging: a tutorial*, 1999, equation 3, about the lens that is reported). Without it, a choice
//! that depends on single views would change the result by more than its stated standard
//! deviations.

use nalgebra::{DMatrix, DVector, Point3};

use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::FreeLens;
use crate::estimation::lens_choice::lens_trial::Trial;
use crate::estimation::lens_choice::nearest_lens::{WeightedPoint, nearest_from};
use crate::estimation::uncertainty::{Distance, PixelGrid, projection_uncertainty};
use crate::geometry::lens::Lens;

/// Upper bound of another model's odds: a model with higher odds was not chosen because it is
/// uncertain outside the views.
const MOST_ODDS: f64 = 1.0;

/// A model with lower odds is left out (Occam's window of D. Madigan, A. E. Raftery, *Model
/// selection and accounting for model uncertainty in graphical models using Occam's window*, 1994).
/// The tail of a normal distribution is not known so far out, and lenses that are clearly wrong
/// differ by hundreds of standard deviations.
const LEAST_ODDS: f64 = 0.05;

/// A model as compared with the others, and its fit as reported if it is chosen: models are
/// compared on a common board, and each is reported with the board that it found itself.
pub(crate) struct ComparedModel<'a> {
    pub(crate) trial: Trial<'a>,
    pub(crate) reported: &'a CameraFit,
}

/// The covariance between `models` about the `chosen` one, in the order of
/// [`Lens::parameter_names`]. Models with fewer parameters come before it, those with more after
/// it. `None` where the projections of one of them are not determined.
pub(crate) fn between_models(models: &[ComparedModel<'_>], chosen: usize) -> Option<DMatrix<f64>> {
    let own = &models[chosen];
    // Each with the larger of two probabilities: that of being closer to the true lens, so that the
    // stated error is true, and that of being chosen with other views, so that changes by single
    // views are within it.
    let odds = |(k, other): (usize, &ComparedModel<'_>)| {
        let probability = match k.cmp(&chosen) {
            std::cmp::Ordering::Less => 1.0 - own.trial.probabilities_beside(&other.trial)[0],
            std::cmp::Ordering::Equal => 0.5,
            std::cmp::Ordering::Greater => other.trial.probabilities_beside(&own.trial)[1],
        };
        let odds = (probability / (1.0 - probability).max(f64::MIN_POSITIVE)).min(MOST_ODDS);
        if odds < LEAST_ODDS { 0.0 } else { odds }
    };
    let odds: Vec<f64> = models.iter().enumerate().map(odds).collect();
    let sum: f64 = odds.iter().sum();
    let count = own.reported.lens().parameters().len();
    let mut covariance = DMatrix::zeros(count, count);
    for ((k, other), odds) in models.iter().enumerate().zip(&odds) {
        if *odds > 0.0 && k != chosen {
            let difference = difference(own.reported, other.reported, own.trial.grid)?;
            covariance += &difference * difference.transpose() * (odds / sum);
        }
    }
    Some(covariance)
}

/// The change of the parameters of one lens that makes its projections closest to those of another
/// model's lens. Focal lengths and principal point are those of the other, and coefficients are
/// fitted. Pixels are weighted by how well both lenses are known there.
fn difference(own: &CameraFit, other: &CameraFit, grid: PixelGrid) -> Option<DVector<f64>> {
    let [lens, target] = [own, other].map(CameraFit::lens);
    let variances = |fit: &CameraFit| {
        let covariance = fit.lens_covariance()?;
        Some(projection_uncertainty(fit.lens(), &covariance, grid, Distance::Infinity)?.square_px2)
    };
    let variances = variances(own)?.into_iter().zip(variances(other)?);
    let seen: Vec<WeightedPoint> = grid
        .pixels()
        .zip(variances)
        .filter_map(|(pixel, (own, other))| {
            let in_camera = Point3::from(lens.bearing_from_pixel(pixel)?.into_inner());
            target.pixel_from_point(&in_camera)?;
            Some(WeightedPoint { in_camera, weight: 1.0 / (own? + other?) })
        })
        .collect();
    let free_lens = &own.layout.sensors[0].lens;
    let coefficients = FreeLens {
        model: free_lens.model,
        free: free_lens
            .free
            .iter()
            .copied()
            .filter(|index| *index >= Lens::FIRST_COEFFICIENT)
            .collect(),
        square_pixels: false,
    };
    let moved = Lens { matrix: target.matrix, ..*lens };
    let miss = |lens: &Lens| -> f64 {
        let of = |WeightedPoint { in_camera, weight }: &WeightedPoint| {
            let pixels = [lens, target].map(|lens| lens.pixel_from_point(in_camera));
            let [Some(pixel), Some(wanted)] = pixels else { return f64::INFINITY };
            pixel.distance_px(wanted).powi(2) * weight
        };
        seen.iter().map(of).sum()
    };
    // For coefficients that the pixels do not determine, the search may end anywhere.
    let near = nearest_from(moved, target, &coefficients, &seen)
        .filter(|near| miss(near) < miss(&moved))
        .unwrap_or(moved);
    Some(
        DVector::from_vec(near.parameters().to_vec())
            - DVector::from_vec(lens.parameters().to_vec()),
    )
}
