//! Solving the small normal equations of a corner.

use crate::detection::refine::corner_model::UNKNOWNS;

/// The lower triangular L with L·Lᵀ = a symmetric positive definite matrix.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cholesky {
    lower: [[f64; UNKNOWNS]; UNKNOWNS],
}

impl Cholesky {
    /// Factors the matrix whose lower triangle is given; `None` unless it is positive definite.
    pub fn new(matrix: &[[f64; UNKNOWNS]; UNKNOWNS]) -> Option<Self> {
        let mut lower = [[0.0; UNKNOWNS]; UNKNOWNS];
        for row in 0..UNKNOWNS {
            for col in 0..=row {
                let dot: f64 = (0..col).map(|k| lower[row][k] * lower[col][k]).sum();
                let rest = matrix[row][col] - dot;
                if row > col {
                    lower[row][col] = rest / lower[col][col];
                } else if rest > 1e-9 * matrix[row][row] && rest.is_finite() {
                    lower[row][row] = rest.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { lower })
    }

    /// The solution x of A·x = `right`.
    pub fn solve(&self, right: &[f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
        let mut x = *right;
        for row in 0..UNKNOWNS {
            let dot: f64 = (0..row).map(|k| self.lower[row][k] * x[k]).sum();
            x[row] = (x[row] - dot) / self.lower[row][row];
        }
        for row in (0..UNKNOWNS).rev() {
            let dot: f64 = (row + 1..UNKNOWNS).map(|k| self.lower[k][row] * x[k]).sum();
            x[row] = (x[row] - dot) / self.lower[row][row];
        }
        x
    }
}
