//! Whether the corners of one view fit the lens, the board and the motion that the other views show
//! without it: leave-one-out cross-validation (M. Stone, *Cross-validatory choice and assessment of
//! statistical predictions*, 1974).
//!
//! The misfit of a view is the least sum of squares over its pose and motion, with the priors that
//! the other views give for lens, board and motion. To first order in lens and board, it follows
//! from the view's own equations and from the covariance C of the other views:
//! f − gᵀ (C⁻¹ + A)⁻¹ g. Of a view that is one of those that C comes from, it is
//! f + gᵀ (C⁻¹ − A)⁻¹ g.

use std::rc::Rc;

use nalgebra::{DMatrix, DVector, Matrix6};

use crate::estimation::effects::search::EffectSearch;
use crate::estimation::effects::state::{EffectsState, Scene};
use crate::estimation::effects::system::System;
use crate::estimation::student::normal_deviations_of_ratio;
use crate::estimation::view_fault::ViewFault;

/// The misfit of a view is larger than the others' from this many standard deviations on. Chosen,
/// not swept.
const MISFIT_STDS: f64 = 3.5;

/// Of how many other views the misfit is computed: of those with the largest residuals. The largest
/// misfit is among them, since leaving a view out raises the misfits of all by similar factors.
const COMPARED_VIEWS: usize = 3;

/// One view's equations of the globals, with pose and motion eliminated.
struct LeftOutEquations {
    /// Sum of squares, including that of the motion in units of its prior.
    cost: f64,
    gradient: DVector<f64>,
    information: DMatrix<f64>,
    /// Number of residuals, less the six parameters of the pose.
    freedom: f64,
}

/// How far a view is from what the other views show.
struct LeftOutMisfit {
    /// Its sum of squares.
    square: f64,
    freedom: f64,
}

impl LeftOutMisfit {
    /// By how much it exceeds another misfit, as standard deviations of a normal distribution.
    fn excess_over(&self, other: &Self) -> f64 {
        let ratio = self.square / self.freedom / (other.square / other.freedom);
        normal_deviations_of_ratio(ratio, [self.freedom, other.freedom])
    }
}

impl EffectSearch {
    /// The fault of `view` where its misfit exceeds that of every other view. `self` is the
    /// converged search of all other views of `scene`. The comparison is with single views, and not
    /// with noise: on photographs, a view's errors depend on blur and lighting.
    pub(super) fn left_out_fault(&self, scene: Scene<'_>, view: usize) -> Option<ViewFault> {
        let basis = Rc::clone(&self.basis);
        let others: Vec<usize> =
            scene.good.iter().copied().filter(|other| *other != view).collect();
        let scene = self.restricted(Scene { good: &others, ..scene }, &basis);
        let posterior = self.posterior(scene)?;
        let (covariance, noise_square) = (posterior.covariance(), posterior.noise_square);
        let alone = [view];
        let own = Scene { good: &alone, ..scene };
        let (state, system) = self.placed(own)?;
        let equations = self.view_equations(own, &state, &system)?;
        let misfit = equations.added_to(&covariance)?;
        let largest = self
            .misfits_of_worst(scene, &covariance)?
            .into_iter()
            .max_by(|a, b| (a.square / a.freedom).total_cmp(&(b.square / b.freedom)))?;
        let excess = misfit.excess_over(&largest);
        // Not a number where nothing could be computed.
        if !(excess >= MISFIT_STDS) {
            return None;
        }
        let observation = &scene.observations[view];
        let used = || observation.used.iter().filter(|used| **used);
        let px = observation.inverse_std.iter().map(|inverse| 1.0 / inverse).sum::<f64>()
            / observation.inverse_std.len() as f64;
        let rms_px = |square: f64| (square / (2 * used().count()) as f64).sqrt() * px;
        let expected = equations.freedom + covariance.dot(&equations.information);
        Some(ViewFault::LeftOutMisfit {
            rms_px: rms_px(system.cost),
            expected_px: rms_px(expected * noise_square),
            others: others.len(),
        })
    }

    /// The misfits of the views of `scene` with the largest residuals, each by the others.
    fn misfits_of_worst(
        &self,
        scene: Scene<'_>,
        covariance: &DMatrix<f64>,
    ) -> Option<Vec<LeftOutMisfit>> {
        let mean_square = |view: &usize| {
            let used = self.system.residuals[*view]
                .iter()
                .zip(&scene.observations[*view].used)
                .filter(|(_, used)| **used);
            let (sum, count) =
                used.fold((0.0, 0.0), |(sum, n), ([x, y], _)| (sum + x * x + y * y, n + 1.0));
            sum / f64::max(count, 1.0)
        };
        let mut worst = scene.good.to_vec();
        worst.sort_by(|a, b| mean_square(b).total_cmp(&mean_square(a)));
        worst.truncate(COMPARED_VIEWS);
        let of_view = |view: usize| {
            let alone = [view];
            let own = Scene { good: &alone, ..scene };
            let system = System::at(own, &self.state)?;
            self.view_equations(own, &self.state, &system)?.taken_from(covariance)
        };
        worst.into_iter().map(of_view).collect()
    }

    /// The equations of the one view of `scene`, whose `system` is that at `state`.
    fn view_equations(
        &self,
        scene: Scene<'_>,
        state: &EffectsState,
        system: &System,
    ) -> Option<LeftOutEquations> {
        let view = system.views.first()?;
        let mut equations = LeftOutEquations {
            cost: system.cost - view.pose_decrease(),
            gradient: system.gradient.clone(),
            // The system has the lower triangle only.
            information: system.global.clone(),
            freedom: f64::max(system.residual_count as f64 - 6.0, 1.0),
        };
        equations.information.fill_upper_triangle_with_lower_triangle();
        if scene.moves {
            let lambda = self.variances.of_motion(&self.system);
            let motion = &state.motions[view.observation];
            let pull = lambda.component_mul(motion);
            let inverse = (view.motion + Matrix6::from_diagonal(&lambda)).cholesky()?.inverse();
            let gradient = view.motion_gradient + pull;
            let eliminated = &view.motion_coupling * inverse;
            equations.cost += pull.dot(motion) - gradient.dot(&(inverse * gradient));
            equations.gradient -= &eliminated * gradient;
            equations.information -= &eliminated * view.motion_coupling.transpose();
        }
        Some(equations)
    }
}

impl LeftOutEquations {
    /// The misfit where the other views alone have the covariance `of_others`.
    fn added_to(&self, of_others: &DMatrix<f64>) -> Option<LeftOutMisfit> {
        let step = self.solved(of_others, 1.0)?;
        Some(LeftOutMisfit { square: self.cost - self.gradient.dot(&step), freedom: self.freedom })
    }

    /// The misfit where all views, this one among them, have the covariance `of_all`.
    fn taken_from(&self, of_all: &DMatrix<f64>) -> Option<LeftOutMisfit> {
        let step = self.solved(of_all, -1.0)?;
        Some(LeftOutMisfit { square: self.cost + self.gradient.dot(&step), freedom: self.freedom })
    }

    /// (C⁻¹ + `sign` A)⁻¹ g, without computing C⁻¹.
    fn solved(&self, covariance: &DMatrix<f64>, sign: f64) -> Option<DVector<f64>> {
        let size = self.gradient.len();
        let all = DMatrix::identity(size, size) + covariance * &self.information * sign;
        all.lu().solve(&(covariance * &self.gradient))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(
        x: &DVector<f64>,
        information: &DMatrix<f64>,
        minimum: &DVector<f64>,
        least: f64,
    ) -> LeftOutEquations {
        let gradient = information * (x - minimum);
        LeftOutEquations {
            cost: least + gradient.dot(&(x - minimum)),
            gradient,
            information: information.clone(),
            freedom: 10.0,
        }
    }

    /// The sum of squares of a view at (3, −1) and of the others at (1, 2), at its minimum.
    #[test]
    fn a_misfit_is_the_same_from_the_other_views_and_from_all() {
        let of_others = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 3.0]);
        let of_view = DMatrix::from_row_slice(2, 2, &[2.0, -0.5, -0.5, 1.0]);
        let (other, own) = (DVector::from_vec(vec![1.0, 2.0]), DVector::from_vec(vec![3.0, -1.0]));
        let inverse = |m: &DMatrix<f64>| m.clone().try_inverse().unwrap();
        let all = &of_others + &of_view;
        let minimum = inverse(&all) * (&of_others * &other + &of_view * &own);
        let square =
            |m: &DMatrix<f64>, from: &DVector<f64>| (&minimum - from).dot(&(m * (&minimum - from)));
        let sum = 7.0 + square(&of_view, &own) + square(&of_others, &other);
        let added = at(&other, &of_view, &own, 7.0).added_to(&inverse(&of_others)).unwrap();
        let taken = at(&minimum, &of_view, &own, 7.0).taken_from(&inverse(&all)).unwrap();
        assert!((added.square - sum).abs() < 1e-12 * sum, "{} {sum}", added.square);
        assert!((taken.square - sum).abs() < 1e-12 * sum, "{} {sum}", taken.square);
    }
}
