//! Student's distribution in terms of the normal one: a mean whose standard deviation is estimated
//! from few values exceeds a given number of standard deviations more often.
//!
//! D. L. Wallace, *Bounds on normal approximations to Student's and the chi-square distributions*,
//! 1959: within 0.04 of normal deviations from three degrees of freedom on.

/// The number of standard deviations of a normal distribution with the same tail probability as a
/// mean that is `t` of its own standard deviations from 0, estimated with `freedom` degrees of
/// freedom.
pub(crate) fn normal_deviations(t: f64, freedom: f64) -> f64 {
    let freedom = freedom.max(1.0);
    let size = (freedom * (t * t / freedom).ln_1p()).sqrt();
    size.copysign(t) / stretch(freedom)
}

/// The inverse: the number of estimated standard deviations, with `freedom` degrees of freedom,
/// that has the same tail probability as `deviations` of a normal distribution.
pub(crate) fn student_deviations(deviations: f64, freedom: f64) -> f64 {
    let freedom = freedom.max(1.0);
    let size = stretch(freedom) * deviations;
    (freedom * (size * size / freedom).exp_m1()).sqrt().copysign(deviations)
}

/// The number of standard deviations of a normal distribution with the same tail probability as a
/// `ratio` of two variances that are estimated with `freedoms` degrees of freedom (E. Paulson, *An
/// approximate normalization of the analysis of variance distribution*, 1942).
pub(crate) fn normal_deviations_of_ratio(ratio: f64, freedoms: [f64; 2]) -> f64 {
    let [above, below] = freedoms.map(|freedom| 2.0 / (9.0 * freedom.max(1.0)));
    let root = ratio.max(0.0).cbrt();
    ((1.0 - below) * root - (1.0 - above)) / (below * root * root + above).sqrt()
}

fn stretch(freedom: f64) -> f64 {
    (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the tables of Student's distribution: half a percent beyond, at 3, 5, 14 and 29 degrees
    /// of freedom.
    #[test]
    fn deviations_are_as_rare_as_those_of_student_s_distribution() {
        for (freedom, t) in [(3.0, 5.841), (5.0, 4.032), (14.0, 2.977), (29.0, 2.756)] {
            let deviations = normal_deviations(t, freedom);
            assert!((deviations - 2.576).abs() < 0.04, "{freedom}: {deviations}");
            assert_eq!(normal_deviations(-t, freedom), -deviations);
            let back = student_deviations(deviations, freedom);
            assert!((back - t).abs() < 1e-9, "{freedom}: {back}");
        }
    }

    /// Of the tables of Fisher's distribution: a tenth of a percent beyond.
    #[test]
    fn a_ratio_is_as_rare_as_those_of_fisher_s_distribution() {
        for (freedoms, ratio) in [([3.0, 20.0], 8.10), ([3.0, 10.0], 12.55), ([6.0, 30.0], 5.12)] {
            let deviations = normal_deviations_of_ratio(ratio, freedoms);
            assert!((deviations - 3.09).abs() < 0.06, "{freedoms:?}: {deviations}");
        }
    }
}
