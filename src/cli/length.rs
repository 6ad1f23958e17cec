//! Lengths as people give them: a number with its unit.

use std::str::FromStr;

/// A length given on the command line. A number without a unit is refused: 25 could be millimeters
/// or meters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// In meters.
    pub meters: f64,
}

/// A length that is not a number with a unit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not a length with its unit: write it as in 25mm, 2.5cm, 0.025m or 1in")]
pub struct NotALength {
    text: String,
}

impl FromStr for Length {
    type Err = NotALength;
    fn from_str(text: &str) -> Result<Self, NotALength> {
        const UNITS: [(&str, f64); 6] =
            [("mm", 1e3), ("cm", 1e2), ("um", 1e6), ("µm", 1e6), ("in", 1.0 / 0.0254), ("m", 1.0)];
        let not_a_length = || NotALength { text: text.to_owned() };
        let (number, per_meter) = UNITS
            .iter()
            .find_map(|(unit, per_meter)| Some((text.trim().strip_suffix(unit)?, per_meter)))
            .ok_or_else(not_a_length)?;
        let number: f64 = number.trim().parse().map_err(|_| not_a_length())?;
        // Divided, not multiplied: 25 / 1000 is the double nearest to 0.025, while 25 · 0.001 may
        // not be.
        let meters = number / per_meter;
        if meters.is_finite() && meters > 0.0 { Ok(Self { meters }) } else { Err(not_a_length()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_and_refusals() {
        for (text, meters) in [
            ("25mm", 0.025),
            ("2.5 cm", 0.025),
            ("0.025m", 0.025),
            ("1in", 0.0254),
            ("3.45um", 3.45e-6),
        ] {
            let length: Length = text.parse().unwrap();
            assert!((length.meters - meters).abs() < 1e-15, "{text}: {}", length.meters);
        }
        for text in ["25", "mm", "-1mm", "0m", "nanmm", "infm", "", "25 feet"] {
            assert!(text.parse::<Length>().is_err(), "{text}");
        }
    }
}
