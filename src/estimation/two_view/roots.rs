//! All real roots of a polynomial, of either sign and any size. The smallest positive root, which
//! lenses need, has its own search ([`first_root`]): it bisects in the logarithm, since its
//! brackets span many orders of magnitude, and that is not possible for roots of either sign.
//!
//! [`first_root`]: crate::geometry::polynomial::first_root

use crate::geometry::polynomial::{evaluate, slope};

/// Halvings from a bracket of length 2 to the last bit.
const HALVINGS: usize = 60;

/// The real roots of the polynomial with `coefficients` (constant term first), each once. Roots
/// without a change of sign may be missing. Those beyond ±1 are the reciprocals of the roots of the
/// polynomial with reversed coefficients.
pub(crate) fn real_roots(coefficients: &[f64]) -> Vec<f64> {
    if coefficients.iter().any(|c| !c.is_finite()) {
        return Vec::new();
    }
    let mut roots = roots_within_one(coefficients);
    let backwards: Vec<f64> = coefficients.iter().rev().copied().collect();
    let outer = roots_within_one(&backwards).into_iter().filter(|r| r.abs() < 1.0 && *r != 0.0);
    roots.extend(outer.map(|r| 1.0 / r));
    roots
}

/// The roots in [−1, 1]. They are separated by those of the derivative, which are found
/// recursively.
fn roots_within_one(coefficients: &[f64]) -> Vec<f64> {
    let degree = coefficients.iter().rposition(|c| *c != 0.0).unwrap_or(0);
    if degree == 0 {
        return Vec::new();
    }
    let derivative: Vec<f64> = (1..=degree).map(|k| coefficients[k] * k as f64).collect();
    let mut ends = roots_within_one(&derivative);
    ends.push(1.0);
    let mut found = Vec::new();
    let mut low = -1.0;
    for high in ends {
        found.extend(root_between(coefficients, low, high));
        low = high;
    }
    found.dedup();
    found
}

fn root_between(coefficients: &[f64], mut low: f64, mut high: f64) -> Option<f64> {
    let (at_low, at_high) = (evaluate(coefficients, low), evaluate(coefficients, high));
    if at_low == 0.0 {
        return Some(low);
    }
    if at_high == 0.0 {
        return Some(high);
    }
    if at_low.signum() == at_high.signum() {
        return None;
    }
    let mut x = 0.5 * (low + high);
    for _ in 0..HALVINGS {
        let value = evaluate(coefficients, x);
        if value == 0.0 {
            break;
        }
        if value.signum() == at_low.signum() {
            low = x;
        } else {
            high = x;
        }
        let newton = x - value / slope(coefficients, x);
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() < 1e-15 {
            break;
        }
        x = next;
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_small_and_large_roots() {
        let cubic = |x: f64| (x - 0.25) * (x + 0.5) * (x - 8.0);
        // x³ − 7.75 x² − 2.125 x + 1
        let mut roots_of_cubic = real_roots(&[1.0, -2.125, -7.75, 1.0]);
        roots_of_cubic.sort_by(f64::total_cmp);
        assert_eq!(roots_of_cubic.len(), 3);
        assert!(roots_of_cubic.iter().all(|x| cubic(*x).abs() < 1e-10), "{roots_of_cubic:?}");
        assert!(real_roots(&[f64::NAN, 1.0]).is_empty());
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
    }
}
