//! Solving the small normal equations of a corner.

use crate::detection::refine::corner_model::UNKNOWNS;

/// The lower triangular L with L·Lᵀ = a symmetric positive definite matrix.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cholesky {
    lower: [[f64; UNKNOWNS]; UNKNOWNS],
    /// 1/Lᵢᵢ.
    inverse: [f64; UNKNOWNS],
}

impl Cholesky {
    /// Factors the matrix whose lower triangle is given, its diagonal first made larger by the fraction `damping`; `None`
    /// unless it is positive definite.
    pub fn new(matrix: &[[f64; UNKNOWNS]; UNKNOWNS], damping: f64) -> Option<Self> {
        let mut lower = *matrix;
        let mut inverse = [0.0; UNKNOWNS];
        for col in 0..UNKNOWNS {
            let rest = lower[col][col] + damping * matrix[col][col];
            if !(rest > 1e-9 * matrix[col][col] && rest.is_finite()) {
                return None;
            }
            lower[col][col] = rest.sqrt();
            inverse[col] = 1.0 / lower[col][col];
            for row in &mut lower[col + 1..] {
                row[col] *= inverse[col];
            }
            // What is left for the columns to come: sums that do not wait for each other.
            for row in col + 1..UNKNOWNS {
                for later in col + 1..=row {
                    lower[row][later] -= lower[row][col] * lower[later][col];
                }
            }
        }
        Some(Self { lower, inverse })
    }

    /// The solution x of A·x = `right`.
    pub fn solve(&self, right: &[f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
        let mut x = *right;
        for row in 0..UNKNOWNS {
            let dot: f64 = (0..row).map(|k| self.lower[row][k] * x[k]).sum();
            x[row] = (x[row] - dot) * self.inverse[row];
        }
        for row in (0..UNKNOWNS).rev() {
            let dot: f64 = (row + 1..UNKNOWNS).map(|k| self.lower[k][row] * x[k]).sum();
            x[row] = (x[row] - dot) * self.inverse[row];
        }
        x
    }

    /// Covariance of the last two unknowns, the block of the inverse: xx, xy, yy.
    pub fn last_covariance(&self) -> [f64; 3] {
        let last = UNKNOWNS - 1;
        let (a, c) = (self.inverse[last - 1], self.inverse[last]);
        // The inverse of the factor's last block is [[a, 0], [b, c]].
        let b = -self.lower[last][last - 1] * a * c;
        [a * a + b * b, b * c, c * c]
    }
}
