//! The normal distribution.

/// The probability that a normal deviate of mean `mean` and variance 1 is above 0.
pub(crate) fn normal_probability(mean: f64) -> f64 {
    0.5 * libm::erfc(-mean * std::f64::consts::FRAC_1_SQRT_2)
}
