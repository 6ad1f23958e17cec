//! The nearest lens of a smaller model, and how far off it is.

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{Bearing, ImageSize, Pixel};

/// A refitted lens with its difference from the one it stands for, over the image.
pub(super) struct Refit {
    /// Of the brown model, with k3 = 0.
    pub lens: Lens,
    /// Root mean square of the 2-D difference.
    pub rms_px: f64,
    /// The largest difference.
    pub worst_px: f64,
}

/// Columns of [`Lens::parameters`] that are fitted: fx, fy, cx, cy, k1, k2, p1, p2; skew and k3
/// stay 0.
const FREE: [usize; 8] = [0, 1, 2, 3, 5, 6, 7, 8];

/// The lens with k1, k2, p1, p2 that sees the image as nearly as possible as `lens` does:
/// Gauss–Newton on the pixel differences over a grid that covers the image, up to a rotation of the
/// camera, which a calibration leaves open only as one with the poses and which is therefore kept.
/// `None` where it does not converge or `lens` does not see the whole image.
pub(super) fn with_four_coefficients(lens: &Lens, size: ImageSize) -> Option<Refit> {
    let seen = grid(lens, size)?;
    let mut parameters = lens.parameters();
    let mut coefficients = lens.distortion.coefficients();
    coefficients.resize(4, 0.0);
    parameters.truncate(5);
    parameters.extend(starting_coefficients(lens.model(), &coefficients));
    for _ in 0..30 {
        let fitted = Lens::from_parameters(LensModel::Brown, &parameters)?;
        let (jacobian, residuals) = linearize(&fitted, &seen)?;
        let step = jacobian.svd(true, true).solve(&residuals, 1e-14).ok()?;
        for (column, change) in FREE.iter().zip(step.iter()) {
            parameters[*column] -= change;
        }
        if step.norm() < 1e-10 {
            break;
        }
    }
    let fitted = Lens::from_parameters(LensModel::Brown, &parameters)?;
    let (_, residuals) = linearize(&fitted, &seen)?;
    let squares: Vec<f64> =
        residuals.as_slice().chunks(2).map(|r| r[0] * r[0] + r[1] * r[1]).collect();
    let rms_px = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let worst_px = squares.iter().fold(0.0, |worst: f64, square| worst.max(*square)).sqrt();
    rms_px.is_finite().then_some(Refit { lens: fitted, rms_px, worst_px })
}

/// A rational lens starts from no distortion: its k1 and k2 mean something only beside k4 … k6.
fn starting_coefficients(model: LensModel, coefficients: &[f64]) -> [f64; 5] {
    match (model, coefficients) {
        (LensModel::Brown, &[k1, k2, p1, p2]) => [k1, k2, p1, p2, 0.0],
        _ => [0.0; 5],
    }
}

fn grid(lens: &Lens, size: ImageSize) -> Option<Vec<(Bearing, Pixel)>> {
    const STEPS: u32 = 32;
    let along = |k: u32, length: u32| -0.5 + f64::from(k) / f64::from(STEPS) * f64::from(length);
    let pixels = (0..=STEPS).flat_map(|row| (0..=STEPS).map(move |col| (col, row)));
    pixels
        .map(|(col, row)| Pixel::new(along(col, size.width), along(row, size.height)))
        .map(|pixel| Some((lens.bearing_from_pixel(pixel)?, pixel)))
        .collect()
}

fn linearize(lens: &Lens, seen: &[(Bearing, Pixel)]) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let mut jacobian = DMatrix::zeros(2 * seen.len(), FREE.len());
    let mut residuals = DVector::zeros(2 * seen.len());
    for (k, (bearing, pixel)) in seen.iter().enumerate() {
        let direction: Vector3<f64> = bearing.into_inner();
        let projection = lens.project(&Point3::from(direction))?;
        residuals[2 * k] = projection.pixel.x - pixel.x;
        residuals[2 * k + 1] = projection.pixel.y - pixel.y;
        for (column, parameter) in FREE.iter().enumerate() {
            jacobian[(2 * k, column)] = projection.by_parameters[(0, *parameter)];
            jacobian[(2 * k + 1, column)] = projection.by_parameters[(1, *parameter)];
        }
    }
    Some((jacobian, residuals))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize::new(640, 480);

    fn brown(k3: f64) -> Lens {
        let parameters = [532.8, 532.9, 342.5, 233.9, 0.0, -0.281, 0.08, 0.0012, -0.0002, k3];
        Lens::from_parameters(LensModel::Brown, &parameters).unwrap()
    }

    #[test]
    fn a_lens_it_holds_comes_back_exactly() {
        let lens = brown(0.0);
        let refit = with_four_coefficients(&lens, SIZE).unwrap();
        assert!(refit.worst_px < 1e-9, "{}", refit.worst_px);
        for (refitted, given) in refit.lens.parameters().iter().zip(lens.parameters()) {
            assert!((refitted - given).abs() < 1e-9);
        }
    }

    #[test]
    fn the_stated_error_is_the_error() {
        let lens = brown(-0.01);
        let refit = with_four_coefficients(&lens, SIZE).unwrap();
        assert!(refit.worst_px > 1e-3 && refit.worst_px < 0.5, "{}", refit.worst_px);
        assert!(refit.rms_px < refit.worst_px);
        for pixel in [Pixel::new(-0.5, -0.5), Pixel::new(320.0, 240.0), Pixel::new(600.0, 20.0)] {
            let point = Point3::from(lens.bearing_from_pixel(pixel).unwrap().into_inner());
            assert!(
                refit.lens.pixel_from_point(&point).unwrap().distance_px(pixel)
                    <= refit.worst_px + 1e-9
            );
        }
    }
}
