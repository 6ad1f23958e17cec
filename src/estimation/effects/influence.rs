//! The influence of each view on the lens where the board's shape and motion are estimated too, and
//! by how much the lens would change without the view.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DMatrixView, DVector, Dyn, Vector6};

use crate::estimation::effects::state::{EffectsState, Scene};
use crate::estimation::effects::view_columns::ViewColumns;
use crate::estimation::joint::linearize::{
    Columns, LinearizationPoint, LinearizedObservation, LocalEquations, differentiate_observation,
};
use crate::estimation::robust::Loss;
use crate::estimation::view_influence::Influence;

/// The largest number of views whose influence is computed.
const MAX_INFLUENCES: usize = 60;

/// Steps of conjugate gradients. A few suffice: the equations without a view differ from those with
/// it in a few directions only.
const MAX_STEPS: usize = 30;

/// The part of the residual's initial square at which conjugate gradients end.
const SOLVED_PART: f64 = 1e-6;

/// One view's Jacobian at a state, its pose and motion to be eliminated.
pub(super) struct ViewJacobian<'a> {
    columns: ViewColumns<'a>,
    values: Vec<f64>,
    /// Derivatives by a displacement of each corner along the board's x and y.
    in_plane: [Vec<f64>; 2],
    /// Factor of the block of the pose, and of the motion where there is one.
    local_square: Cholesky<f64, Dyn>,
    /// The gradient by the same parameters.
    local_gradient: DVector<f64>,
    first_local: usize,
}

/// The Jacobians of the views in use, or of an evenly spaced sample where there are many;
/// `of_motion` is λ of a motion where there is one.
pub(super) fn view_jacobians<'a>(
    scene: Scene<'a>,
    state: &EffectsState,
    of_motion: Option<Vector6<f64>>,
) -> Vec<ViewJacobian<'a>> {
    let offsets = scene.basis.offsets(&state.shape);
    let (mut columns, mut local) = (Columns::default(), LocalEquations::default());
    let some = scene.good.iter().step_by(scene.good.len().div_ceil(MAX_INFLUENCES).max(1));
    let of_view = |index: &usize| {
        let seen = state.moved_observation(scene, &offsets, *index);
        let mut residuals = vec![[0.0; 2]; seen.points.len()];
        let at = LinearizationPoint { layout: scene.layout, state: &state.fixed };
        let into = LinearizedObservation { residuals: &mut residuals, local: &mut local };
        if !differentiate_observation(at, &seen, Loss::Squares, &mut columns, into) {
            return None;
        }
        let rotation = state.fixed.rig_from_board[seen.frame_set].rotation_matrix();
        let of_view = ViewColumns::of(scene, &seen, *index);
        let mut values = Vec::new();
        let in_plane = of_view.fill(&rotation, &seen, columns.values(), &mut values);
        let pull = of_motion.map(|lambda| (lambda, lambda.component_mul(&state.motions[*index])));
        ViewJacobian::of(of_view, values, in_plane, pull)
    };
    some.filter_map(of_view).collect()
}

impl<'a> ViewJacobian<'a> {
    fn of(
        columns: ViewColumns<'a>,
        values: Vec<f64>,
        in_plane: [Vec<f64>; 2],
        of_motion: Option<(Vector6<f64>, Vector6<f64>)>,
    ) -> Option<Self> {
        let all = DMatrixView::from_slice(&values, columns.rows, columns.count());
        let first_local = if of_motion.is_some() { columns.motion() } else { columns.pose() };
        let locals = all.columns(first_local, columns.residual() - first_local);
        let mut square = locals.transpose() * locals;
        let mut local_gradient = locals.transpose() * all.column(columns.residual());
        for (k, (lambda, pull)) in
            of_motion.iter().flat_map(|(lambda, pull)| lambda.iter().zip(pull)).enumerate()
        {
            square[(k, k)] += lambda;
            local_gradient[k] += pull;
        }
        let local_square = square.cholesky()?;
        Some(Self { columns, values, in_plane, local_square, local_gradient, first_local })
    }

    fn all(&self) -> DMatrixView<'_, f64> {
        self.some(0..self.columns.count())
    }

    fn some(&self, which: Range<usize>) -> DMatrixView<'_, f64> {
        let rows = self.columns.rows;
        DMatrixView::from_slice(
            &self.values[which.start * rows..which.end * rows],
            rows,
            which.len(),
        )
    }

    /// The derivatives by the global parameters that affect all corners.
    fn dense(&self) -> DMatrixView<'_, f64> {
        self.some(0..self.columns.motion())
    }

    fn locals(&self) -> DMatrixView<'_, f64> {
        self.some(self.first_local..self.columns.residual())
    }

    /// The view's influence on the lens. `with_lens` is the covariance of all globals with those of
    /// the lens (globals × lens), `inverse` the inverse of the lens's own block.
    pub(super) fn influence(&self, with_lens: &DMatrix<f64>, inverse: &DMatrix<f64>) -> Influence {
        // The contribution of each residual to the step of the lens.
        let (rows, dense) = (self.columns.rows, self.columns.motion());
        let mut parts = self.dense() * with_lens.rows(0, dense);
        for (corner, point) in self.columns.own().iter().enumerate() {
            for row in [corner, corner + rows / 2] {
                for (axis, by) in self.in_plane.iter().enumerate() {
                    let part = with_lens.row(dense + 2 * point + axis) * by[row];
                    let mut target = parts.row_mut(row);
                    target += part;
                }
            }
        }
        let coupling = self.locals().transpose() * &parts;
        let eliminated = self.local_square.solve(&coupling);
        let all = self.all();
        let residual = all.column(self.columns.residual());
        Influence::of(
            eliminated.transpose() * &self.local_gradient - parts.transpose() * residual,
            parts.transpose() * &parts - coupling.transpose() * eliminated,
            inverse,
        )
    }

    /// By how much all globals would move without the view, to first order, where `covariance` (C)
    /// is theirs: x of (C⁻¹ − A) x = s by conjugate gradients, preconditioned by C (M. Hestenes, E.
    /// Stiefel, 1952). C⁻¹ itself is never computed.
    pub(super) fn without(&self, covariance: &DMatrix<f64>) -> DVector<f64> {
        let all = self.all();
        let residual = all.column(self.columns.residual()).into_owned();
        let motion = self.local_square.solve(&self.local_gradient);
        let mut rest = -self.transposed(&(residual - self.locals() * motion));
        let mut moved = DVector::zeros(rest.len());
        let mut preconditioned = covariance * &rest;
        let mut square = rest.dot(&preconditioned);
        let least = SOLVED_PART * square;
        let (mut step, mut with_inverse) = (preconditioned.clone(), rest.clone());
        for _ in 0..MAX_STEPS {
            let image = &with_inverse - self.information(&step);
            let curvature = step.dot(&image);
            if !(curvature > 0.0) {
                break;
            }
            let length = square / curvature;
            moved.axpy(length, &step, 1.0);
            rest.axpy(-length, &image, 1.0);
            preconditioned = covariance * &rest;
            let next = rest.dot(&preconditioned);
            if !(next > least) {
                break;
            }
            let ratio = next / square;
            step = &preconditioned + step * ratio;
            with_inverse = &rest + with_inverse * ratio;
            square = next;
        }
        moved
    }

    /// A x, where A is the view's information with its pose and motion eliminated.
    fn information(&self, x: &DVector<f64>) -> DVector<f64> {
        let dense = self.columns.motion();
        let mut image = self.dense() * x.rows(0, dense);
        for (corner, point) in self.columns.own().iter().enumerate() {
            for row in [corner, corner + self.columns.rows / 2] {
                for (axis, by) in self.in_plane.iter().enumerate() {
                    image[row] += by[row] * x[dense + 2 * point + axis];
                }
            }
        }
        let local = self.local_square.solve(&(self.locals().transpose() * &image));
        image -= self.locals() * local;
        self.transposed(&image)
    }

    /// Jᵀ r for all globals.
    fn transposed(&self, residuals: &DVector<f64>) -> DVector<f64> {
        let dense = self.columns.motion();
        let mut sums = DVector::zeros(self.columns.globals());
        sums.rows_mut(0, dense).copy_from(&(self.dense().transpose() * residuals));
        for (corner, point) in self.columns.own().iter().enumerate() {
            for row in [corner, corner + self.columns.rows / 2] {
                for (axis, by) in self.in_plane.iter().enumerate() {
                    sums[dense + 2 * point + axis] += by[row] * residuals[row];
                }
            }
        }
        sums
    }
}
