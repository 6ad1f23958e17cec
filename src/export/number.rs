//! Numbers that every reader takes for floating-point numbers, with every digit of the double.

/// `value` as a decimal without exponent: YAML 1.1 readers take `1e-7` for a word, and `1` for an
/// integer.
pub(super) fn decimal(value: f64) -> String {
    let digits = value.to_string();
    if digits.contains('.') { digits } else { digits + ".0" }
}

/// Decimals with a comma and a blank between them.
pub(super) fn list(values: &[f64]) -> String {
    values.iter().map(|value| decimal(*value)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_digit_and_always_a_point() {
        assert_eq!(
            list(&[1.0, -0.000_000_1, 532.812_345_678_901_2, 0.0]),
            "1.0, -0.0000001, 532.8123456789012, 0.0"
        );
        for value in [std::f64::consts::PI, 1e-300, -7.25e17, 0.1 + 0.2] {
            assert_eq!(decimal(value).parse::<f64>().unwrap().to_bits(), value.to_bits());
        }
    }
}
