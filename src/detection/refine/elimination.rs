//! Solving the small normal equations of a corner, by eliminating one unknown after the other.

use crate::detection::refine::corner_model::UNKNOWNS;

/// The derivatives by each unknown, then the residual.
pub(super) const COLUMNS: usize = UNKNOWNS + 1;
/// Length of a row, padded to whole vectors.
const ROOM: usize = 12;
const LANES: usize = 4;

/// Sums of products of columns with each other; the upper triangle is used.
pub(super) type RowProducts = [[f64; ROOM]; COLUMNS];

/// The solution of the normal equations.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solved {
    /// The step in the unknowns.
    pub step: [f64; UNKNOWNS],
    /// The remaining sum of squares.
    pub left: f64,
    /// Covariance of the last two unknowns, the block of the inverse: xx, xy, yy.
    pub last_covariance: [f64; 3],
}

/// Solves the least squares problem of `products`, whose last column is the residual, with its
/// diagonal increased by the fraction `damping`; `None` unless every unknown is determined.
pub(super) fn solve(products: &RowProducts, damping: f64) -> Option<Solved> {
    pulp::Arch::new().dispatch(Elimination { products, damping })
}

/// A struct, not a closure: all of it must be inlined to be compiled for the processor.
struct Elimination<'a> {
    products: &'a RowProducts,
    damping: f64,
}

impl pulp::NullaryFnOnce for Elimination<'_> {
    type Output = Option<Solved>;

    #[inline(always)]
    fn call(self) -> Option<Solved> {
        let Self { products, damping } = self;
        let least: [f64; UNKNOWNS] = std::array::from_fn(|k| 1e-9 * products[k][k]);
        let mut rows = *products;
        for k in 0..UNKNOWNS {
            rows[k][k] += damping * products[k][k];
        }
        // The reciprocals of the pivots.
        let mut inverse = [0.0; UNKNOWNS];
        eliminate::<0>(&mut rows, &mut inverse, &least)?;
        eliminate::<1>(&mut rows, &mut inverse, &least)?;
        eliminate::<2>(&mut rows, &mut inverse, &least)?;
        eliminate::<3>(&mut rows, &mut inverse, &least)?;
        eliminate::<4>(&mut rows, &mut inverse, &least)?;
        eliminate::<5>(&mut rows, &mut inverse, &least)?;
        eliminate::<6>(&mut rows, &mut inverse, &least)?;
        eliminate::<7>(&mut rows, &mut inverse, &least)?;
        eliminate::<8>(&mut rows, &mut inverse, &least)?;
        let mut step: [f64; UNKNOWNS] = std::array::from_fn(|k| rows[k][UNKNOWNS]);
        for k in (1..UNKNOWNS).rev() {
            for row in 0..k {
                step[row] -= rows[row][k] * step[k];
            }
        }
        let (last, before) = (UNKNOWNS - 1, UNKNOWNS - 2);
        let mixed = rows[before][last];
        let yy = inverse[last];
        Some(Solved {
            step,
            left: rows[UNKNOWNS][UNKNOWNS].max(0.0),
            last_covariance: [inverse[before] + mixed * mixed * yy, -mixed * yy, yy],
        })
    }
}

/// Eliminates unknown `K` and divides its row by the pivot; `None` if the pivot is not above
/// `least`. `K` is a constant, so that rows stay in registers from one step to the next.
#[inline(always)]
fn eliminate<const K: usize>(
    rows: &mut RowProducts,
    inverse: &mut [f64; UNKNOWNS],
    least: &[f64; UNKNOWNS],
) -> Option<()> {
    let eliminated = rows[K];
    if !(eliminated[K] > least[K] && eliminated[K].is_finite()) {
        return None;
    }
    inverse[K] = 1.0 / eliminated[K];
    for value in &mut rows[K] {
        *value *= inverse[K];
    }
    let scaled = rows[K];
    for row in K + 1..COLUMNS {
        for lane in row / LANES * LANES..ROOM {
            rows[row][lane] -= eliminated[row] * scaled[lane];
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of a hundred samples, in no order that repeats.
    fn products() -> RowProducts {
        let mut products = [[0.0; ROOM]; COLUMNS];
        for i in 0..100 {
            let at = |k: usize| (f64::from(i) * (0.7 + 0.31 * k as f64) + (k * k) as f64).sin();
            for (row, sums) in products.iter_mut().enumerate() {
                for (col, sum) in sums[..COLUMNS].iter_mut().enumerate().skip(row) {
                    *sum += at(row) * at(col);
                }
            }
        }
        products
    }

    fn of(products: &RowProducts, row: usize, col: usize) -> f64 {
        products[row.min(col)][row.max(col)]
    }

    #[test]
    fn a_step_leaves_the_columns_nothing_to_explain() {
        let products = products();
        let solved = solve(&products, 0.0).expect("independent columns");
        let mut left = of(&products, UNKNOWNS, UNKNOWNS);
        for row in 0..UNKNOWNS {
            let explained: f64 =
                (0..UNKNOWNS).map(|col| of(&products, row, col) * solved.step[col]).sum();
            assert!((explained - of(&products, row, UNKNOWNS)).abs() < 1e-9);
            left -= solved.step[row] * of(&products, row, UNKNOWNS);
        }
        assert!((solved.left - left).abs() < 1e-9 && left > 0.0);
    }

    #[test]
    fn the_covariance_is_the_inverse_s_last_block() {
        let products = products();
        let covariance = solve(&products, 0.0).expect("independent columns").last_covariance;
        // The inverse's columns are the solutions for unit right sides.
        let of_unit = |unknown: usize| {
            let mut unit = products;
            for (row, sums) in unit.iter_mut().enumerate() {
                sums[UNKNOWNS] = f64::from(row == unknown);
            }
            solve(&unit, 0.0).expect("independent columns").step
        };
        let (last, before) = (of_unit(UNKNOWNS - 1), of_unit(UNKNOWNS - 2));
        let expected = [before[UNKNOWNS - 2], before[UNKNOWNS - 1], last[UNKNOWNS - 1]];
        assert!(covariance.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn dependent_columns_determine_nothing() {
        let mut products = products();
        for row in 0..COLUMNS {
            // The fourth column as the first once more.
            let (like, here) = (of(&products, 0, row), row);
            products[here.min(3)][here.max(3)] = like;
        }
        products[3][3] = products[0][0];
        assert!(solve(&products, 0.0).is_none());
        assert!(solve(&[[f64::NAN; ROOM]; COLUMNS], 0.1).is_none());
    }
}
