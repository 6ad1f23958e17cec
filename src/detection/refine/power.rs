//! Powers of positive numbers without a branch, so that a loop over them is compiled to vectors.

use std::f64::consts::{FRAC_1_SQRT_2, LN_2};

/// The bits of 1.0: an exponent and no mantissa.
const ONE: u64 = 1.0_f64.to_bits();
/// Bits of the mantissa.
const MANTISSA: u32 = 52;
/// From here on, numbers are integers: the last bit counts ones.
const WHOLE: f64 = (1_u64 << MANTISSA) as f64;
/// Adding and subtracting this rounds a number; the last bits count ones for negative numbers too.
const ROUNDING: f64 = 1.5 * WHOLE;

/// x^p of a positive x that is not subnormal, where the result is neither; to 1e-9 of it where
/// |p| ≤ 1.
///
/// log₂ of the mantissa by the series of artanh, 2^f by that of exp (M. Abramowitz, I. Stegun,
/// *Handbook of Mathematical Functions*, 1964, 4.1.27 and 4.2.1).
#[inline(always)]
pub(super) fn power(x: f64, p: f64) -> f64 {
    // x = m 2^e with m from √½ to √2.
    let from_least = x.to_bits().wrapping_sub(FRAC_1_SQRT_2.to_bits()).wrapping_add(ONE);
    let exponent = from_least >> MANTISSA;
    let e = f64::from_bits(WHOLE.to_bits() | exponent) - WHOLE - 1023.0;
    let m = f64::from_bits(x.to_bits().wrapping_sub(exponent << MANTISSA).wrapping_add(ONE));
    let s = (m - 1.0) / (m + 1.0);
    let s2 = s * s;
    let series = 1.0 + s2 * (1.0 / 3.0 + s2 * (0.2 + s2 * (1.0 / 7.0 + s2 * (1.0 / 9.0))));
    let log2 = e + s * series * (2.0 / LN_2);
    let rounded = p * log2 + ROUNDING;
    let f = (p * log2 - (rounded - ROUNDING)) * LN_2;
    let exp = (1..=8).rev().fold(1.0, |sum, k| 1.0 + sum * f / f64::from(k));
    f64::from_bits(exp.to_bits().wrapping_add(rounded.to_bits() << MANTISSA))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_power_to_a_billionth() {
        for p in [1.0 / 3.0, 1.0 / 2.2, 0.5, 0.9, 1.0, -0.7] {
            for step in 0..20_000 {
                let x = 2.0_f64.powf(f64::from(step) / 1000.0 - 14.0);
                let off = power(x, p) / x.powf(p) - 1.0;
                assert!(off.abs() < 1e-9, "{x}^{p} is off by {off:e} of it");
            }
        }
    }
}
