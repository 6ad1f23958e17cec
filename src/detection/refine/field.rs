//! What changes smoothly over a board: a polynomial of the place on it, fitted to what the corners tell, of the order that
//! foretells a corner left out best.

/// Terms of a polynomial of an order, from 0 to the highest.
const TERMS: [usize; 5] = [1, 3, 6, 10, 15];
const MOST_TERMS: usize = 15;
/// Room for them, for the sake of vectors.
const LANES: usize = 16;
/// Corners that a term takes at least.
const SAMPLES_PER_TERM: usize = 2;
/// Weighted least squares are repeated against outliers.
const ROUNDS: usize = 3;
/// A sample this many times the mean square off has lost three quarters of its weight (Geman & McClure).
const TOLERANCE: f64 = 6.0;

/// What one corner tells: at column and row, a value.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldSample {
    pub place: [f64; 2],
    pub value: f64,
    /// How much it is to be believed: one over its variance, in any unit.
    pub weight: f64,
}

/// A polynomial of column and row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Field {
    /// Places are moved and scaled to −1 … 1.
    middle: [f64; 2],
    scale: [f64; 2],
    /// By order, and by falling power of the column within it.
    coefficients: [f64; LANES],
    terms: usize,
}

/// Weighted normal equations of all terms, their right sides, and the sums of weights and of squared values.
struct Sums {
    normal: [[f64; LANES]; MOST_TERMS],
    right: [f64; LANES],
    weights: f64,
    squares: f64,
}

impl Field {
    /// Fits a field of `order` at most; 0 everywhere if there are no samples.
    pub fn fit(samples: &[FieldSample], order: usize) -> Self {
        let mut field = Self::spanning(samples);
        let order = (0..=order).rev().find(|&order| SAMPLES_PER_TERM * TERMS[order] <= samples.len()).unwrap_or(0);
        let mut mean_square = f64::INFINITY;
        for _ in 0..ROUNDS {
            let sums = field.sums(samples, TERMS[order], mean_square);
            let Some(left) = field.solve(sums, order, samples.len()) else { break };
            mean_square = left.max(f64::MIN_POSITIVE);
        }
        field
    }

    /// No field yet, over the places of `samples`.
    fn spanning(samples: &[FieldSample]) -> Self {
        let fold = |k: usize, pick: fn(f64, f64) -> f64| samples.iter().map(|s| s.place[k]).reduce(pick).unwrap_or(0.0);
        let range = [0, 1].map(|k| (fold(k, f64::min), fold(k, f64::max)));
        Self {
            middle: range.map(|(least, most)| (least + most) / 2.0),
            scale: range.map(|(least, most)| 2.0 / (most - least).max(1.0)),
            ..Self::default()
        }
    }

    fn sums(&self, samples: &[FieldSample], terms: usize, mean_square: f64) -> Sums {
        pulp::Arch::new().dispatch(Summation { field: self, samples, terms, mean_square })
    }

    /// Takes the coefficients of the order up to `order` that generalised cross-validation prefers; returns the mean square
    /// that the highest leaves. `None`: the samples do not even tell a mean.
    fn solve(&mut self, mut sums: Sums, order: usize, count: usize) -> Option<f64> {
        let Sums { normal, right, weights, squares } = &mut sums;
        let sound = factor(normal, TERMS[order]);
        // What each term explains of the squares.
        for row in 0..sound {
            right[row] = (right[row] - dot(&normal[row][..row], &right[..row])) / normal[row][row];
        }
        let mut best = None;
        let mut left = f64::INFINITY;
        for &terms in TERMS[..=order].iter().filter(|&&terms| terms <= sound) {
            let rest = (*squares - dot(&right[..terms], &right[..terms])).max(1e-14 * *squares);
            left = rest / *weights;
            let free = 1.0 - terms as f64 / count as f64;
            let score = left / (free * free).max(1e-9);
            if best.is_none_or(|(least, _)| score < least) {
                best = Some((score, terms));
            }
        }
        let (_, terms) = best?;
        self.terms = terms;
        self.coefficients = [0.0; LANES];
        for row in (0..terms).rev() {
            let known: f64 = (row + 1..terms).map(|k| normal[k][row] * self.coefficients[k]).sum();
            self.coefficients[row] = (right[row] - known) / normal[row][row];
        }
        Some(left)
    }

    fn scaled(&self, place: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (place[k] - self.middle[k]) * self.scale[k])
    }

    /// The field's value at `place`.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        dot(&basis(self.scaled(place))[..self.terms], &self.coefficients[..self.terms])
    }

    /// Its change per column and per row there.
    pub fn slope(&self, place: [f64; 2]) -> [f64; 2] {
        let lower = basis(self.scaled(place));
        let mut slope = [0.0; 2];
        let mut term = 0;
        for order in 0..TERMS.len() {
            for row_power in 0..=order {
                if term < self.terms && order > 0 {
                    // One order below, terms lie at the same row power (less a column), or one before (less a row).
                    let below = TERMS[order - 1] - order;
                    let col_power = order - row_power;
                    if col_power > 0 {
                        slope[0] += self.coefficients[term] * col_power as f64 * lower[below + row_power];
                    }
                    if row_power > 0 {
                        slope[1] += self.coefficients[term] * row_power as f64 * lower[below + row_power - 1];
                    }
                }
                term += 1;
            }
        }
        [0, 1].map(|k| slope[k] * self.scale[k])
    }
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Summation<'a> {
    field: &'a Field,
    samples: &'a [FieldSample],
    terms: usize,
    mean_square: f64,
}

impl pulp::NullaryFnOnce for Summation<'_> {
    type Output = Sums;

    #[inline(always)]
    fn call(self) -> Sums {
        let Self { field, samples, terms, mean_square } = self;
        let mut sums = Sums { normal: [[0.0; LANES]; MOST_TERMS], right: [0.0; LANES], weights: 0.0, squares: 0.0 };
        for &FieldSample { place, value, weight } in samples {
            let basis =
                basis([(place[0] - field.middle[0]) * field.scale[0], (place[1] - field.middle[1]) * field.scale[1]]);
            let mut off = value;
            #[expect(clippy::needless_range_loop, reason = "lanes of one width are what the compiler vectorises")]
            for k in 0..LANES {
                // Coefficients beyond the field's terms are 0.
                off -= basis[k] * field.coefficients[k];
            }
            let doubt = if mean_square.is_finite() { weight * off * off / (TOLERANCE * mean_square) } else { 0.0 };
            let trust = 1.0 / ((1.0 + doubt) * (1.0 + doubt));
            let weight = trust * weight;
            for (row, sums) in sums.normal[..terms].iter_mut().enumerate() {
                let weighted = weight * basis[row];
                for (sum, basis) in sums.iter_mut().zip(&basis) {
                    *sum += weighted * basis;
                }
            }
            let weighted = weight * value;
            #[expect(clippy::needless_range_loop, reason = "lanes of one width are what the compiler vectorises")]
            for k in 0..LANES {
                sums.right[k] += weighted * basis[k];
            }
            sums.weights += trust;
            sums.squares += weighted * value;
        }
        sums
    }
}

/// All terms at a scaled place.
#[inline(always)]
fn basis([x, y]: [f64; 2]) -> [f64; LANES] {
    let (x2, y2) = (x * x, y * y);
    let (x3, y3) = (x2 * x, y2 * y);
    [1.0, x, y, x2, x * y, y2, x3, x2 * y, x * y2, y3, x2 * x2, x3 * y, x2 * y2, x * y3, y2 * y2, 0.0]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Puts the lower triangular L with L·Lᵀ in place of the first `terms` of `normal`; returns how many of them the samples
/// tell apart.
fn factor(normal: &mut [[f64; LANES]; MOST_TERMS], terms: usize) -> usize {
    for row in 0..terms {
        for col in 0..=row {
            let rest = normal[row][col] - dot(&normal[row][..col], &normal[col][..col]);
            if col < row {
                normal[row][col] = rest / normal[col][col];
            } else if rest > 1e-6 * normal[row][row] {
                normal[row][row] = rest.sqrt();
            } else {
                return row;
            }
        }
    }
    terms
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(of: impl Fn(f64, f64) -> f64) -> Vec<FieldSample> {
        let places = (0..6).flat_map(|row| (0..9).map(move |col| [f64::from(col), f64::from(row)]));
        places.map(|place| FieldSample { place, value: of(place[0], place[1]), weight: 1.0 }).collect()
    }

    #[test]
    fn a_polynomial_is_found_with_its_slope() {
        let of = |x: f64, y: f64| 1.0 + 0.3 * x - 0.2 * y + 0.01 * x * x * y - 0.004 * y * y * y * x;
        let field = Field::fit(&samples(of), 4);
        for [x, y] in [[0.0, 0.0], [8.0, 5.0], [3.5, 2.0]] {
            assert!((field.at([x, y]) - of(x, y)).abs() < 1e-9);
            let slope = [0.3 + 0.02 * x * y - 0.004 * y * y * y, -0.2 + 0.01 * x * x - 0.012 * y * y * x];
            assert!((0..2).all(|k| (field.slope([x, y])[k] - slope[k]).abs() < 1e-9));
        }
    }

    #[test]
    fn outliers_are_left_out_and_noise_makes_no_high_order() {
        let noise = |x: f64, y: f64| (12.9898 * x + 78.233 * y).sin() * 0.01;
        let mut seen = samples(|x, y| 2.0 + 0.1 * x + noise(x, y));
        seen[13].value += 3.0;
        seen[40].value -= 2.0;
        let field = Field::fit(&seen, 4);
        assert!((0..9).all(|col| (field.at([f64::from(col), 2.0]) - 2.0 - 0.1 * f64::from(col)).abs() < 0.02));
    }

    #[test]
    fn few_samples_give_a_mean_and_none_nothing() {
        let at = |col: f64, value: f64| FieldSample { place: [col, 0.0], value, weight: 1.0 };
        assert_eq!(Field::fit(&[], 2).at([1.0, 2.0]), 0.0);
        assert!((Field::fit(&[at(0.0, 1.0), at(1.0, 2.0)], 2).at([5.0, 5.0]) - 1.5).abs() < 1e-12);
        // Nothing tells a row from another.
        let line: Vec<FieldSample> = (0..20).map(|col| at(f64::from(col), f64::from(col))).collect();
        assert!(Field::fit(&line, 3).at([3.0, 9.0]).is_finite());
    }
}
