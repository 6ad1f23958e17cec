//! The correction of the lens from all views, with the board's shape held.

use nalgebra::{Cholesky, Const, SMatrix};

use crate::estimation::labels_by_shape::residual_field::ResidualField;
use crate::estimation::labels_by_shape::shape::LensVector;
use crate::geometry::lens::MAX_PARAMETERS;

/// The normal equations of the lens, with parameters in units of their own standard deviations.
pub(super) struct LensEquations {
    inverse_scale: LensVector,
    factor: Cholesky<f64, Const<MAX_PARAMETERS>>,
}

/// Added to the diagonal of the lens's normal equations, which is 1: rounding must not decide where
/// parameters are nearly dependent, as the coefficients of a rational lens are.
const RIDGE: f64 = 1e-9;

impl LensEquations {
    /// `None` where rounding leaves no solution.
    pub(super) fn of(fields: &[&ResidualField]) -> Option<Self> {
        let corners = fields.iter().flat_map(|field| &field.corners);
        let normal: SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS> =
            corners.map(|corner| corner.by_lens.tr_mul(&corner.by_lens)).sum();
        let inverse = |square: f64| if square > 0.0 { square.sqrt().recip() } else { 0.0 };
        let inverse_scale = normal.diagonal().map(inverse);
        let scale = SMatrix::from_diagonal(&inverse_scale);
        let mut scaled = scale * normal * scale;
        scaled.fill_diagonal(1.0 + RIDGE);
        Some(Self { inverse_scale, factor: scaled.cholesky()? })
    }

    /// The step to the minimum along the lens's parameters.
    pub(super) fn step(&self, gradient: &LensVector) -> LensVector {
        let scaled = self.inverse_scale.component_mul(gradient);
        self.factor.solve(&scaled).component_mul(&self.inverse_scale)
    }
}
