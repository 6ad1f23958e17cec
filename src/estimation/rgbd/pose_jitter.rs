//! Pose jitter: the board's motion between the exposures of color and of infrared. Each view has
//! its own small rotation and translation (ω, τ), Gaussian about zero (or about the board's
//! estimated motion), with variances estimated from all views.
//!
//! The pose jitter of a view is eliminated from its normal equations by the Schur complement H −
//! H_p (H_pp + Σ⁻¹)⁻¹ H_pᵀ. Its variances follow by D. MacKay's fixed point (*Bayesian
//! interpolation*, 1992): the sum of squares over the number of well determined parameters.

use nalgebra::{Matrix6, Vector6};

use crate::estimation::joint::linearize::LocalEquations;
use crate::geometry::median::median;

/// Variances of the pose jitter, common to all views: of the rotation about each axis in rad², of
/// the translation along each in m².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PoseJitter {
    pub(super) rotation: f64,
    pub(super) translation: f64,
}

/// The variance that means no pose jitter.
const NO_JITTER_VARIANCE: f64 = 1e-16;

/// The least gain in log-likelihood by which a variance counts as more than chance. Of sets of
/// views without pose jitter, about one in forty gains as much (half a χ² of one degree of freedom,
/// since a variance of zero is on the boundary: S. Self and K.-Y. Liang, *Asymptotic properties of
/// maximum likelihood estimators under nonstandard conditions*, 1987).
const LEAST_GAIN: f64 = 2.0;

impl PoseJitter {
    /// The variances for one view, to which its own `motion` adds.
    pub(super) fn covariance(self, motion: &[f64; 6]) -> Vector6<f64> {
        let of = |k: usize| motion[k..k + 3].iter().map(|m| m * m).sum::<f64>() / 3.0;
        let (rotation, translation) = (self.rotation + of(0), self.translation + of(3));
        Vector6::new(rotation, rotation, rotation, translation, translation, translation)
    }

    /// From the medians of the views' differences: a start that tolerates a third of outliers.
    pub(super) fn of_middle(differences: &[PoseDifference]) -> Self {
        const MEDIAN_OF_THREE: f64 = 2.366;
        let middle = |from: usize| {
            let squares = differences
                .iter()
                .map(|one| one.difference.fixed_rows::<3>(from).norm_squared())
                .collect();
            (median(squares).unwrap_or(0.0) / MEDIAN_OF_THREE).max(NO_JITTER_VARIANCE)
        };
        Self { rotation: middle(0), translation: middle(3) }
    }

    /// The next estimate, from the inlier views.
    #[expect(clippy::needless_pass_by_value, reason = "an iterator is for its one reader")]
    pub(super) fn next<'a>(
        self,
        differences: impl Iterator<Item = &'a PoseDifference> + Clone,
    ) -> Self {
        let of = |from: usize, variance: f64| {
            // Three parameters of the sensors' pose were fitted to the same views.
            let (mut squares, mut determined) = (0.0, -3.0);
            for view in differences.clone() {
                let own = view.pose_jitter.fixed_rows::<3>(from).norm_squared();
                let prior = view.prior.fixed_rows::<3>(from).sum() / 3.0;
                let left =
                    (0..3).map(|k| view.posterior[(from + k, from + k)] / prior).sum::<f64>();
                // The part that the view's own motion explains is not common to all views.
                squares += own * variance / prior;
                determined += (3.0 - left).max(0.0);
            }
            if determined <= 0.0 {
                variance
            } else {
                (squares / determined).clamp(NO_JITTER_VARIANCE, 1.0)
            }
        };
        Self { rotation: of(0, self.rotation), translation: of(3, self.translation) }
            .where_shown(&differences, self)
    }

    /// Sets to none the variances that are not significant: a variance that only fitted chance
    /// would make the sensors' pose appear less certain than it is. `held` are the variances with
    /// which the views' priors were computed.
    fn where_shown<'a>(
        mut self,
        differences: &(impl Iterator<Item = &'a PoseDifference> + Clone),
        held: Self,
    ) -> Self {
        let likelihood = |pose_jitter: Self| -> f64 {
            let (rotation, translation) =
                (pose_jitter.rotation - held.rotation, pose_jitter.translation - held.translation);
            differences.clone().map(|view| view.likelihood(rotation, translation)).sum()
        };
        if likelihood(self) - likelihood(Self { rotation: NO_JITTER_VARIANCE, ..self }) < LEAST_GAIN
        {
            self.rotation = NO_JITTER_VARIANCE;
        }
        if likelihood(self) - likelihood(Self { translation: NO_JITTER_VARIANCE, ..self })
            < LEAST_GAIN
        {
            self.translation = NO_JITTER_VARIANCE;
        }
        self
    }

    /// Whether the views show none.
    pub(super) fn is_none(self) -> bool {
        self.rotation <= NO_JITTER_VARIANCE && self.translation <= NO_JITTER_VARIANCE
    }

    pub(super) fn is_near(self, other: Self) -> bool {
        let near = |a: f64, b: f64| (a / b).ln().abs() < 0.05 || a.max(b) < 1e-13;
        near(self.rotation, other.rotation) && near(self.translation, other.translation)
    }
}

/// A board's pose from color's corners alone, in the infrared camera's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseByColor {
    /// The step to it from the pose of the state.
    pub(super) step: Vector6<f64>,
    pub(super) covariance: Matrix6<f64>,
}

/// The difference of color's and infrared's board pose in one view, in the infrared camera's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseDifference {
    /// The step from the state's pose to that from infrared's corners alone.
    pub(super) by_infrared: Vector6<f64>,
    /// The step from the pose by color's corners alone to that by infrared's alone. The state's
    /// pose is between them where the view's infrared image is in use.
    difference: Vector6<f64>,
    /// The posterior mean of the difference under the pose jitter's variances.
    pub(super) pose_jitter: Vector6<f64>,
    pub(super) prior: Vector6<f64>,
    pub(super) posterior: Matrix6<f64>,
    /// The covariance of `difference` from the corners' noise alone.
    measured: Matrix6<f64>,
    /// The squared Mahalanobis length of `difference`: χ² with six degrees of freedom.
    pub(super) surprise: f64,
}

impl PoseDifference {
    /// From infrared's equations (the pose's block and gradient), color's estimate of the pose, and
    /// the pose jitter's variances.
    pub(super) fn of(
        square: &Matrix6<f64>,
        gradient: &Vector6<f64>,
        by_color: &PoseByColor,
        prior: Vector6<f64>,
    ) -> Option<Self> {
        let own = square.cholesky()?;
        let by_infrared = -own.solve(gradient);
        let precision = Matrix6::from_diagonal(&prior.map(|variance| 1.0 / variance));
        let pose_jitter = -(square + precision).cholesky()?.solve(gradient);
        let difference = by_infrared - by_color.step;
        let measured = own.inverse() + by_color.covariance;
        let posterior = (precision + measured.cholesky()?.inverse()).cholesky()?.inverse();
        let covariance = measured + Matrix6::from_diagonal(&prior);
        let surprise = difference.dot(&covariance.cholesky()?.solve(&difference));
        Some(Self { by_infrared, difference, pose_jitter, prior, posterior, measured, surprise })
    }

    /// The log-likelihood of `difference`, up to a constant, with these variances added to the
    /// prior's.
    fn likelihood(&self, rotation: f64, translation: f64) -> f64 {
        let more =
            Vector6::new(rotation, rotation, rotation, translation, translation, translation);
        let prior = (self.prior + more).map(|variance| variance.max(NO_JITTER_VARIANCE));
        let Some(factor) = (self.measured + Matrix6::from_diagonal(&prior)).cholesky() else {
            return f64::NEG_INFINITY;
        };
        let logarithm: f64 = factor.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum();
        -logarithm - 0.5 * self.difference.dot(&factor.solve(&self.difference))
    }
}

/// Eliminates a pose jitter with these variances from an observation's equations.
pub(super) fn eliminate(local: &mut LocalEquations, variances: &Vector6<f64>) -> Option<()> {
    let (square, gradient) = pose_part(local);
    let precision = Matrix6::from_diagonal(&variances.map(|variance| 1.0 / variance));
    let inverse = (square + precision).cholesky()?.inverse();
    local.cost -= gradient.dot(&(inverse * gradient));
    let (columns, pose) = (local.columns, local.columns - 7);
    let coupled: Vec<Vector6<f64>> =
        (0..columns).map(|i| Vector6::from_fn(|a, _| local.product(i, pose + a))).collect();
    for i in 0..columns {
        let through = inverse * coupled[i];
        for (j, other) in coupled.iter().enumerate().skip(i) {
            local.products[i * columns + j] -= through.dot(other);
        }
    }
    Some(())
}

/// An observation's equations for the board's pose: block and gradient.
pub(super) fn pose_part(local: &LocalEquations) -> (Matrix6<f64>, Vector6<f64>) {
    let (residual, pose) = (local.columns - 1, local.columns - 7);
    let square = Matrix6::from_fn(|a, b| local.product(pose + a, pose + b));
    (square, Vector6::from_fn(|a, _| local.product(pose + a, residual)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The joint pose from color and infrared is between the poses from each alone. The difference
    /// of these two does not depend on it.
    #[test]
    fn a_difference_is_that_of_both_poses_alone() {
        let by_color = Vector6::new(0.0, 1.0, -2.0, 0.5, 0.0, 3.0);
        let alone = Vector6::new(1.0, -1.0, 0.5, 2.0, -4.0, 1.0);
        let square = Matrix6::from_fn(|i, j| if i == j { 4.0 + i as f64 } else { 0.5 });
        let covariance = Matrix6::from_fn(|i, j| if i == j { 0.3 } else { 0.02 });
        let prior = Vector6::from_fn(|i, _| 0.1 + 0.1 * i as f64);
        let of_infrared = square.try_inverse().unwrap() + Matrix6::from_diagonal(&prior);
        let weights = [covariance, of_infrared].map(|of| of.try_inverse().unwrap());
        let together = (weights[0] + weights[1]).try_inverse().unwrap()
            * (weights[0] * by_color + weights[1] * alone);
        let of = |pose: Vector6<f64>| {
            let gradient = square * (pose - alone);
            let by_color = PoseByColor { step: by_color - pose, covariance };
            PoseDifference::of(&square, &gradient, &by_color, prior).unwrap()
        };
        let difference = alone - by_color;
        for pose in [together, by_color] {
            assert!((of(pose).difference - difference).norm() < 1e-9);
        }
        let (joint, measured) = (of(together), square.try_inverse().unwrap() + covariance);
        let expected = Matrix6::from_diagonal(&prior)
            * (measured + Matrix6::from_diagonal(&prior)).try_inverse().unwrap()
            * difference;
        assert!((joint.pose_jitter - expected).norm() < 1e-9, "{}", joint.pose_jitter);
    }
}
