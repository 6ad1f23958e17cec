//! The test of whether views were read by rows.

/// Whether views were read by rows rather than by columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct RollingShutterTest {
    /// The views agree that they were.
    pub(super) is_shown: bool,
    /// The probability that more views would agree, 0 to 1.
    pub(super) probability: f64,
    /// The part of their mean that is beyond chance, 0 to 1: 1 − 1 / t² where the mean is t of its
    /// own standard deviations from 0. For a true mean of δ deviations, the weight of least mean
    /// square error is δ² / (1 + δ²), and the expectation of t² − 1 is δ² (W. James, C. Stein,
    /// *Estimation with quadratic loss*, 1961, positive part).
    pub(super) agreement: f64,
}

impl RollingShutterTest {
    /// The expected root mean square error of a result that gives the model with motion the weight
    /// `agreement`, if that model is right with `probability` and the one without motion is right
    /// otherwise. In units of the difference between the two.
    pub(super) fn error(&self) -> f64 {
        let Self { probability, agreement, .. } = *self;
        let missing = probability * (1.0 - agreement).powi(2);
        (missing + (1.0 - probability) * agreement.powi(2)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_counts_in_full_or_not_at_all_errs_where_the_other_is_right() {
        let error = |agreement| {
            let shutter_test = RollingShutterTest { is_shown: false, probability: 0.75, agreement };
            shutter_test.error()
        };
        assert!((error(0.0) - f64::sqrt(0.75)).abs() < 1e-12);
        assert!((error(1.0) - 0.5).abs() < 1e-12);
        // The error is least with both models weighted by their probabilities.
        assert!((error(0.75) - f64::sqrt(0.75 * 0.25)).abs() < 1e-12);
        assert!(error(0.7) > error(0.75) && error(0.8) > error(0.75));
    }
}
