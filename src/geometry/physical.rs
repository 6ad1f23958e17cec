//! The physical range of lengths, focal lengths and errors: one range for each, and a message that
//! states it.
//!
//! A number outside its range is a mistake (millimeters for meters, a missing decimal point) or
//! damage. The limits are an order of magnitude beyond what exists, so that no real value is
//! refused.

use std::ops::RangeInclusive;

/// The physical range of a quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicalRange {
    /// The name of the quantity, as in `a focal length`.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The smallest and the largest value.
    pub range: RangeInclusive<f64>,
}

/// A value outside the physical range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{} {unit} is not {quantity}: it is {} to {} {unit}", short(*value), short(*least), short(*most))]
pub struct Unphysical {
    /// The value given.
    pub value: f64,
    /// The quantity that it was given for.
    pub quantity: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The smallest possible value.
    pub least: f64,
    /// The largest possible value.
    pub most: f64,
}

/// Targets under microscopes have squares of 0.1 mm; on facades they are of meters.
pub const SQUARE_M: PhysicalRange =
    PhysicalRange { quantity: "the side of a square", unit: "m", range: 1e-5..=10.0 };

/// From the smallest image of a fisheye to 10 m of focal length over pixels of 1 µm.
pub const FOCAL_LENGTH_PX: PhysicalRange =
    PhysicalRange { quantity: "a focal length", unit: "px", range: 0.1..=1e7 };

/// A crop far off the axis of a large lens may not contain its principal point.
pub const PRINCIPAL_POINT_PX: PhysicalRange =
    PhysicalRange { quantity: "a principal point", unit: "px", range: -1e7..=1e7 };

/// No image is larger than this.
pub const RMS_PX: PhysicalRange =
    PhysicalRange { quantity: "an rms error", unit: "px", range: 0.0..=65_535.0 };

/// Cameras of one rig on one machine.
pub const TRANSLATION_M: PhysicalRange =
    PhysicalRange { quantity: "a translation", unit: "m", range: -1e5..=1e5 };

impl PhysicalRange {
    /// `value`, if it is within the range.
    ///
    /// # Errors
    /// [`Unphysical`] outside the range, and for NaN.
    pub fn check(&self, value: f64) -> Result<f64, Unphysical> {
        if self.range.contains(&value) {
            return Ok(value);
        }
        let &Self { quantity, unit, ref range } = self;
        Err(Unphysical { value, quantity, unit, least: *range.start(), most: *range.end() })
    }
}

/// A number without the hundreds of zeros that it may have in plain notation.
fn short(value: f64) -> String {
    let magnitude = value.abs();
    let plain = magnitude == 0.0 || (1e-5..1e8).contains(&magnitude);
    if plain { format!("{value}") } else { format!("{value:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_is_refused_with_the_range() {
        assert_eq!(SQUARE_M.check(0.025), Ok(0.025));
        let line = SQUARE_M.check(1e-12).unwrap_err().to_string();
        assert_eq!(line, "1e-12 m is not the side of a square: it is 0.00001 to 10 m");
        assert!(FOCAL_LENGTH_PX.check(1e308).is_err() && RMS_PX.check(-1.0).is_err());
        assert!(PRINCIPAL_POINT_PX.check(f64::NAN).is_err() && RMS_PX.check(0.0).is_ok());
    }
}
