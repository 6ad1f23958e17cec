//! The normal equations of a homography's eight numbers, h₃₃ = 1.
//!
//! The first three say nothing of y and the next three nothing of x, and both see the same places:
//! a third of the equations is zero and a third is there twice. What is zero is left out.

/// Rows below the diagonal of each column that are not zero.
const ROWS: [&[usize]; 8] =
    [&[1, 2, 6, 7], &[2, 6, 7], &[6, 7], &[4, 5, 6, 7], &[5, 6, 7], &[6, 7], &[7], &[]];
/// Columns left of the diagonal of each row that are not zero.
const COLUMNS: [&[usize]; 8] =
    [&[], &[0], &[0, 1], &[], &[3], &[3, 4], &[0, 1, 2, 3, 4, 5], &[0, 1, 2, 3, 4, 5, 6]];

/// Sums over pairs of a place and its pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HomographyEquations {
    /// By row and column. Only the lower half is read, and rows 3 to 5 are those of 0 to 2.
    pub normal: [[f64; 8]; 8],
    right: [f64; 8],
}

impl HomographyEquations {
    /// Adds a pair: (h₀i + h₁j + h₂)/(1 + h₆i + h₇j) = x, and the same of h₃, h₄, h₅ and y.
    #[inline]
    pub(super) fn take(&mut self, [i, j]: [f64; 2], pixel: [f64; 2], weight: f64) {
        let Self { normal, right } = self;
        let places = [i, j, 1.0];
        let weighted = places.map(|place| weight * place);
        for a in 0..3 {
            for b in 0..=a {
                normal[a][b] += weighted[a] * places[b];
            }
        }
        for (axis, value) in pixel.into_iter().enumerate() {
            let slants = [-i * value, -j * value];
            for a in 0..3 {
                right[3 * axis + a] += weighted[a] * value;
            }
            for (a, slant) in slants.into_iter().enumerate() {
                let weighted = weight * slant;
                right[6 + a] += weighted * value;
                for b in 0..3 {
                    normal[6 + a][3 * axis + b] += weighted * places[b];
                }
                for b in 0..=a {
                    normal[6 + a][6 + b] += weighted * slants[b];
                }
            }
        }
    }

    /// The eight numbers, by Cholesky's method; `None` if the pairs do not determine them.
    pub(super) fn solve(self) -> Option<[f64; 8]> {
        let Self { normal: mut l, right: mut h } = self;
        for a in 0..3 {
            for b in 0..=a {
                l[3 + a][3 + b] = l[a][b];
            }
        }
        for j in 0..8 {
            for &k in COLUMNS[j] {
                let factor = -l[j][k];
                l[j][j] += factor * l[j][k];
                for &row in ROWS[j] {
                    l[row][j] += factor * l[row][k];
                }
            }
            if l[j][j].is_nan() || l[j][j] <= 0.0 {
                return None;
            }
            l[j][j] = l[j][j].sqrt();
            for &row in ROWS[j] {
                l[row][j] /= l[j][j];
            }
        }
        for j in 0..8 {
            h[j] /= l[j][j];
            for &row in ROWS[j] {
                h[row] += -h[j] * l[row][j];
            }
        }
        for j in (0..8).rev() {
            let known: f64 = ROWS[j].iter().map(|&row| l[row][j] * h[row]).sum();
            h[j] = (h[j] - known) / l[j][j];
        }
        Some(h)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// All 64 equations, added and solved without regard to what is zero.
    fn in_full(pairs: &[([f64; 2], [f64; 2], f64)], flat: f64) -> Option<SVector<f64, 8>> {
        let (mut normal, mut right) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        normal[(6, 6)] = flat;
        normal[(7, 7)] = flat;
        for &([i, j], [x, y], weight) in pairs {
            for (row, value) in [
                ([i, j, 1.0, 0.0, 0.0, 0.0, -i * x, -j * x], x),
                ([0.0, 0.0, 0.0, i, j, 1.0, -i * y, -j * y], y),
            ] {
                let row = SVector::from(row);
                for a in 0..8 {
                    right[a] += weight * row[a] * value;
                    for b in 0..8 {
                        normal[(a, b)] += weight * row[a] * row[b];
                    }
                }
            }
        }
        Some(normal.cholesky()?.solve(&right))
    }

    #[test]
    fn the_same_bits_as_all_equations_in_full() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for case in 0..300 {
            let mut pair = || {
                let mut two = || [0, 1].map(|_| rng.random_range(-2.0..2.0));
                let (place, pixel) = (two(), two());
                (place, pixel, rng.random_range(0.05..2.0))
            };
            let pairs: Vec<_> = (0..3 + case % 22).map(|_| pair()).collect();
            let flat = 0.004;
            let mut equations = HomographyEquations::default();
            equations.normal[6][6] = flat;
            equations.normal[7][7] = flat;
            pairs.iter().for_each(|&(place, pixel, weight)| equations.take(place, pixel, weight));
            let (solved, expected) = (equations.solve(), in_full(&pairs, flat));
            assert_eq!(solved.is_some(), expected.is_some(), "case {case}");
            if let (Some(solved), Some(expected)) = (solved, expected) {
                assert!(expected.iter().zip(solved).all(|(a, b)| *a == b), "case {case}");
            }
        }
    }

    #[test]
    fn places_on_one_line_determine_nothing() {
        let mut equations = HomographyEquations::default();
        for k in 0..6 {
            equations.take([f64::from(k), 0.0], [f64::from(k), 1.0], 1.0);
        }
        assert!(equations.solve().is_none());
    }
}
