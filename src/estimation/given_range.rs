//! The values of lens parameters that may be given for images of a size. The bounds are wide:
//! images may be small crops of larger ones, and a fisheye's image a small circle in a large one.

use std::f64::consts::PI;

use crate::estimation::error::EstimationError;
use crate::estimation::problem::GivenParameter;
use crate::geometry::pixel::ImageSize;

/// The least field of view of the longer side of an image, in degrees. Chosen: a lens of 1200 mm
/// has 1.7, and an image may be a crop of one behind a telescope.
const LEAST_DEGREES: f64 = 0.01;
/// The least diameter of a circle with all directions, as a part of the image's shorter side.
/// Chosen.
const LEAST_CIRCLE: f64 = 0.25;
/// The largest distance of an image from the principal point, in sizes of the image. Chosen: a
/// hundredth of a sensor's area may be all that is read.
const MOST_SIZES: f64 = 10.0;

/// Checks that a lens may have this value.
///
/// # Errors
/// [`EstimationError::GivenValue`]: a value that is not finite, or a focal length that is not
/// positive.
pub fn check_given_value(given: &GivenParameter) -> Result<(), EstimationError> {
    let GivenParameter { name, value } = given;
    let is_focal = ["fx", "fy"].contains(&name.as_str());
    if value.is_finite() && (*value > 0.0 || !is_focal) {
        return Ok(());
    }
    Err(EstimationError::GivenValue { name: name.clone(), value: *value })
}

/// Checks that a lens for images of `size` may have the `given` values.
///
/// # Errors
/// As [`check_given_value`], and [`EstimationError::GivenRange`].
pub fn check_given_range(given: &[GivenParameter], size: ImageSize) -> Result<(), EstimationError> {
    given.iter().try_for_each(check_given_value)?;
    for GivenParameter { name, value } in given {
        let (range, why) = match name.as_str() {
            "fx" | "fy" => (focal_range(size), FOCAL),
            "cx" => (principal_range(size.width), PRINCIPAL),
            "cy" => (principal_range(size.height), PRINCIPAL),
            _ => continue,
        };
        if !(range[0]..=range[1]).contains(value) {
            let name = name.clone();
            return Err(EstimationError::GivenRange { name, value: *value, size, range, why });
        }
    }
    Ok(())
}

const FOCAL: &str = "outside this range the field of view would be below 0.01 degrees, or all directions would fit in a circle of a quarter of the image's shorter side";
const PRINCIPAL: &str =
    "the principal point is inside the image or, for a crop, at most ten image sizes outside it";

/// From the field of view: a small circle with all directions, or nearly a single direction.
fn focal_range(size: ImageSize) -> [f64; 2] {
    let [half_px, other_px] = [size.width.max(size.height), size.width.min(size.height)]
        .map(|side| 0.5 * f64::from(side));
    let least_px = LEAST_CIRCLE * other_px / PI;
    [least_px, half_px / (0.5 * LEAST_DEGREES.to_radians()).tan()]
}

/// An image may be a crop of a larger one.
fn principal_range(pixels: u32) -> [f64; 2] {
    [-MOST_SIZES * f64::from(pixels), (1.0 + MOST_SIZES) * f64::from(pixels)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shows_hardly_anything_or_lies_far_outside_is_refused() {
        let size = ImageSize { width: 640, height: 480 };
        let check = |name: &str, value| {
            check_given_range(&[GivenParameter { name: name.to_owned(), value }], size)
        };
        for (name, value) in
            [("fx", 20.0), ("fy", 1e6), ("cx", -1300.0), ("cy", -2260.0), ("k1", 1e9)]
        {
            assert_eq!(check(name, value), Ok(()), "{name}={value}");
        }
        for (name, value) in [("fx", 1e9), ("fy", 2.0), ("cx", 9999.0), ("cy", -4801.0)] {
            let line = check(name, value).unwrap_err().to_string();
            assert!(line.contains(name) && line.contains("640x480"), "{line}");
        }
        for (name, value) in [("fx", 0.0), ("fy", -5.0), ("k1", f64::NAN)] {
            let line = check(name, value).unwrap_err().to_string();
            assert!(line.starts_with(&format!("{name} cannot be {value}")), "{line}");
        }
    }
}
