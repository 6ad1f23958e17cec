//! Real polynomials: where a lens model stops being invertible is the first root of a derivative.

/// The value at `x` of the polynomial with `coefficients`, constant term first.
pub fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// The smallest root in (0, `end`] of the polynomial with `coefficients` (constant term first), by bisection between the
/// roots of its derivative, found the same way. `None` when there is none, or a coefficient is not finite.
pub fn first_root(coefficients: &[f64], end: f64) -> Option<f64> {
    roots(coefficients, end).first().copied()
}

fn roots(coefficients: &[f64], end: f64) -> Vec<f64> {
    let degree = coefficients.iter().rposition(|c| *c != 0.0).unwrap_or(0);
    if degree == 0 || coefficients.iter().any(|c| !c.is_finite()) {
        return Vec::new();
    }
    let derivative: Vec<f64> = (1..=degree).map(|k| coefficients[k] * k as f64).collect();
    let mut ends = roots(&derivative, end);
    ends.push(end);
    let mut found = Vec::new();
    let mut low = 0.0;
    for high in ends {
        let (at_low, at_high) = (evaluate(coefficients, low), evaluate(coefficients, high));
        if at_high == 0.0 {
            found.push(high);
        } else if at_low != 0.0 && at_low.signum() != at_high.signum() {
            found.push(bisect(coefficients, low, high));
        }
        low = high;
    }
    found
}

fn bisect(coefficients: &[f64], mut low: f64, mut high: f64) -> f64 {
    let sign = evaluate(coefficients, low).signum();
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return middle;
        }
        if evaluate(coefficients, middle).signum() == sign { low = middle } else { high = middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_first_of_several_roots() {
        // (x − 1)(x − 2)(x − 5)
        assert!((first_root(&[-10.0, 17.0, -8.0, 1.0], 10.0).unwrap() - 1.0).abs() < 1e-12);
        assert!(first_root(&[-10.0, 17.0, -8.0, 1.0], 0.5).is_none());
        assert!(first_root(&[1.0, 0.0, 1.0], 100.0).is_none());
        assert!(first_root(&[f64::NAN, 1.0], 100.0).is_none());
    }
}
