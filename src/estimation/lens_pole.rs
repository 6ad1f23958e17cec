//! Rational lenses whose denominator has a zero in or near the image, and the smaller ones that are
//! fitted in their place.

use crate::estimation::joint::FreeLens;
use crate::estimation::problem::{CameraOptions, GivenParameter};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;

/// The coefficients of the denominator.
const DENOMINATOR: [&str; 3] = ["k4", "k5", "k6"];

/// How many of them smaller denominators have: 1 + k4·r², and 1, which leaves the numerator of
/// `brown`.
const SMALLER_DEGREES: [usize; 2] = [1, 0];

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

/// The options of fits with smaller denominators, the largest first: coefficients beyond are held
/// at 0. None for models without a denominator, and where `options` give a coefficient of it. They
/// start from scratch: a lens whose coefficients cancel is far from any that has fewer.
///
/// Numerator and denominator of the third degree cancel over most of the image, and views that do
/// not determine all six coefficients let them cancel everywhere but at a pole.
pub(crate) fn with_smaller_denominators(
    model: LensModel,
    options: &CameraOptions,
) -> Vec<CameraOptions> {
    let is_of_it = |given: &GivenParameter| DENOMINATOR.contains(&given.name.as_str());
    if !has_denominator(model) || options.given.iter().any(is_of_it) {
        return Vec::new();
    }
    let of_degree = |degree: usize| {
        let held = DENOMINATOR[degree..].iter();
        let held = held.map(|name| GivenParameter { name: (*name).to_owned(), value: 0.0 });
        let given = options.given.iter().cloned().chain(held).collect();
        CameraOptions { given, start: None, ..options.clone() }
    };
    SMALLER_DEGREES.map(of_degree).into()
}

fn has_denominator(model: LensModel) -> bool {
    DENOMINATOR.iter().all(|name| model.coefficient_names().contains(name))
}

/// The degree of the denominator of a lens in the squared radius; `None` for models without one.
fn degree(lens: &Lens) -> Option<usize> {
    let [.., k4, k5, k6] =
        lens.distortion.as_rational().filter(|_| has_denominator(lens.model()))?;
    Some([k4, k5, k6].iter().rposition(|coefficient| *coefficient != 0.0).map_or(0, |at| at + 1))
}

/// Whether a lens is of a fit with a smaller denominator.
pub(crate) fn has_smaller_denominator(lens: &Lens) -> bool {
    degree(lens).is_some_and(|degree| SMALLER_DEGREES.contains(&degree))
}

/// `options`, with the denominator of `lens` if that is a smaller one.
pub(crate) fn with_denominator_of(lens: &Lens, options: &CameraOptions) -> Option<CameraOptions> {
    let at = SMALLER_DEGREES.iter().position(|smaller| degree(lens) == Some(*smaller))?;
    let smaller = with_smaller_denominators(lens.model(), options).into_iter().nth(at)?;
    Some(CameraOptions { start: options.start.clone(), ..smaller })
}

/// `free` without the coefficients of the denominator that the fit of `lens` left out.
pub(crate) fn as_fitted(mut free: FreeLens, lens: &Lens) -> FreeLens {
    if let Some(degree) = degree(lens).filter(|degree| SMALLER_DEGREES.contains(degree)) {
        let names = Lens::parameter_names(lens.model());
        free.free.retain(|index| !DENOMINATOR[degree..].contains(&names[*index]));
    }
    free
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smaller_denominators_hold_their_coefficients_unless_one_is_given() {
        let all = [700.0, 700.0, 319.5, 239.5, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.5, 0.2, 0.1];
        let rational = Lens::from_parameters(LensModel::Rational, &all).unwrap();
        let names = Lens::parameter_names(LensModel::Rational);
        let smaller = with_smaller_denominators(LensModel::Rational, &CameraOptions::default());
        let expected = [(1, [true, true, false, false]), (0, [true, false, false, false])];
        assert_eq!(smaller.len(), expected.len());
        for (options, (of_degree, estimated)) in smaller.iter().zip(expected) {
            let (free, held) = FreeLens::from_options(LensModel::Rational, options).unwrap();
            let is_free = ["k3", "k4", "k5", "k6"].map(|name| {
                let index = names.iter().position(|own| *own == name).unwrap();
                free.moves(index)
            });
            assert_eq!(is_free, estimated);
            let mut lens = rational;
            held.apply(&mut lens).unwrap();
            assert_eq!(degree(&lens), Some(of_degree));
            let again = with_denominator_of(&lens, &CameraOptions::default());
            assert_eq!(again.as_ref(), Some(options));
            let (whole, _) =
                FreeLens::from_options(LensModel::Rational, &CameraOptions::default()).unwrap();
            assert_eq!(as_fitted(whole, &lens), free);
        }
        assert_eq!(with_denominator_of(&rational, &CameraOptions::default()), None);

        let value = GivenParameter { name: "k6".to_owned(), value: 0.1 };
        let given = CameraOptions { given: vec![value], ..CameraOptions::default() };
        assert!(with_smaller_denominators(LensModel::Rational, &given).is_empty());
        let none = CameraOptions::default();
        assert!(with_smaller_denominators(LensModel::Brown, &none).is_empty());
    }

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
