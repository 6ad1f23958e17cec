//! The products of sparse rows of a Jacobian, Σ jᵀj, where many rows have the same columns. Such
//! rows are gathered, and their sum is one product of dense matrices.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DMatrixView};

/// The number of gathered rows at which their products are added. Chosen, not swept: enough for a
/// fast matrix product, few enough to stay in the cache.
const ROWS_AT_ONCE: usize = 128;

/// Rows whose products are not yet added, by their columns. Rows with the same first column and the
/// same number of columns must have the same columns.
#[derive(Default)]
pub(crate) struct SparseRowProducts {
    gathered: BTreeMap<(usize, usize), RowsAlike>,
}

#[derive(Default)]
struct RowsAlike {
    columns: Vec<usize>,
    /// The values of one row after the other.
    values: Vec<f64>,
}

impl SparseRowProducts {
    /// Adds a row, given by its columns with their values. Its products are added to the upper
    /// triangle of `upper` now or with [`Self::add_all`].
    pub(crate) fn push(&mut self, row: &[(usize, f64)], upper: &mut DMatrix<f64>) {
        let Some((first, _)) = row.first() else { return };
        let alike = self.gathered.entry((*first, row.len())).or_default();
        if alike.columns.is_empty() {
            alike.columns = row.iter().map(|(column, _)| *column).collect();
        }
        alike.values.extend(row.iter().map(|(_, value)| value));
        if alike.values.len() >= ROWS_AT_ONCE * row.len() {
            alike.add(upper);
        }
    }

    /// Adds the remaining gathered rows to the upper triangle of `upper`.
    pub(crate) fn add_all(&mut self, upper: &mut DMatrix<f64>) {
        self.gathered.values_mut().for_each(|alike| alike.add(upper));
    }
}

impl RowsAlike {
    fn add(&mut self, upper: &mut DMatrix<f64>) {
        let size = self.columns.len();
        let transposed = DMatrixView::from_slice(&self.values, size, self.values.len() / size);
        let products = transposed * transposed.transpose();
        for (b, j) in self.columns.iter().enumerate() {
            for (a, i) in self.columns.iter().enumerate().take(b + 1) {
                upper[(*i.min(j), *i.max(j))] += products[(a, b)];
            }
        }
        self.values.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_the_whole_jacobian() {
        // Two kinds of rows that share columns, out of order, and more of one than are gathered at
        // once.
        let value = |row: usize, k: usize| ((row * 7 + k * 3) % 11) as f64 - 5.0;
        let columns =
            |row: usize| if row.is_multiple_of(3) { vec![1, 4, 0] } else { vec![2, 3, 4, 0] };
        let (mut products, mut upper) = (SparseRowProducts::default(), DMatrix::zeros(5, 5));
        let mut jacobian = DMatrix::zeros(500, 5);
        for row in 0..500 {
            let entries: Vec<(usize, f64)> = columns(row)
                .into_iter()
                .enumerate()
                .map(|(k, column)| (column, value(row, k)))
                .collect();
            entries.iter().for_each(|(column, value)| jacobian[(row, *column)] = *value);
            products.push(&entries, &mut upper);
        }
        products.add_all(&mut upper);
        assert_eq!(upper, (jacobian.transpose() * jacobian).upper_triangle());
    }
}
