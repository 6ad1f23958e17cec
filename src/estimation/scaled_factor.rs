//! Inverses of symmetric matrices over parameters that differ by orders of magnitude: each
//! parameter is scaled before the matrix is factored, which keeps the pivots comparable.
//! Deliberately not used where the matrix has a fixed size and is not to be allocated (poses), is
//! factored by blocks (effects), or is damped or compared in scaled units.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// L of L Lᵀ = S M S, where S is a diagonal matrix of units.
#[derive(Debug, Clone)]
pub(crate) struct ScaledFactor {
    scale: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl ScaledFactor {
    /// The factor of `matrix` in units that make its diagonal 1; `None` where it is not positive
    /// definite.
    pub(crate) fn of(matrix: &DMatrix<f64>) -> Option<Self> {
        let scale = matrix.diagonal().map(|value| 1.0 / value.max(f64::MIN_POSITIVE).sqrt());
        Self::in_units(matrix, scale)
    }

    /// The factor of `matrix`, of which only the lower triangle is read, with S = diag `scale`.
    pub(crate) fn in_units(matrix: &DMatrix<f64>, scale: DVector<f64>) -> Option<Self> {
        let factor = scaled(matrix, &scale).cholesky()?;
        Some(Self { scale, factor })
    }

    /// M⁻¹.
    pub(crate) fn inverse(&self) -> DMatrix<f64> {
        scaled(&self.factor.inverse(), &self.scale)
    }

    /// M⁻¹ `right`.
    pub(crate) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        self.factor.solve(&right.component_mul(&self.scale)).component_mul(&self.scale)
    }

    /// R = L⁻¹ S, with M⁻¹ = Rᵀ R.
    pub(crate) fn root_of_inverse(&self) -> Option<DMatrix<f64>> {
        let mut root = DMatrix::identity(self.scale.len(), self.scale.len());
        self.factor.l_dirty().solve_lower_triangular_mut(&mut root).then_some(())?;
        root.column_iter_mut()
            .zip(self.scale.iter())
            .for_each(|(mut column, scale)| column *= *scale);
        Some(root)
    }
}

/// The inverse of a symmetric matrix; `None` where it is not positive definite.
pub(crate) fn scaled_inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(ScaledFactor::of(matrix)?.inverse())
}

fn scaled(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] * scale[i] * scale[j])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A focal length in pixels beside a coefficient of the eighth power of a radius.
    #[test]
    fn parameters_of_sizes_that_differ_by_ten_orders_are_inverted() {
        let matrix =
            DMatrix::from_row_slice(3, 3, &[4e10, 3.0, -2e4, 3.0, 1e-9, 1e-6, -2e4, 1e-6, 0.5]);
        let factor = ScaledFactor::of(&matrix).unwrap();
        let inverse = factor.inverse();
        let off = &matrix * &inverse - DMatrix::identity(3, 3);
        // Row and column of the identity in units of each other's strength.
        let unit = matrix.diagonal().map(f64::sqrt);
        assert!((0..9).all(|k| (off[k] * unit[k / 3] / unit[k % 3]).abs() < 1e-12), "{off}");
        let root = factor.root_of_inverse().unwrap();
        let [squared, solved] = [
            root.tr_mul(&root),
            DMatrix::from_columns(&[0, 1, 2].map(|k| factor.solve(&matrix.column(k).into_owned()))),
        ];
        assert!(
            (0..9).all(|k| (squared[k] / inverse[k] - 1.0).abs() < 1e-9),
            "{squared} {inverse}"
        );
        let off = solved - DMatrix::identity(3, 3);
        assert!((0..9).all(|k| (off[k] * unit[k % 3] / unit[k / 3]).abs() < 1e-12), "{off}");
    }

    #[test]
    fn what_is_not_determined_has_no_factor() {
        assert!(ScaledFactor::of(&DMatrix::zeros(2, 2)).is_none());
        let indefinite = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]);
        assert!(scaled_inverse(&indefinite).is_none());
    }
}
