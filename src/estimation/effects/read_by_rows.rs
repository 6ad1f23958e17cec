//! What views say of whether they were read by rows.

/// Whether views were read by rows rather than by columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct ReadByRows {
    /// They agree on it.
    pub(super) is_shown: bool,
    /// How likely it is that more views would agree on it, 0 to 1.
    pub(super) probability: f64,
    /// The part of what they agree on that is beyond chance, 0 to 1: 1 − 1 / t² of a mean that is t
    /// of its own standard deviations from 0. The weight of least mean square error is
    /// δ² / (1 + δ²) for a true mean of δ deviations, and t² − 1 is δ² in the mean (W. James,
    /// C. Stein, *Estimation with quadratic loss*, 1961, its positive part).
    pub(super) agreement: f64,
}

impl ReadByRows {
    /// The root of the mean square error of a result in which the motion counts as `agreement`, of
    /// two of which the one with a rolling shutter is right with `probability`, in units of how far
    /// they differ.
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
            let by_rows = ReadByRows { is_shown: false, probability: 0.75, agreement };
            by_rows.error()
        };
        assert!((error(0.0) - f64::sqrt(0.75)).abs() < 1e-12);
        assert!((error(1.0) - 0.5).abs() < 1e-12);
        // The least error is that of the mean of both, each as it is likely.
        assert!((error(0.75) - f64::sqrt(0.75 * 0.25)).abs() < 1e-12);
        assert!(error(0.7) > error(0.75) && error(0.8) > error(0.75));
    }
}
