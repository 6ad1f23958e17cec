//! Rational lenses whose denominator has a zero.

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;

/// A denominator below this is close to 0. It is 1 on the axis, and real lenses change it by a part
/// of that.
const LEAST_DENOMINATOR: f64 = 0.1;

/// Number of squared radii at which the denominator is sampled.
const POLE_STEPS: i32 = 400;

/// How far below 0 squared radii are tested, as a part of the largest one, or of 1 (45° off the
/// axis) where that is less. No pixel has such a radius, but a zero there makes a cusp at the
/// center. Equidistant, stereographic, equisolid and orthographic lenses are singular at -1 alone.
const BELOW_CENTER: f64 = 0.1;

/// Whether the denominator of a rational lens comes close to 0 somewhere in the image. Where views
/// do not determine all of its parameters, the best fit may have a numerator and a denominator of
/// huge coefficients that cancel except for a kink on a circle, which no real lens has.
pub(crate) fn has_pole(lens: &Lens, size: ImageSize) -> bool {
    let Some([_, _, _, _, _, k4, k5, k6]) = lens.distortion.as_rational() else { return false };
    let matrix = lens.matrix;
    let reach = |center: f64, length: u32| center.abs().max((f64::from(length) - center).abs());
    let farthest =
        (reach(matrix.cx, size.width) / matrix.fx).hypot(reach(matrix.cy, size.height) / matrix.fy);
    let (farthest, nearest) = (farthest * farthest, -BELOW_CENTER * farthest.min(1.0).powi(2));
    let denominator = |r2: f64| 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
    (0..=POLE_STEPS).any(|k| {
        let part = f64::from(k) / f64::from(POLE_STEPS);
        denominator(nearest + part * (farthest - nearest)) < LEAST_DENOMINATOR
    })
}

#[cfg(test)]
mod tests {
    use crate::geometry::lens::LensModel;

    use super::*;

    #[test]
    fn a_numerator_and_a_denominator_that_cancel_are_no_lens() {
        let rational = |coefficients: [f64; 8]| {
            let parameters = [&[700.0, 700.0, 319.5, 239.5, 0.0], coefficients.as_slice()].concat();
            Lens::from_parameters(LensModel::Rational, &parameters).unwrap()
        };
        let size = ImageSize::new(640, 480);
        assert!(has_pole(
            &rational([-441.3, 48612.0, 0.0, 0.0, 21670.0, -441.1, 48499.0, 34931.0]),
            size
        ));
        // A cusp at the center, 50 pixels wide.
        assert!(has_pole(&rational([195.0, 8.0, 0.0, 0.0, 0.0, 194.6, 7.9, 0.1]), size));
        assert!(!has_pole(&rational([0.34, 0.016, 0.0, 0.0, 0.0004, 0.65, 0.1, 0.002]), size));
        assert!(!has_pole(&rational([12.0, 5.0, 0.0, 0.0, 0.3, 12.3, 8.0, 1.2]), size));
        let brown = Lens::from_parameters(
            LensModel::Brown,
            &[700.0, 700.0, 319.5, 239.5, 0.0, -0.3, 0.1, 0.0, 0.0, 0.0],
        );
        assert!(!has_pole(&brown.unwrap(), size));
    }
}
