//! The coefficients of a lens that its views determine only in combination: projections are known
//! while single values are not.

use nalgebra::Point3;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};

/// The names of the coefficients whose own standard deviation moves some corner of the image
/// farther than all coefficients together do: the value of such a coefficient alone has no meaning.
/// `lens_std` is in the order of [`Lens::parameter_names`]. Corners that the model cannot project
/// with all coefficients at 0 are left out.
///
/// ```
/// use plumb::estimation::undetermined_coefficients::undetermined_coefficients;
/// use plumb::geometry::lens::{Lens, LensModel};
/// use plumb::geometry::pixel::ImageSize;
///
/// let brown = [700.0, 700.0, 320.0, 240.0, 0.0, -0.3, 0.1, 0.0, 0.0, 0.0];
/// let lens = Lens::from_parameters(LensModel::Brown, &brown).expect("ten parameters");
/// let std = [1.0, 1.0, 1.0, 1.0, 0.0, 0.01, 20.0, 1e-4, 1e-4, 60.0];
/// assert_eq!(undetermined_coefficients(&lens, &std, ImageSize::new(640, 480)), ["k2", "k3"]);
/// ```
pub fn undetermined_coefficients(
    lens: &Lens,
    lens_std: &[f64],
    size: ImageSize,
) -> Vec<&'static str> {
    let (right, bottom) = (f64::from(size.width) - 1.0, f64::from(size.height) - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
    let mut names = Lens::parameter_names(lens.model());
    let mut unknown = vec![false; names.len()];
    let mut without = lens.parameters();
    without.iter_mut().skip(Lens::FIRST_COEFFICIENT).for_each(|coefficient| *coefficient = 0.0);
    let Some(without) = Lens::from_parameters(lens.model(), &without) else { return Vec::new() };
    for (x, y) in corners {
        let seen = lens.bearing_from_pixel(Pixel::new(x, y));
        let Some(point) = seen.map(|bearing| Point3::from(bearing.into_inner())) else { continue };
        let (Some(before), Some(projection)) =
            (without.pixel_from_point(&point), lens.project(&point))
        else {
            continue;
        };
        let distortion_px = projection.pixel.distance_px(before);
        for (index, std) in
            lens_std.iter().enumerate().take(names.len()).skip(Lens::FIRST_COEFFICIENT)
        {
            let moved_px = projection.by_parameters.column(index).norm() * std;
            unknown[index] |= moved_px > distortion_px;
        }
    }
    let mut unknown = unknown.into_iter();
    names.retain(|_| unknown.next() == Some(true));
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::lens::LensModel;

    /// A webcam's lens with hardly any distortion. For `kannala_brandt`, distortion is relative to
    /// an equidistant lens, from which this one differs by much.
    #[test]
    fn a_coefficient_that_makes_a_lens_straight_is_known() {
        let parameters = [660.0, 660.0, 320.0, 240.0, 0.0, 0.48, -0.39, -5.3, 20.6];
        let lens = Lens::from_parameters(LensModel::KannalaBrandt, &parameters).unwrap();
        let std = [1.0, 1.0, 1.0, 1.0, 0.0, 0.021, 0.22, 0.9, 4.5];
        let size = ImageSize::new(640, 480);
        assert!(undetermined_coefficients(&lens, &std, size).is_empty());
        let wide = std.map(|std| 20.0 * std);
        assert_eq!(undetermined_coefficients(&lens, &wide, size), ["k2", "k3", "k4"]);
    }

    #[test]
    fn a_numerator_and_a_denominator_that_cancel_are_known_together() {
        let coefficients = [182.04, 845.81, -0.003, 0.0006, 4.59, 181.64, 795.25, 54.55];
        let parameters = [&[1047.0, 1044.0, 624.0, 512.0, 0.0], coefficients.as_slice()].concat();
        let lens = Lens::from_parameters(LensModel::Rational, &parameters).unwrap();
        let std =
            [1.1, 2.3, 0.8, 0.9, 0.0, 256.0, 1250.0, 0.0003, 0.0004, 109.0, 256.0, 1175.0, 111.0];
        let names = undetermined_coefficients(&lens, &std, ImageSize::new(1280, 1024));
        assert_eq!(names, ["k1", "k2", "k3", "k4", "k5", "k6"]);
    }
}
