//! Weighted least squares of polynomials in two variables, of the order that predicts a left-out
//! sample best.

/// The number of terms of a polynomial of order 0 to 4.
pub(super) const TERMS: [usize; 5] = [1, 3, 6, 10, 15];
pub(super) const MOST_TERMS: usize = 15;
/// Terms, padded to whole vectors.
pub(super) const LANES: usize = 16;
/// Lanes of one vector: sums start at a multiple of it.
const VECTOR: usize = 4;
/// Minimum samples per term.
const SAMPLES_PER_TERM: usize = 2;
/// A sample whose weighted square is this many times the mean square has lost three quarters of its
/// weight (Geman & McClure).
const TOLERANCE: f64 = 6.0;

/// Coefficients by order, and by falling power of the first of the two within it; 0 beyond the
/// terms.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Solution {
    pub coefficients: [f64; LANES],
    pub terms: usize,
}

/// A solution; the weighted mean square of the residuals at the highest order, and at the chosen
/// order.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolvedField {
    pub solution: Solution,
    pub mean_square: f64,
    pub chosen_mean_square: f64,
}

/// Weighted normal equations of all terms (the upper triangle), their right sides, and the sums of
/// trust and of squared values.
#[derive(Debug, Default)]
pub(super) struct FieldSums {
    pub normal: [[f64; LANES]; MOST_TERMS],
    pub right: [f64; LANES],
    pub trust: f64,
    pub squares: f64,
}

/// The highest order, up to `order`, that `count` samples may have.
pub(super) fn highest_order(count: usize, order: usize) -> usize {
    (0..=order).rev().find(|&order| SAMPLES_PER_TERM * TERMS[order] <= count).unwrap_or(0)
}

/// The robust weight of a sample whose weighted square is `square`, where the mean is `mean_square`
/// (Geman & McClure).
#[inline(always)]
pub(super) fn trust(square: f64, mean_square: f64) -> f64 {
    let doubt = 1.0 + square / (TOLERANCE * mean_square);
    1.0 / (doubt * doubt)
}

impl FieldSums {
    /// Adds a sample: its columns, its value, its weight, and the robust part of that weight.
    #[inline(always)]
    pub fn add(&mut self, columns: &[f64; LANES], value: f64, weight: f64, trust: f64) {
        self.add_rows::<0>(columns, weight);
        self.add_rows::<4>(columns, weight);
        self.add_rows::<8>(columns, weight);
        self.add_rows::<12>(columns, weight);
        let weighted = weight * value;
        for (sum, column) in self.right.iter_mut().zip(columns) {
            *sum += weighted * column;
        }
        self.trust += trust;
        self.squares += weighted * value;
    }

    /// Adds to the rows from `FROM` on, one per lane of a vector, the columns from `FROM` on.
    #[inline(always)]
    fn add_rows<const FROM: usize>(&mut self, columns: &[f64; LANES], weight: f64) {
        for row in FROM..(FROM + VECTOR).min(MOST_TERMS) {
            let weighted = weight * columns[row];
            for (sum, column) in self.normal[row][FROM..].iter_mut().zip(&columns[FROM..]) {
                *sum += weighted * column;
            }
        }
    }

    /// The coefficients of the order up to `order` that generalized cross-validation selects
    /// (Craven and Wahba, 1979) for `count` samples. `least_pivot` is the pivot threshold. `None`
    /// if the samples do not determine even a mean.
    pub fn solve(self, order: usize, count: usize, least_pivot: f64) -> Option<SolvedField> {
        pulp::Arch::new().dispatch(Solving { sums: self, order, count, least_pivot })
    }

    /// Eliminates the first `terms` in order. Each row keeps its part of U, where the normal matrix
    /// is Uᵀ·D⁻¹·U and D the diagonal of U. Returns how many terms the samples determine.
    #[inline(always)]
    fn eliminate(&mut self, terms: usize, least_pivot: f64) -> usize {
        let Self { normal, right, .. } = self;
        let mut diagonal = [0.0; MOST_TERMS];
        for (k, entry) in diagonal.iter_mut().enumerate() {
            *entry = normal[k][k];
        }
        for k in 0..terms {
            let pivot_row = normal[k];
            // The comparison also fails for NaN.
            if pivot_row[k].partial_cmp(&(least_pivot * diagonal[k]))
                != Some(std::cmp::Ordering::Greater)
            {
                return k;
            }
            let unit = 1.0 / pivot_row[k];
            let explained = right[k] * unit;
            for row in k + 1..terms {
                let factor = pivot_row[row] * unit;
                let from = row / VECTOR * VECTOR;
                for (entry, pivot) in normal[row][from..].iter_mut().zip(&pivot_row[from..]) {
                    *entry -= factor * pivot;
                }
                right[row] -= explained * pivot_row[row];
            }
        }
        terms
    }
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Solving {
    sums: FieldSums,
    order: usize,
    count: usize,
    least_pivot: f64,
}

impl pulp::NullaryFnOnce for Solving {
    type Output = Option<SolvedField>;

    #[inline(always)]
    fn call(self) -> Option<SolvedField> {
        let Self { mut sums, order, count, least_pivot } = self;
        let sound = sums.eliminate(TERMS[order], least_pivot);
        let FieldSums { normal, right, trust, squares } = sums;
        let mut best = None;
        let mut left = f64::INFINITY;
        let (mut explained, mut next) = (0.0, 0);
        for terms in TERMS {
            if terms > sound {
                break;
            }
            // The part of the squares that the terms explain.
            while next < terms {
                explained += right[next] * right[next] / normal[next][next];
                next += 1;
            }
            left = (squares - explained).max(1e-14 * squares) / trust;
            let free = 1.0 - terms as f64 / count as f64;
            let score = left / (free * free).max(1e-9);
            if best.is_none_or(|(least, _)| score < least) {
                best = Some((score, terms));
            }
        }
        let (score, terms) = best?;
        let mut coefficients = [0.0; LANES];
        for row in (0..terms).rev() {
            let mut rest = right[row];
            for k in row + 1..terms {
                rest -= normal[row][k] * coefficients[k];
            }
            coefficients[row] = rest / normal[row][row];
        }
        let free = (1.0 - terms as f64 / count as f64).powi(2).max(1e-9);
        Some(SolvedField {
            solution: Solution { coefficients, terms },
            mean_square: left,
            chosen_mean_square: score * free,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_samples_give_the_polynomial_they_lie_on() {
        let mut sums = FieldSums::default();
        for k in 0..40 {
            let (x, y) = ((f64::from(k) * 0.7).sin(), (f64::from(k) * 1.3).cos());
            let mut columns = [0.0; LANES];
            columns[..6].copy_from_slice(&[1.0, x, y, x * x, x * y, y * y]);
            sums.add(&columns, 2.0 - x + 0.5 * x * y, 1.0 + x * x, 1.0);
        }
        let solved = sums.solve(2, 40, 1e-6).unwrap();
        let expected = [2.0, -1.0, 0.0, 0.0, 0.5, 0.0];
        for (found, expected) in solved.solution.coefficients.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-10);
        }
        assert!(solved.mean_square < 1e-12);
    }

    #[test]
    fn terms_that_the_samples_do_not_determine_are_left_out() {
        let mut on_a_line = FieldSums::default();
        for k in 0..40 {
            let x = f64::from(k) / 20.0 - 1.0;
            let mut columns = [0.0; LANES];
            columns[..3].copy_from_slice(&[1.0, x, x]);
            on_a_line.add(&columns, 1.0 + x, 1.0, 1.0);
        }
        let solved = on_a_line.solve(1, 40, 1e-6).unwrap();
        assert_eq!(solved.solution.terms, 1);
        assert!((solved.solution.coefficients[0] - 1.0 + 0.025).abs() < 1e-12);
        assert!(FieldSums::default().solve(1, 40, 1e-6).is_none());
    }
}
