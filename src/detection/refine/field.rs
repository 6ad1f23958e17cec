//! A quantity that varies smoothly over a board: a polynomial in column and row, fitted to the
//! corners' measurements, of the order that predicts a left-out corner best.

use crate::detection::refine::field_sums::{
    FieldSums, LANES, MOST_TERMS, Solution, TERMS, highest_order, trust,
};

/// Pivot threshold relative to the diagonal; rejects near-collinear basis terms.
pub(super) const LEAST_PIVOT: f64 = 1e-6;
/// Rounds of weighted least squares, for robust weights.
const ROUNDS: usize = 2;
/// The power of column and row in each term.
const POWERS: [[usize; 2]; MOST_TERMS] = [
    [0, 0],
    [1, 0],
    [0, 1],
    [2, 0],
    [1, 1],
    [0, 2],
    [3, 0],
    [2, 1],
    [1, 2],
    [0, 3],
    [4, 0],
    [3, 1],
    [2, 2],
    [1, 3],
    [0, 4],
];
/// Powers 0 … 4 of a term, and 0 … 8 of a product of two terms; the lanes pad them to whole
/// vectors.
const TERM_POWERS: usize = 5;
const PRODUCT_POWERS: usize = 9;
const TERM_LANES: usize = 8;
const PRODUCT_LANES: usize = 12;

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
    pub(super) scale: [f64; 2],
    pub(super) solution: Solution,
}

impl BoardField {
    /// Fits a field of `order` at most; 0 everywhere if there are no samples.
    pub fn fit(samples: &[FieldSample], order: usize) -> Self {
        let mut field = Self::spanning(samples);
        let order = highest_order(samples.len(), order);
        let mut mean_square = f64::INFINITY;
        for _ in 0..ROUNDS {
            let sums =
                pulp::Arch::new().dispatch(FieldSummation { field: &field, samples, mean_square });
            let Some(solved) = sums.solve(order, samples.len(), LEAST_PIVOT) else { break };
            (field.solution, mean_square) =
                (solved.solution, solved.mean_square.max(f64::MIN_POSITIVE));
        }
        field
    }

    /// An empty field over the places of `samples`.
    pub(super) fn spanning(samples: &[FieldSample]) -> Self {
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

    pub(super) fn scaled(&self, place: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (place[k] - self.middle[k]) * self.scale[k])
    }

    /// The field along the row at scaled place `y`, as a polynomial of the scaled column.
    #[inline(always)]
    fn along_row(&self, y: f64) -> [f64; TERM_POWERS] {
        let y = powers(y);
        let mut along = [0.0; TERM_POWERS];
        for ([col, row], coefficient) in POWERS.into_iter().zip(self.solution.coefficients) {
            along[col] += coefficient * y[row];
        }
        along
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
///
/// The normal equations are moments: sums of weights times a power of the column times a power of
/// the row, 45 different ones for 120 entries. Within a row of the board only the column's powers
/// differ, so that a corner takes five vectors in place of 40.
struct FieldSummation<'a> {
    field: &'a BoardField,
    samples: &'a [FieldSample],
    mean_square: f64,
}

impl pulp::NullaryFnOnce for FieldSummation<'_> {
    type Output = FieldSums;

    #[inline(always)]
    fn call(self) -> FieldSums {
        let Self { field, samples, mean_square } = self;
        let mut sums = FieldSums::default();
        let mut moments = Moments::default();
        let mut row = RowMoments::default();
        let mut row_place = f64::NAN;
        let mut row_field = [0.0; TERM_POWERS];
        for &FieldSample { place, value, weight } in samples {
            if place[1] != row_place {
                moments.add(&std::mem::take(&mut row));
                row_place = place[1];
                row.y = (row_place - field.middle[1]) * field.scale[1];
                row_field = field.along_row(row.y);
            }
            let x = powers((place[0] - field.middle[0]) * field.scale[0]);
            let [c0, c1, c2, c3, c4] = row_field;
            let off = value - ((c0 + c1 * x[1]) + (c2 * x[2] + c3 * x[3]) + c4 * x[4]);
            let trust =
                if mean_square.is_finite() { trust(weight * off * off, mean_square) } else { 1.0 };
            sums.trust += trust;
            sums.squares += row.add(&x, value, trust * weight);
        }
        moments.add(&row);
        moments.fill(&mut sums);
        sums
    }
}

/// Sums over one row of the board, whose scaled place is `y`.
#[derive(Debug, Default)]
struct RowMoments {
    y: f64,
    /// Of weights times each power of the column.
    weights: [f64; PRODUCT_LANES],
    /// Of weighted values times each power of the column.
    values: [f64; TERM_LANES],
}

impl RowMoments {
    /// Adds a sample at these powers of its column; returns its weighted square.
    #[inline(always)]
    fn add(&mut self, x: &[f64; PRODUCT_LANES], value: f64, weight: f64) -> f64 {
        for (sum, power) in self.weights.iter_mut().zip(x) {
            *sum += weight * power;
        }
        let weighted = weight * value;
        for (sum, power) in self.values.iter_mut().zip(x) {
            *sum += weighted * power;
        }
        weighted * value
    }
}

/// Sums over the board, by the power of the row, then of the column.
#[derive(Debug, Default)]
struct Moments {
    weights: [[f64; PRODUCT_LANES]; PRODUCT_POWERS],
    values: [[f64; TERM_LANES]; TERM_POWERS],
}

impl Moments {
    #[inline(always)]
    fn add(&mut self, row: &RowMoments) {
        let y = powers(row.y);
        for (sums, y) in self.weights.iter_mut().zip(y) {
            for (sum, of_row) in sums.iter_mut().zip(row.weights) {
                *sum += y * of_row;
            }
        }
        for (sums, y) in self.values.iter_mut().zip(y) {
            for (sum, of_row) in sums.iter_mut().zip(row.values) {
                *sum += y * of_row;
            }
        }
    }

    /// The upper triangle of the normal equations, and their right sides.
    #[inline(always)]
    fn fill(&self, sums: &mut FieldSums) {
        for (row, [row_x, row_y]) in POWERS.into_iter().enumerate() {
            for (col, [x, y]) in POWERS.into_iter().enumerate().skip(row) {
                sums.normal[row][col] = self.weights[row_y + y][row_x + x];
            }
            sums.right[row] = self.values[row_y][row_x];
        }
    }
}

/// The powers 0 … 8 of `x`, and three more.
#[inline(always)]
fn powers(x: f64) -> [f64; PRODUCT_LANES] {
    let x2 = x * x;
    let (x3, x4) = (x2 * x, x2 * x2);
    let x8 = x4 * x4;
    [1.0, x, x2, x3, x4, x4 * x, x4 * x2, x4 * x3, x8, x8 * x, x8 * x2, x8 * x3]
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

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
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
