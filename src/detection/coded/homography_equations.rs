//! The normal equations of a homography's eight parameters, with h₃₃ = 1.
//!
//! The first three parameters affect only x and the next three only y, and both have the same
//! places: a third of the equations is zero, and a third occurs twice. Zeros are left out, and what
//! occurs twice is solved once, in the order of Cholesky's method.

/// Sums over pairs of a place and its pixel. Four sums with a common factor are adjacent, so that a
/// processor adds them at once.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HomographyEquations {
    /// Products of the three parameters of an axis with each other, by the second; the last lane is
    /// empty.
    places: [[f64; 4]; 3],
    /// Products of those three with the last two parameters, each by axis.
    slanted: [[f64; 4]; 3],
    /// Products of the last two with each other: the lower triangle.
    slants: [[f64; 2]; 2],
    /// Right-hand sides by axis; the last lane is empty.
    right: [[f64; 4]; 2],
    right_of_slants: [f64; 2],
}

/// Adds `terms` times `factor` to four sums.
#[inline(always)]
fn add(sums: &mut [f64; 4], terms: [f64; 4], factor: f64) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += term * factor;
    }
}

impl HomographyEquations {
    /// No pairs yet; only the prior, with this weight, that there is no perspective.
    pub(super) fn flat(weight: f64) -> Self {
        Self { slants: [[weight, 0.0], [0.0, weight]], ..Self::default() }
    }

    /// Adds a pair: (h₀i + h₁j + h₂)/(1 + h₆i + h₇j) = x, and the same of h₃, h₄, h₅ and y.
    #[inline(always)]
    pub(super) fn take(&mut self, [i, j]: [f64; 2], [x, y]: [f64; 2], weight: f64) {
        let weighted = [weight * i, weight * j, weight, 0.0];
        let slants = [-i * x, -i * y, -j * x, -j * y];
        let weighted_slants = slants.map(|slant| weight * slant);
        for (b, term) in [i, j, 1.0].into_iter().enumerate() {
            add(&mut self.places[b], weighted, term);
            add(&mut self.slanted[b], weighted_slants, term);
        }
        for (axis, value) in [x, y].into_iter().enumerate() {
            add(&mut self.right[axis], weighted, value);
            let [[p, q], [weighted_p, weighted_q]] =
                [slants, weighted_slants].map(|of| [of[axis], of[2 + axis]]);
            self.right_of_slants[0] += weighted_p * value;
            self.right_of_slants[1] += weighted_q * value;
            self.slants[0][0] += weighted_p * p;
            self.slants[1][0] += weighted_q * p;
            self.slants[1][1] += weighted_q * q;
        }
    }

    /// The eight parameters; `None` if the pairs do not determine them.
    pub(super) fn solve(self) -> Option<[f64; 8]> {
        let Self { places, slanted, slants: mut last, right, right_of_slants: mut g } = self;
        // The lower triangle of the three parameters' sums; and the rows below it, by parameter,
        // axis and term.
        let mut l = [0, 1, 2].map(|row| [0, 1, 2].map(|col| places[col][row]));
        let mut below = [0, 1].map(|a| [0, 1].map(|k| [0, 1, 2].map(|b| slanted[b][2 * a + k])));
        let mut h = right.map(|[a, b, c, _]| [a, b, c]);
        for j in 0..3 {
            for k in 0..j {
                for row in j..3 {
                    l[row][j] += -l[j][k] * l[row][k];
                }
            }
            l[j][j] = root(l[j][j])?;
            for row in j + 1..3 {
                l[row][j] /= l[j][j];
            }
            for row in below.iter_mut().flatten() {
                for k in 0..j {
                    row[j] += -l[j][k] * row[k];
                }
                row[j] /= l[j][j];
            }
        }
        for axis in 0..2 {
            for k in 0..3 {
                for j in 0..2 {
                    for row in j..2 {
                        last[row][j] += -below[j][axis][k] * below[row][axis][k];
                    }
                }
                h[axis][k] /= l[k][k];
                for row in k + 1..3 {
                    h[axis][row] += -h[axis][k] * l[row][k];
                }
                for row in 0..2 {
                    g[row] += -h[axis][k] * below[row][axis][k];
                }
            }
        }
        last[0][0] = root(last[0][0])?;
        last[1][0] /= last[0][0];
        last[1][1] += -last[1][0] * last[1][0];
        last[1][1] = root(last[1][1])?;
        g[0] /= last[0][0];
        g[1] += -g[0] * last[1][0];
        g[1] = g[1] / last[1][1] / last[1][1];
        g[0] = (g[0] - last[1][0] * g[1]) / last[0][0];
        for axis in 0..2 {
            for j in (0..3).rev() {
                let known = (j + 1..3).map(|row| l[row][j] * h[axis][row]).sum::<f64>()
                    + below[0][axis][j] * g[0]
                    + below[1][axis][j] * g[1];
                h[axis][j] = (h[axis][j] - known) / l[j][j];
            }
        }
        let [[a, b, c], [d, e, f]] = h;
        Some([a, b, c, d, e, f, g[0], g[1]])
    }
}

/// The square root of a positive value.
fn root(value: f64) -> Option<f64> {
    (value > 0.0).then(|| value.sqrt())
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
            let mut equations = HomographyEquations::flat(flat);
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
        let mut equations = HomographyEquations::flat(0.1);
        for k in 0..6 {
            equations.take([f64::from(k), 0.0], [f64::from(k), 1.0], 1.0);
        }
        assert!(equations.solve().is_none());
    }
}
