//! A corner's standard deviation as one product of named factors.

/// The factors of a corner's standard deviation. Each is 1 where its own evidence is missing.
///
/// Next to an occluder the verification also bounds the product from below
/// (`CornerThresholds::least_tight_std_px`); nothing else changes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct CornerStd {
    /// Of the fit: its covariance, with the noise of its own residuals, in pixels per axis.
    pub fit_px: f64,
    /// How much worse the corner fits than the board's others ([`super::misfit`]).
    pub misfit: f64,
    /// How much more the halves of edges differ than residuals predict, from all corners of the
    /// board ([`super::scatter`]).
    pub scatter: f64,
    /// How much more corners scatter about the board's lines than the other factors predict
    /// ([`super::straightness`]).
    pub straightness: f64,
}

impl CornerStd {
    /// The standard deviation per axis, in pixels.
    pub fn px(&self) -> f64 {
        self.scatter * self.misfit * self.fit_px * self.straightness
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_factor_scales_it() {
        let plain = CornerStd { fit_px: 0.02, misfit: 1.0, scatter: 1.0, straightness: 1.0 };
        assert_eq!(plain.px(), 0.02);
        for scaled in [
            CornerStd { misfit: 3.0, ..plain },
            CornerStd { scatter: 3.0, ..plain },
            CornerStd { straightness: 3.0, ..plain },
        ] {
            assert!((scaled.px() - 0.06).abs() < 1e-15, "{scaled:?}");
        }
    }
}
