//! What the readings of depth images mean, as a metadata record of an MCAP file: no schema of
//! Foxglove's has it.

use std::collections::BTreeMap;

use crate::geometry::depth_camera::DepthReading;
use crate::imaging::depth_encoding::DepthEncoding;

/// The record's name.
pub(super) const DEPTH_ENCODING: &str = "plumb.depth_encoding";

/// `unit_m` of metric depth, or `offset` and `slope` of disparity, and the reading that means none.
pub(super) fn entries(encoding: &DepthEncoding) -> BTreeMap<String, String> {
    let reading = match encoding.reading {
        Some(DepthReading::Metric { unit_m }) => vec![("unit_m", unit_m)],
        Some(DepthReading::Disparity { offset, slope }) => {
            vec![("offset", offset), ("slope", slope)]
        }
        None => Vec::new(),
    };
    let numbers = reading.into_iter().map(|(name, value)| (name.to_owned(), value.to_string()));
    let invalid = encoding.invalid.map(|value| ("invalid".to_owned(), value.to_string()));
    numbers.chain(invalid).collect()
}

/// The same read back; `None` for numbers that cannot be.
pub(super) fn encoding(entries: &BTreeMap<String, String>) -> Option<DepthEncoding> {
    let number = |name: &str| {
        let value =
            entries.get(name).map(|text| text.parse::<f64>().ok().filter(|v| v.is_finite()));
        value.map_or(Some(None), |value| value.map(Some))
    };
    let reading = match (number("unit_m")?, number("offset")?, number("slope")?) {
        (Some(unit_m), None, None) if unit_m > 0.0 => Some(DepthReading::Metric { unit_m }),
        (None, Some(offset), Some(slope)) => Some(DepthReading::Disparity { offset, slope }),
        (None, None, None) => None,
        _ => return None,
    };
    let invalid = entries.get("invalid").map(|text| text.parse()).transpose().ok()?;
    Some(DepthEncoding { reading, invalid })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoding_survives_and_nonsense_is_none() {
        for written in [
            DepthEncoding::metric(1e-4),
            DepthEncoding::metric(0.1 / 3.0),
            DepthEncoding {
                reading: Some(DepthReading::Disparity { offset: 3.09, slope: -0.002_85 }),
                invalid: Some(2047),
            },
            DepthEncoding { reading: None, invalid: None },
        ] {
            assert_eq!(encoding(&entries(&written)), Some(written));
        }
        for (name, value) in
            [("unit_m", "-1"), ("unit_m", "inf"), ("offset", "1"), ("invalid", "70000")]
        {
            let entries = BTreeMap::from([(name.to_owned(), value.to_owned())]);
            assert_eq!(encoding(&entries), None, "{name} {value}");
        }
    }
}
