//! The influence of one view on parameters, and how large the influences of all are by chance.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

/// An excess of the squared steps within this many standard deviations is attributed to chance,
/// which exceeds it seven times in a hundred. A lower limit would mix in the noisy scatter of the
/// views; a higher one would understate the covariance.
const CHANCE_STDS: f64 = 1.5;

/// At this many standard deviations beyond chance, the clustered covariance and the model's have
/// equal weight.
const EVEN_ODDS_STDS: f64 = 2.0;

/// The influence of one view on the parameters.
#[derive(Debug, Clone)]
pub(crate) struct Influence {
    /// The step of the parameters by this view: δ.
    pub(crate) step: DVector<f64>,
    /// The covariance of `step` for unit noise, with independent corners, before the estimate
    /// follows them.
    pub(crate) expected: DMatrix<f64>,
    /// The part of it that the estimate absorbs.
    pub(crate) taken_up: DMatrix<f64>,
}

impl Influence {
    /// Of a view with this `step`, whose covariance is `expected`. `inverse` is the inverse of the
    /// parameters' covariance.
    pub(crate) fn of(step: DVector<f64>, expected: DMatrix<f64>, inverse: &DMatrix<f64>) -> Self {
        let taken_up = &expected * inverse * &expected;
        Self { step, expected, taken_up }
    }

    /// The change of the estimate without the view: (1 − C A)⁻¹ δ.
    pub(crate) fn without(&self, inverse: &DMatrix<f64>) -> DVector<f64> {
        let size = self.step.len();
        let rest = DMatrix::identity(size, size) - &self.expected * inverse;
        rest.lu().solve(&self.step).unwrap_or_else(|| self.step.clone())
    }

    pub(crate) fn block(&self, block: &Range<usize>) -> Self {
        let (at, size) = (block.start, block.len());
        let of = |m: &DMatrix<f64>| m.view((at, at), (size, size)).into_owned();
        Self {
            step: self.step.rows(at, size).into_owned(),
            expected: of(&self.expected),
            taken_up: of(&self.taken_up),
        }
    }
}

/// The relative excess of the squared influences of views over those of independent corners, and
/// its standard deviation by chance.
pub(crate) struct Excess {
    pub(crate) part: f64,
    std: f64,
}

impl Excess {
    /// `None` where the parameters are not determined.
    pub(crate) fn of(
        unit: &DMatrix<f64>,
        noise_square: f64,
        influences: &[Influence],
    ) -> Option<Self> {
        let inverse = unit.clone().cholesky()?.inverse();
        let (mut seen, mut expected, mut variance) = (0.0, 0.0, 0.0);
        for influence in influences {
            let leverage = &influence.expected * &inverse;
            seen += influence.step.dot(&(&inverse * &influence.step));
            expected += leverage.trace() - influence.taken_up.dot(&inverse);
            variance += 2.0 * leverage.dot(&leverage.transpose());
        }
        let part = seen / (noise_square * expected) - 1.0;
        Some(Self { part, std: variance.sqrt() / expected })
    }

    /// The weight of the scatter between views in the covariance, from 0 to below 1; `None` where
    /// chance would explain it.
    pub(crate) fn weight(&self) -> Option<f64> {
        let beyond = self.part - CHANCE_STDS * self.std;
        (beyond > 0.0).then(|| beyond / (beyond + EVEN_ODDS_STDS * self.std))
    }
}

/// By how much an estimate would change without a view if corners were independent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LeftOutByChance {
    /// The expectation of dᵀ C⁻¹ d, where d is the change of the estimate, and C its covariance.
    pub(crate) square: f64,
    /// The variance of dᵀ C⁻¹ d.
    variance: f64,
}

impl LeftOutByChance {
    /// For a view with this influence on parameters with the information `inverse` (that of all
    /// views, for unit noise). Without the view, whose part of the information is A, the covariance
    /// grows from C to (C⁻¹ − A)⁻¹, and the difference of the two is that of the change. `None`
    /// where the view alone determines some parameter.
    pub(crate) fn of(inverse: &DMatrix<f64>, influence: &Influence) -> Option<Self> {
        let size = inverse.nrows();
        let leverage = &influence.expected * inverse;
        let growth = (DMatrix::identity(size, size) - &leverage).lu().solve(&leverage)?;
        let square = growth.trace();
        let variance = 2.0 * growth.dot(&growth.transpose());
        (square > 0.0 && variance.is_finite()).then_some(Self { square, variance })
    }

    /// The weight in the covariance of the scatter of estimates without one view each, given
    /// the sum over these views of dᵀ C⁻¹ d. 0 where chance would explain it.
    pub(crate) fn weight(views: &[Self], seen: f64) -> f64 {
        let expected: f64 = views.iter().map(|view| view.square).sum();
        let variance: f64 = views.iter().map(|view| view.variance).sum();
        let excess = Excess { part: seen / expected - 1.0, std: variance.sqrt() / expected };
        excess.weight().unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_without_a_view_scatter_as_the_covariance_says_or_count_for_more() {
        // The mean of 240 numbers in twelve equal groups: without one of these, its variance is
        // 12/11 of what it was.
        let of = |value: f64| DMatrix::from_element(1, 1, value);
        let group = Influence::of(DVector::zeros(1), of(20.0 / 240.0 / 240.0), &of(240.0));
        let by_chance = [LeftOutByChance::of(&of(240.0), &group).unwrap(); 12];
        assert!((by_chance[0].square - 1.0 / 11.0).abs() < 1e-12);
        let weight = |factor: f64| LeftOutByChance::weight(&by_chance, factor * 12.0 / 11.0);
        assert_eq!(weight(1.0), 0.0);
        let weights = [2.5, 4.0, 16.0].map(weight);
        assert!(0.0 < weights[0] && weights.is_sorted() && weights[2] > 0.9, "{weights:?}");
    }
}
