//! Real polynomials: a lens model stops being invertible at the first root of a derivative.

/// More steps than bisection needs from the widest bracket to the last bit.
const MAX_STEPS: usize = 200;

/// The value at `x` of the polynomial with `coefficients`, constant term first.
pub fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// The smallest root in (0, `end`] of the polynomial with `coefficients` (constant term first).
/// Roots are separated by those of the derivative, which are found recursively. `None` when there
/// is none, or a coefficient is not finite.
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
            found.push(root_between(coefficients, low, high));
        }
        low = high;
    }
    found
}

/// Newton's method within a bracket with a change of sign. Where a step would leave the bracket, or
/// the steps do not halve, the bracket is bisected instead: in the logarithm where the ratio of its
/// ends is large.
fn root_between(coefficients: &[f64], mut low: f64, mut high: f64) -> f64 {
    let sign = evaluate(coefficients, low).signum();
    let middle = |low: f64, high: f64| match low {
        0.0 => high * 0.01,
        low if high > 4.0 * low => (low * high).sqrt(),
        low => 0.5 * (low + high),
    };
    let (mut x, mut last) = (middle(low, high), f64::INFINITY);
    for _ in 0..MAX_STEPS {
        if x <= low || x >= high {
            return x;
        }
        let value = evaluate(coefficients, x);
        if value == 0.0 {
            return x;
        }
        if value.signum() == sign {
            low = x;
        } else {
            high = x;
        }
        let next = x - value / slope(coefficients, x);
        if (next - x).abs() <= f64::EPSILON * x {
            return next;
        }
        let shrinks = (next - x).abs() < 0.5 * last;
        let next = if shrinks && low < next && next < high { next } else { middle(low, high) };
        (last, x) = ((next - x).abs(), next);
    }
    x
}

/// The derivative at `x`.
pub fn slope(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().enumerate().skip(1).rev().fold(0.0, |sum, (k, c)| sum * x + c * k as f64)
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

    #[test]
    fn a_root_is_where_the_sign_changes_to_the_last_bits() {
        for k in 0..200 {
            let [a, b, c] = [7, 11, 13].map(|m| f64::from((k * m) % 37) / 18.0 - 1.0);
            let polynomial = [1.0, 3.0 * a, 5.0 * b, 7.0 * c];
            let Some(root) = first_root(&polynomial, 328_329.0) else { continue };
            let step = 1e-13 * root;
            let (before, after) =
                (evaluate(&polynomial, root - step), evaluate(&polynomial, root + step));
            assert!(before * after <= 0.0, "{polynomial:?}: {root}, {before} {after}");
            let earlier =
                (1..1000).map(|i| evaluate(&polynomial, root * 0.999 * f64::from(i) / 1000.0));
            assert!(earlier.into_iter().all(|value| value > 0.0), "{polynomial:?}: {root}");
        }
    }
}
