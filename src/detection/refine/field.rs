//! A quantity that changes smoothly over a board: a polynomial in column and row, fitted to the
//! corners' measurements, of the order that predicts a left-out corner best.

/// Terms of a polynomial of an order, from 0 to the highest.
pub(super) const TERMS: [usize; 5] = [1, 3, 6, 10, 15];
const MOST_TERMS: usize = 15;
/// Room for them, for the sake of vectors.
pub(super) const LANES: usize = 16;
/// Minimum corners per term.
const SAMPLES_PER_TERM: usize = 2;
/// Pivot threshold relative to the diagonal; rejects near-collinear basis terms.
const LEAST_PIVOT: f64 = 1e-6;
/// Weighted least squares are repeated against outliers.
const ROUNDS: usize = 2;
/// A sample this many times the mean square off has lost three quarters of its weight (Geman &
/// McClure).
const TOLERANCE: f64 = 6.0;

/// One corner's measurement: at column and row, a value.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldSample {
    pub place: [f64; 2],
    pub value: f64,
    /// Its weight: one over its variance, in any unit.
    pub weight: f64,
}

/// A polynomial of column and row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BoardField {
    /// Places are moved and scaled to −1 … 1.
    middle: [f64; 2],
    scale: [f64; 2],
    solution: Solution,
}

/// Coefficients by order, and by falling power of the first of the two within it; 0 beyond the
/// terms.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Solution {
    pub coefficients: [f64; LANES],
    pub terms: usize,
}

/// A solution and the weighted mean squares that it leaves, and that the highest order would.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolvedField {
    pub solution: Solution,
    pub mean_square: f64,
    pub chosen_mean_square: f64,
}

/// Weighted normal equations of all terms (the lower triangle), their right sides, and the sums of
/// trust and of squared values.
#[derive(Default)]
pub(super) struct FieldSums {
    normal: [[f64; LANES]; MOST_TERMS],
    right: [f64; LANES],
    trust: f64,
    squares: f64,
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
    /// Adds a sample: its columns, its value, its weight and how much of that is trust.
    #[inline(always)]
    pub fn add(
        &mut self,
        columns: &[f64; LANES],
        value: f64,
        weight: f64,
        trust: f64,
        terms: usize,
    ) {
        self.add_rows::<0, 4>(columns, weight, terms);
        self.add_rows::<4, 8>(columns, weight, terms);
        self.add_rows::<8, 12>(columns, weight, terms);
        self.add_rows::<12, 16>(columns, weight, terms);
        let weighted = weight * value;
        for (sum, column) in self.right.iter_mut().zip(columns) {
            *sum += weighted * column;
        }
        self.trust += trust;
        self.squares += weighted * value;
    }

    /// Adds to the rows `FROM` … `TO`, as far as there are terms, as much of each as may be left of
    /// the diagonal.
    #[inline(always)]
    fn add_rows<const FROM: usize, const TO: usize>(
        &mut self,
        columns: &[f64; LANES],
        weight: f64,
        terms: usize,
    ) {
        for row in FROM..TO.min(terms) {
            let weighted = weight * columns[row];
            for (sum, column) in self.normal[row][..TO].iter_mut().zip(&columns[..TO]) {
                *sum += weighted * column;
            }
        }
    }

    /// The coefficients of the order up to `order` that generalized cross-validation prefers
    /// (Craven and Wahba, 1979), of `count` samples; and the mean square of the highest order.
    /// `least_pivot` is the pivot threshold. `None`: the samples do not determine even a mean.
    pub fn solve(mut self, order: usize, count: usize, least_pivot: f64) -> Option<SolvedField> {
        let Self { normal, right, trust, squares } = &mut self;
        let sound = factor(normal, TERMS[order], least_pivot);
        // The part of the squares that each term explains.
        for row in 0..sound {
            right[row] = (right[row] - dot(&normal[row][..row], &right[..row])) / normal[row][row];
        }
        let mut best = None;
        let mut left = f64::INFINITY;
        for &terms in TERMS[..=order].iter().filter(|&&terms| terms <= sound) {
            let rest = (*squares - dot(&right[..terms], &right[..terms])).max(1e-14 * *squares);
            left = rest / *trust;
            let free = 1.0 - terms as f64 / count as f64;
            let score = left / (free * free).max(1e-9);
            if best.is_none_or(|(least, _)| score < least) {
                best = Some((score, terms));
            }
        }
        let (score, terms) = best?;
        let mut coefficients = [0.0; LANES];
        for row in (0..terms).rev() {
            let known: f64 = (row + 1..terms).map(|k| normal[k][row] * coefficients[k]).sum();
            coefficients[row] = (right[row] - known) / normal[row][row];
        }
        let free = (1.0 - terms as f64 / count as f64).powi(2).max(1e-9);
        Some(SolvedField {
            solution: Solution { coefficients, terms },
            mean_square: left,
            chosen_mean_square: score * free,
        })
    }
}

impl BoardField {
    /// Fits a field of `order` at most; 0 everywhere if there are no samples.
    pub fn fit(samples: &[FieldSample], order: usize) -> Self {
        let mut field = Self::spanning(samples);
        let order = highest_order(samples.len(), order);
        let mut mean_square = f64::INFINITY;
        for _ in 0..ROUNDS {
            let sums = pulp::Arch::new().dispatch(FieldSummation {
                field: &field,
                samples,
                terms: TERMS[order],
                mean_square,
            });
            let Some(solved) = sums.solve(order, samples.len(), LEAST_PIVOT) else { break };
            (field.solution, mean_square) =
                (solved.solution, solved.mean_square.max(f64::MIN_POSITIVE));
        }
        field
    }

    /// No field yet, over the places of `samples`.
    fn spanning(samples: &[FieldSample]) -> Self {
        let fold = |k: usize, pick: fn(f64, f64) -> f64| {
            samples.iter().map(|s| s.place[k]).reduce(pick).unwrap_or(0.0)
        };
        let range = [0, 1].map(|k| (fold(k, f64::min), fold(k, f64::max)));
        Self {
            middle: range.map(|(least, most)| (least + most) / 2.0),
            scale: range.map(|(least, most)| 2.0 / (most - least).max(1.0)),
            ..Self::default()
        }
    }

    fn scaled(&self, place: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (place[k] - self.middle[k]) * self.scale[k])
    }

    /// The field's value at `place`.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        dot(&basis(self.scaled(place)), &self.solution.coefficients)
    }

    /// Its change per column and per row there.
    pub fn slope(&self, place: [f64; 2]) -> [f64; 2] {
        let lower = basis(self.scaled(place));
        let mut slope = [0.0; 2];
        let mut term = 0;
        for order in 0..TERMS.len() {
            for row_power in 0..=order {
                if term < self.solution.terms && order > 0 {
                    // One order below, terms lie at the same row power (less a column), or one
                    // before (less a row).
                    let below = TERMS[order - 1] - order;
                    let col_power = order - row_power;
                    if col_power > 0 {
                        slope[0] += self.solution.coefficients[term]
                            * col_power as f64
                            * lower[below + row_power];
                    }
                    if row_power > 0 {
                        slope[1] += self.solution.coefficients[term]
                            * row_power as f64
                            * lower[below + row_power - 1];
                    }
                }
                term += 1;
            }
        }
        [0, 1].map(|k| slope[k] * self.scale[k])
    }
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct FieldSummation<'a> {
    field: &'a BoardField,
    samples: &'a [FieldSample],
    terms: usize,
    mean_square: f64,
}

impl pulp::NullaryFnOnce for FieldSummation<'_> {
    type Output = FieldSums;

    #[inline(always)]
    fn call(self) -> FieldSums {
        let Self { field, samples, terms, mean_square } = self;
        let mut sums = FieldSums::default();
        for &FieldSample { place, value, weight } in samples {
            let basis = basis([
                (place[0] - field.middle[0]) * field.scale[0],
                (place[1] - field.middle[1]) * field.scale[1],
            ]);
            let mut off = value;
            for (basis, coefficient) in basis.iter().zip(&field.solution.coefficients) {
                off -= basis * coefficient;
            }
            let trust =
                if mean_square.is_finite() { trust(weight * off * off, mean_square) } else { 1.0 };
            sums.add(&basis, value, trust * weight, trust, terms);
        }
        sums
    }
}

/// All terms at a scaled place.
#[inline(always)]
pub(super) fn basis([x, y]: [f64; 2]) -> [f64; LANES] {
    let (x2, y2) = (x * x, y * y);
    let (x3, y3) = (x2 * x, y2 * y);
    [
        1.0,
        x,
        y,
        x2,
        x * y,
        y2,
        x3,
        x2 * y,
        x * y2,
        y3,
        x2 * x2,
        x3 * y,
        x2 * y2,
        x * y3,
        y2 * y2,
        0.0,
    ]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Replaces the first `terms` of `normal` by the lower triangular L with L·Lᵀ; returns how many of
/// them the samples determine.
fn factor(normal: &mut [[f64; LANES]; MOST_TERMS], terms: usize, least_pivot: f64) -> usize {
    for row in 0..terms {
        for col in 0..=row {
            let rest = normal[row][col] - dot(&normal[row][..col], &normal[col][..col]);
            if col < row {
                normal[row][col] = rest / normal[col][col];
            } else if rest > least_pivot * normal[row][row] {
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
        places
            .map(|place| FieldSample { place, value: of(place[0], place[1]), weight: 1.0 })
            .collect()
    }

    #[test]
    fn a_polynomial_is_found_with_its_slope() {
        let of =
            |x: f64, y: f64| 1.0 + 0.3 * x - 0.2 * y + 0.01 * x * x * y - 0.004 * y * y * y * x;
        let field = BoardField::fit(&samples(of), 4);
        for [x, y] in [[0.0, 0.0], [8.0, 5.0], [3.5, 2.0]] {
            assert!((field.at([x, y]) - of(x, y)).abs() < 1e-9);
            let slope =
                [0.3 + 0.02 * x * y - 0.004 * y * y * y, -0.2 + 0.01 * x * x - 0.012 * y * y * x];
            assert!((0..2).all(|k| (field.slope([x, y])[k] - slope[k]).abs() < 1e-9));
        }
    }

    #[test]
    fn outliers_are_left_out_and_noise_makes_no_high_order() {
        let noise = |x: f64, y: f64| (12.9898 * x + 78.233 * y).sin() * 0.01;
        let mut seen = samples(|x, y| 2.0 + 0.1 * x + noise(x, y));
        seen[13].value += 3.0;
        seen[40].value -= 2.0;
        let field = BoardField::fit(&seen, 4);
        assert!(
            (0..9)
                .all(|col| (field.at([f64::from(col), 2.0]) - 2.0 - 0.1 * f64::from(col)).abs()
                    < 0.02)
        );
    }

    #[test]
    fn few_samples_give_a_mean_and_none_nothing() {
        let at = |col: f64, value: f64| FieldSample { place: [col, 0.0], value, weight: 1.0 };
        assert_eq!(BoardField::fit(&[], 2).at([1.0, 2.0]), 0.0);
        assert!(
            (BoardField::fit(&[at(0.0, 1.0), at(1.0, 2.0)], 2).at([5.0, 5.0]) - 1.5).abs() < 1e-12
        );
        // All samples are on one row.
        let line: Vec<FieldSample> =
            (0..20).map(|col| at(f64::from(col), f64::from(col))).collect();
        assert!(BoardField::fit(&line, 3).at([3.0, 9.0]).is_finite());
    }
}
