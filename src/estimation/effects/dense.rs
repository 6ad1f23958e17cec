//! Cholesky factors and inverses of dense symmetric matrices by blocks, so that nearly all of the
//! work is matrix products (G. H. Golub, C. F. Van Loan, *Matrix Computations*, 4.2.9).

use nalgebra::{DMatrix, DVector};

/// Columns of a block. Factoring one block is cheap compared with the products that blocks allow.
const BLOCK: usize = 32;

/// Columns of the inverse computed at once. Narrow strips skip the zeros above the diagonal.
const STRIP_COLUMNS: usize = 64;

/// A lower-triangular L with L Lᵀ = A, and the inverses of its diagonal blocks.
pub(super) struct Factor {
    lower: DMatrix<f64>,
    diagonal_inverses: Vec<DMatrix<f64>>,
}

impl Factor {
    /// Of a symmetric matrix, of which only the lower triangle is read. `None` unless it is
    /// positive definite.
    pub(super) fn of(mut a: DMatrix<f64>) -> Option<Self> {
        let size = a.nrows();
        let mut diagonal_inverses = Vec::with_capacity(size.div_ceil(BLOCK));
        for at in (0..size).step_by(BLOCK) {
            let width = BLOCK.min(size - at);
            let lower = cholesky(&a.view((at, at), (width, width)).into_owned())?;
            let inverse = inverse_of_lower(&lower);
            a.view_mut((at, at), (width, width)).copy_from(&lower);
            let (next, below) = (at + width, size - at - width);
            if below > 0 {
                let panel = a.view((next, at), (below, width)) * inverse.transpose();
                for column in (0..below).step_by(BLOCK) {
                    let wide = BLOCK.min(below - column);
                    let right = panel.rows(column, wide).transpose();
                    a.view_mut((next + column, next + column), (below - column, wide)).gemm(
                        -1.0,
                        &panel.rows(column, below - column),
                        &right,
                        1.0,
                    );
                }
                a.view_mut((next, at), (below, width)).copy_from(&panel);
            }
            diagonal_inverses.push(inverse);
        }
        Some(Self { lower: a, diagonal_inverses })
    }

    /// ln |A|.
    pub(super) fn log_determinant(&self) -> f64 {
        2.0 * self.lower.diagonal().iter().map(|d| d.ln()).sum::<f64>()
    }

    /// bᵀ A⁻¹ b.
    pub(super) fn half_square(&self, b: &DVector<f64>) -> f64 {
        self.lower.solve_lower_triangular(b).map_or(f64::NAN, |half| half.norm_squared())
    }

    /// L⁻¹.
    pub(super) fn root_of_inverse(&self) -> DMatrix<f64> {
        let size = self.lower.nrows();
        let mut of_lower = DMatrix::zeros(size, size);
        for (block, at) in (0..size).step_by(BLOCK).enumerate() {
            let width = BLOCK.min(size - at);
            let own = &self.diagonal_inverses[block];
            for first in (0..at).step_by(STRIP_COLUMNS) {
                let (across, deep) = (STRIP_COLUMNS.min(at - first), at - first);
                let left = self.lower.view((at, first), (width, deep))
                    * of_lower.view((first, first), (deep, across));
                of_lower.view_mut((at, first), (width, across)).gemm(-1.0, own, &left, 0.0);
            }
            of_lower.view_mut((at, at), (width, width)).copy_from(own);
        }
        of_lower
    }
}

/// Rᵀ R of a lower-triangular R.
pub(super) fn square_of_lower(lower: &DMatrix<f64>) -> DMatrix<f64> {
    let size = lower.nrows();
    let mut square = DMatrix::zeros(size, size);
    for at in (0..size).step_by(BLOCK) {
        let width = BLOCK.min(size - at);
        let rows = lower.view((at, 0), (width, at + width)).into_owned();
        square.view_mut((0, 0), (at + width, at + width)).gemm(1.0, &rows.transpose(), &rows, 1.0);
    }
    square
}

/// R h of a lower-triangular R.
pub(super) fn lower_times(lower: &DMatrix<f64>, h: &DMatrix<f64>) -> DMatrix<f64> {
    let size = lower.nrows();
    let mut product = DMatrix::zeros(size, h.ncols());
    for at in (0..size).step_by(BLOCK) {
        let width = BLOCK.min(size - at);
        let rows = lower.view((at, 0), (width, at + width));
        product.rows_mut(at, width).gemm(1.0, &rows, &h.rows(0, at + width), 0.0);
    }
    product
}

/// Subtracts h hᵀ from the lower triangle of `a`.
pub(super) fn take_square_from_lower(a: &mut DMatrix<f64>, h: &DMatrix<f64>) {
    let (size, across) = (a.nrows(), h.transpose());
    for at in (0..size).step_by(BLOCK) {
        let width = BLOCK.min(size - at);
        a.view_mut((at, at), (size - at, width)).gemm(
            -1.0,
            &h.rows(at, size - at),
            &across.columns(at, width),
            1.0,
        );
    }
}

/// L of a small matrix, column by column: the projections onto earlier columns are subtracted.
fn cholesky(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let size = a.nrows();
    let mut lower = DMatrix::zeros(size, size);
    for j in 0..size {
        let (before, from_here) = lower.as_mut_slice().split_at_mut(j * size);
        let column = &mut from_here[j..size];
        column.copy_from_slice(&a.as_slice()[j * size + j..(j + 1) * size]);
        let diagonal = column[0];
        for other in before.chunks_exact(size) {
            subtract(column, other[j], &other[j..]);
        }
        if !(column[0] > 1e-13 * diagonal) {
            return None;
        }
        let root = column[0].sqrt();
        column[0] = root;
        column[1..].iter_mut().for_each(|value| *value /= root);
    }
    Some(lower)
}

fn inverse_of_lower(lower: &DMatrix<f64>) -> DMatrix<f64> {
    let size = lower.nrows();
    let mut inverse = DMatrix::zeros(size, size);
    for (first, column) in inverse.as_mut_slice().chunks_exact_mut(size).enumerate() {
        column[first] = 1.0;
        for k in first..size {
            let of_lower = &lower.as_slice()[k * size + k..(k + 1) * size];
            let (above, below) = column.split_at_mut(k + 1);
            above[k] /= of_lower[0];
            subtract(below, above[k], &of_lower[1..]);
        }
    }
    inverse
}

/// Subtracts `factor` times `other` from `column`.
fn subtract(column: &mut [f64], factor: f64, other: &[f64]) {
    column.iter_mut().zip(other).for_each(|(value, other)| *value -= factor * other);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_and_determinant_agree_with_the_plain_ones() {
        for size in [1, 7, 32, 33, 100] {
            let root = DMatrix::from_fn(size, size + 3, |i, j| {
                ((i * 7 + j * 13 + i * j) % 17) as f64 - 8.0
            });
            let a = &root * root.transpose() + DMatrix::identity(size, size) * 5.0;
            let factor = Factor::of(a.clone()).unwrap();
            let root = factor.root_of_inverse();
            let off = square_of_lower(&root) * &a - DMatrix::identity(size, size);
            assert!(off.amax() < 1e-9, "{size}: {}", off.amax());
            let thin = DMatrix::from_fn(size, 5, |i, j| (i * j) as f64);
            assert!((lower_times(&root, &thin) - &root * &thin).amax() < 1e-9);
            let mut less = a.clone();
            take_square_from_lower(&mut less, &thin);
            let off = (less - (&a - &thin * thin.transpose())).lower_triangle();
            assert!(off.amax() < 1e-9 * a.amax().max((size * size) as f64));
            let plain: f64 =
                a.cholesky().unwrap().l().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
            assert!((factor.log_determinant() - plain).abs() < 1e-9 * plain.abs().max(1.0));
        }
        assert!(Factor::of(DMatrix::from_diagonal_element(3, 3, -1.0)).is_none());
    }
}
