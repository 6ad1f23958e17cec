//! Products of matrices with six columns: the couplings of a pose or a motion. Columns are
//! contiguous and long, so all loops run along columns.

use nalgebra::{Dim, Matrix, Matrix6, MatrixXx6, RawStorage};
use pulp::{Arch, Simd, WithSimd};

/// Replaces X by X L⁻ᵀ, where L is lower triangular.
pub(super) fn by_inverse_transpose(x: &mut MatrixXx6<f64>, lower: &Matrix6<f64>) {
    Arch::new().dispatch(ByInverseTranspose { x, lower });
}

/// Subtracts A B from X.
pub(super) fn take_product(x: &mut MatrixXx6<f64>, a: &MatrixXx6<f64>, b: &Matrix6<f64>) {
    Arch::new().dispatch(TakeProduct { x, a, b });
}

/// Xᵀ X.
pub(super) fn square_of_six<C: Dim, S>(x: &Matrix<f64, nalgebra::Dyn, C, S>) -> Matrix6<f64>
where
    S: RawStorage<f64, nalgebra::Dyn, C>,
{
    let mut square = Matrix6::zeros();
    for i in 0..6 {
        for j in 0..=i {
            let product = x.column(i).dot(&x.column(j));
            (square[(i, j)], square[(j, i)]) = (product, product);
        }
    }
    square
}

struct ByInverseTranspose<'a> {
    x: &'a mut MatrixXx6<f64>,
    lower: &'a Matrix6<f64>,
}

impl WithSimd for ByInverseTranspose<'_> {
    type Output = ();

    /// The loops are plain: compiled in here, they use the machine's widest vectors.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let rows = self.x.nrows();
        for k in 0..6 {
            let (before, from_here) = self.x.as_mut_slice().split_at_mut(k * rows);
            let column = &mut from_here[..rows];
            for l in 0..k {
                subtract(column, self.lower[(k, l)], &before[l * rows..][..rows]);
            }
            let inverse = 1.0 / self.lower[(k, k)];
            column.iter_mut().for_each(|value| *value *= inverse);
        }
    }
}

struct TakeProduct<'a> {
    x: &'a mut MatrixXx6<f64>,
    a: &'a MatrixXx6<f64>,
    b: &'a Matrix6<f64>,
}

impl WithSimd for TakeProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let rows = self.x.nrows();
        for k in 0..6 {
            let column = &mut self.x.as_mut_slice()[k * rows..][..rows];
            for l in 0..6 {
                subtract(column, self.b[(l, k)], &self.a.as_slice()[l * rows..][..rows]);
            }
        }
    }
}

/// Subtracts `factor` times `other` from `column`.
#[inline(always)]
fn subtract(column: &mut [f64], factor: f64, other: &[f64]) {
    column.iter_mut().zip(other).for_each(|(value, other)| *value -= factor * other);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_whole_matrices() {
        let x = MatrixXx6::from_fn(11, |i, j| ((i * 7 + j * 5 + i * j) % 13) as f64 - 6.0);
        let a = MatrixXx6::from_fn(11, |i, j| ((i * 3 + j * 11) % 7) as f64 - 3.0);
        let b = Matrix6::from_fn(|i, j| ((i * 5 + j * 3) % 11) as f64 - 5.0);
        let lower = (b + Matrix6::identity() * 20.0).lower_triangle();
        let mut solved = x.clone();
        by_inverse_transpose(&mut solved, &lower);
        assert!((&solved * lower.transpose() - &x).amax() < 1e-12);
        let mut less = x.clone();
        take_product(&mut less, &a, &b);
        assert!((less - (&x - &a * b)).amax() < 1e-12);
        assert!((square_of_six(&x) - x.transpose() * &x).amax() < 1e-12);
    }
}
