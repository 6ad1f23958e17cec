//! Times in documents: UTC, RFC 3339.

use jiff::Timestamp;

/// A moment from nanoseconds since the Unix epoch.
pub fn from_utc_ns(utc_ns: i64) -> Timestamp {
    // All of i64's nanoseconds, 1677 to 2262, lie inside a timestamp's range of years -9999 to
    // 9999.
    Timestamp::from_nanosecond(i128::from(utc_ns)).unwrap_or_default()
}

/// Nanoseconds since the Unix epoch; moments outside 1677 to 2262 are held at those ends.
pub fn utc_ns(moment: Timestamp) -> i64 {
    moment.as_nanosecond().clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nanoseconds_survive() {
        for ns in [i64::MIN, -1, 0, 1_770_000_000_123_456_789, i64::MAX] {
            let text = from_utc_ns(ns).to_string();
            assert!(text.ends_with('Z'), "{text}");
            assert_eq!(utc_ns(text.parse().unwrap()), ns);
        }
    }
}
