//! Numbers for people: with as many digits as their uncertainty justifies.

/// A value and its standard deviation, the latter to two significant digits and the former to the
/// same decimal place: `0.2205 ± 0.0021`.
pub fn value_with_std(value: f64, std: f64) -> String {
    // Rounded to two digits first: 0.0996 is 0.10.
    let digits = format!("{:.1e}", std.abs());
    let exponent: i32 = digits.rsplit('e').next().and_then(|e| e.parse().ok()).unwrap_or(0);
    let known = std.is_finite() && std != 0.0;
    let decimals = if known { (1 - exponent).clamp(0, MAX_DECIMALS) as usize } else { 3 };
    format!("{value:.decimals$} ± {std:.decimals$}")
}

/// Two values with `decimals` places, or with as many more as it takes for them to differ.
pub fn in_differing_digits(values: [f64; 2], decimals: usize) -> [String; 2] {
    let rounded = |decimals: usize| values.map(|value| format!("{value:.decimals$}"));
    let mut places = decimals..MAX_DECIMALS as usize;
    let differing = places.find(|decimals| rounded(*decimals)[0] != rounded(*decimals)[1]);
    rounded(differing.unwrap_or(decimals))
}

/// Further digits would only show the rounding of a double.
const MAX_DECIMALS: i32 = 12;

#[cfg(test)]
mod tests {
    use super::{in_differing_digits, value_with_std};

    #[test]
    fn what_is_compared_differs_in_its_digits() {
        assert_eq!(in_differing_digits([0.231, 0.42], 1), ["0.2", "0.4"]);
        assert_eq!(in_differing_digits([0.2304, 0.2331], 2), ["0.230", "0.233"]);
        assert_eq!(in_differing_digits([0.25, 0.25], 1), ["0.2", "0.2"]);
    }

    #[test]
    fn the_deviation_has_two_significant_digits() {
        for (value, std, said) in [
            (0.22049, 0.00213, "0.2205 ± 0.0021"),
            (0.1, 0.0996, "0.10 ± 0.10"),
            (12.345, 1.26, "12.3 ± 1.3"),
            (1234.5, 345.0, "1234 ± 345"),
            (0.5, 0.0, "0.500 ± 0.000"),
            (0.5, f64::INFINITY, "0.500 ± inf"),
        ] {
            assert_eq!(value_with_std(value, std), said);
        }
    }
}
