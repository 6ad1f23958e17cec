//! The lens of one model that is closest to a lens of another, over given points.

use nalgebra::{DMatrix, Point3, SMatrix, SVector, Vector2};

use crate::estimation::joint::free_lens::{FreeLens, Given};
use crate::geometry::lens::{Distortion, Lens, LensModel, MAX_PARAMETERS};

/// Gauss–Newton steps: the models are close to linear in their coefficients.
const STEPS: usize = 5;

/// The scaled gradient, in pixels, below which the fit is exact: the model contains the lens.
const NO_MISS_PX: f64 = 1e-9;

/// Keeps parameters that the points do not determine where they are.
const DAMPING: f64 = 1e-12;

/// A point in view of a lens, and its weight.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WeightedPoint {
    /// In the camera's frame; its distance does not matter.
    pub(crate) in_camera: Point3<f64>,
    /// The inverse of the variance of its pixel, up to a common factor.
    pub(crate) weight: f64,
}

/// The lens with the free parameters of `free`, the others being `given`, whose projections of
/// `points_in_camera` are closest to those of `lens`, by least squares of pixels. `None` where it
/// cannot project them all.
pub(crate) fn nearest_lens(
    lens: &Lens,
    free: &FreeLens,
    given: &Given,
    points_in_camera: &[Point3<f64>],
) -> Option<Lens> {
    let mut near = Lens { matrix: lens.matrix, distortion: nested(lens, free.model)? };
    given.apply(&mut near)?;
    let alike = |point: &Point3<f64>| WeightedPoint { in_camera: *point, weight: 1.0 };
    let seen: Vec<WeightedPoint> = points_in_camera.iter().map(alike).collect();
    nearest_from(near, lens, free, &seen)
}

/// As [`nearest_lens`], starting from a lens whose fixed parameters are kept.
pub(crate) fn nearest_from(
    mut near: Lens,
    lens: &Lens,
    free: &FreeLens,
    seen: &[WeightedPoint],
) -> Option<Lens> {
    let by_free = free.all_by_free(&near);
    let (all, size) = by_free.shape();
    for _ in 0..STEPS {
        let mut square = SMatrix::<f64, MAX_PARAMETERS, MAX_PARAMETERS>::zeros();
        let mut right = SVector::<f64, MAX_PARAMETERS>::zeros();
        for WeightedPoint { in_camera, weight } in seen {
            let (wanted, now) = (lens.pixel_from_point(in_camera)?, near.project(in_camera)?);
            let miss = Vector2::new(wanted.x - now.pixel.x, wanted.y - now.pixel.y);
            square += now.by_parameters.tr_mul(&now.by_parameters) * *weight;
            right += now.by_parameters.tr_mul(&miss) * *weight;
        }
        let square = by_free.transpose() * square.view((0, 0), (all, all)) * &by_free;
        let right = by_free.transpose() * right.rows(0, all);
        // Parameters differ by orders of magnitude, hence units of their own information.
        let scale = square.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        let right = right.component_mul(&scale);
        if right.amax() < NO_MISS_PX {
            break;
        }
        let scaled = DMatrix::from_fn(size, size, |i, j| {
            square[(i, j)] * scale[i] * scale[j] + if i == j { DAMPING } else { 0.0 }
        });
        let step = scaled.cholesky()?.solve(&right).component_mul(&scale);
        let step = &by_free * step;
        let parameters: Vec<f64> =
            near.parameters().iter().zip(&step).map(|(now, step)| now + step).collect();
        near = Lens::from_parameters(free.model, &parameters)?;
    }
    Some(near)
}

/// The distortion of a lens in a larger model that contains it; otherwise the start of a search.
fn nested(lens: &Lens, model: LensModel) -> Option<Distortion> {
    let start = Distortion::start(model);
    match (lens.distortion.as_rational(), start.as_rational()) {
        (Some(coefficients), Some(_)) => {
            let held = coefficients.get(..start.coefficients().len())?;
            Distortion::from_coefficients(model, held)
        }
        _ => Some(start),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::problem::CameraOptions;

    fn points() -> Vec<Point3<f64>> {
        let along = |k: i32| f64::from(k) / 12.0;
        (-6..=6).flat_map(|x| (-6..=6).map(move |y| Point3::new(along(x), along(y), 1.0))).collect()
    }

    #[test]
    fn a_model_that_holds_the_lens_gives_it_and_another_comes_near() {
        let parameters = [600.0, 601.0, 320.0, 240.0, 0.0, -0.2, 0.05, 1e-3, -5e-4, 0.01];
        let lens = Lens::from_parameters(LensModel::Brown, &parameters).unwrap();
        let off_px = |model| {
            let (free, given) = FreeLens::from_options(model, &CameraOptions::default()).unwrap();
            let near = nearest_lens(&lens, &free, &given, &points()).unwrap();
            let off = |point: &Point3<f64>| {
                let [seen, near] = [lens, near].map(|lens| lens.pixel_from_point(point).unwrap());
                seen.distance_px(near)
            };
            points().iter().map(off).fold(0.0, f64::max)
        };
        assert!(off_px(LensModel::Rational) < 1e-9);
        let fisheye = off_px(LensModel::KannalaBrandt);
        assert!((0.01..1.0).contains(&fisheye), "{fisheye}");
    }
}
