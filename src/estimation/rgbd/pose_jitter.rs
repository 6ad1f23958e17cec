//! What may be between the board's pose when color was taken and when infrared was: each view's
//! own small turn and shift (ω, τ), Gaussian about nothing (or about what the board's motion says),
//! with variances that the views themselves tell.
//!
//! The pose_jitter of a view is eliminated from its normal equations, where it takes away what they
//! cannot know: H − H_p (H_pp + Σ⁻¹)⁻¹ H_pᵀ. Its variances follow by D. MacKay's fixed point
//! (*Bayesian interpolation*, 1992): the sum of squares over the number of well determined
//! parameters.

use nalgebra::{Matrix6, Vector6};

use crate::estimation::joint::linearize::LocalEquations;
use crate::geometry::median::median;

/// Variances of the pose_jitter that all views share: of the turn about each axis in rad², of the shift
/// along each in m².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PoseJitter {
    pub(super) turn: f64,
    pub(super) shift: f64,
}

/// A variance that stands for none.
const NONE: f64 = 1e-16;

/// By how much a variance must make what was seen likelier, as a natural logarithm, to be taken for
/// more than chance: of views without any pose_jitter, about one set in forty shows as much (half a χ² of
/// one, at the edge of what a variance can be: S. Self and K.-Y. Liang, *Asymptotic properties of
/// maximum likelihood estimators under nonstandard conditions*, 1987).
const LEAST_GAIN: f64 = 2.0;

impl PoseJitter {
    /// With what a view's own motion adds.
    pub(super) fn covariance(self, motion: &[f64; 6]) -> Vector6<f64> {
        let of = |k: usize| motion[k..k + 3].iter().map(|m| m * m).sum::<f64>() / 3.0;
        let (turn, shift) = (self.turn + of(0), self.shift + of(3));
        Vector6::new(turn, turn, turn, shift, shift, shift)
    }

    /// From the middle of how far views are apart: a start that a third of wrong ones do not spoil.
    pub(super) fn of_middle(apart: &[Apart]) -> Self {
        const MEDIAN_OF_THREE: f64 = 2.366;
        let middle = |from: usize| {
            let squares =
                apart.iter().map(|a| a.apart.fixed_rows::<3>(from).norm_squared()).collect();
            (median(squares).unwrap_or(0.0) / MEDIAN_OF_THREE).max(NONE)
        };
        Self { turn: middle(0), shift: middle(3) }
    }

    /// The next, by the views that take part.
    #[expect(clippy::needless_pass_by_value, reason = "an iterator is for its one reader")]
    pub(super) fn next<'a>(self, apart: impl Iterator<Item = &'a Apart> + Clone) -> Self {
        let of = |from: usize, variance: f64| {
            // Three numbers of the sensors' pose were fitted to the same views.
            let (mut squares, mut determined) = (0.0, -3.0);
            for view in apart.clone() {
                let own = view.pose_jitter.fixed_rows::<3>(from).norm_squared();
                let prior = view.prior.fixed_rows::<3>(from).sum() / 3.0;
                let left =
                    (0..3).map(|k| view.posterior[(from + k, from + k)] / prior).sum::<f64>();
                // What the view's own motion explains is not shared by all.
                squares += own * variance / prior;
                determined += (3.0 - left).max(0.0);
            }
            if determined <= 0.0 { variance } else { (squares / determined).clamp(NONE, 1.0) }
        };
        Self { turn: of(0, self.turn), shift: of(3, self.shift) }.where_shown(&apart, self)
    }

    /// Without what the views do not show: a variance that only followed chance would make the
    /// sensors' pose look less certain than it is. `held` are the variances that the views' own
    /// spread was told with.
    fn where_shown<'a>(
        mut self,
        apart: &(impl Iterator<Item = &'a Apart> + Clone),
        held: Self,
    ) -> Self {
        let likelihood = |pose_jitter: Self| -> f64 {
            let (turn, shift) = (pose_jitter.turn - held.turn, pose_jitter.shift - held.shift);
            apart.clone().map(|view| view.likelihood(turn, shift)).sum()
        };
        if likelihood(self) - likelihood(Self { turn: NONE, ..self }) < LEAST_GAIN {
            self.turn = NONE;
        }
        if likelihood(self) - likelihood(Self { shift: NONE, ..self }) < LEAST_GAIN {
            self.shift = NONE;
        }
        self
    }

    pub(super) fn is_near(self, other: Self) -> bool {
        let near = |a: f64, b: f64| (a / b).ln().abs() < 0.05 || a.max(b) < 1e-13;
        near(self.turn, other.turn) && near(self.shift, other.shift)
    }
}

/// How far apart color and infrared see the board in one view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Apart {
    /// As infrared alone says, in the infrared camera's frame.
    pub(super) apart: Vector6<f64>,
    /// What is likely of it, with the pose_jitter's own variances.
    pub(super) pose_jitter: Vector6<f64>,
    pub(super) prior: Vector6<f64>,
    pub(super) posterior: Matrix6<f64>,
    /// What corners alone leave open of it.
    measured: Matrix6<f64>,
    /// How unlikely: a χ² with six degrees of freedom.
    pub(super) surprise: f64,
}

impl Apart {
    /// From infrared's equations (its pose's square and gradient), what color says of the pose in
    /// infrared's frame, and the pose_jitter's variances.
    pub(super) fn of(
        (square, gradient): (&Matrix6<f64>, &Vector6<f64>),
        by_color: &Matrix6<f64>,
        prior: Vector6<f64>,
    ) -> Option<Self> {
        let own = square.cholesky()?;
        let apart = -own.solve(gradient);
        let precision = Matrix6::from_diagonal(&prior.map(|variance| 1.0 / variance));
        let pose_jitter = -(square + precision).cholesky()?.solve(gradient);
        let measured = own.inverse() + by_color;
        let posterior = (precision + measured.cholesky()?.inverse()).cholesky()?.inverse();
        let spread = measured + Matrix6::from_diagonal(&prior);
        let surprise = apart.dot(&spread.cholesky()?.solve(&apart));
        Some(Self { apart, pose_jitter, prior, posterior, measured, surprise })
    }

    /// The logarithm of how likely it is, up to a constant, with variances of turn and shift that
    /// are larger than the prior's.
    fn likelihood(&self, turn: f64, shift: f64) -> f64 {
        let more = Vector6::new(turn, turn, turn, shift, shift, shift);
        let prior = (self.prior + more).map(|variance| variance.max(NONE));
        let Some(factor) = (self.measured + Matrix6::from_diagonal(&prior)).cholesky() else {
            return f64::NEG_INFINITY;
        };
        let logarithm: f64 = factor.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum();
        -logarithm - 0.5 * self.apart.dot(&factor.solve(&self.apart))
    }
}

/// Takes from an observation's equations what a pose_jitter with these variances leaves open.
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

/// A observation's equations for the board's pose: square and gradient.
pub(super) fn pose_part(local: &LocalEquations) -> (Matrix6<f64>, Vector6<f64>) {
    let (residual, pose) = (local.columns - 1, local.columns - 7);
    let square = Matrix6::from_fn(|a, b| local.product(pose + a, pose + b));
    (square, Vector6::from_fn(|a, _| local.product(pose + a, residual)))
}
