//! The null space of a few equations by elimination, for minimal solvers.

use nalgebra::{SMatrix, SVector};

/// A pivot smaller than this part of the greatest entry is 0: the equations are linearly dependent.
const LEAST_PIVOT: f64 = 1e-10;

/// A basis of the solutions of `a` x = 0, N − M vectors of unit length, by Gauss–Jordan elimination
/// with full pivoting. `None` where the equations are linearly dependent.
pub(super) fn null_space<const M: usize, const N: usize>(
    mut a: SMatrix<f64, M, N>,
) -> Option<Vec<SVector<f64, N>>> {
    let mut order: [usize; N] = std::array::from_fn(|k| k);
    let greatest = a.amax();
    for step in 0..M {
        let rest = (step..M).flat_map(|r| (step..N).map(move |c| (r, c)));
        let (row, column) =
            rest.max_by(|p, q| a[*p].abs().total_cmp(&a[*q].abs())).unwrap_or((step, step));
        if !(a[(row, column)].abs() > LEAST_PIVOT * greatest) {
            return None;
        }
        a.swap_rows(step, row);
        a.swap_columns(step, column);
        order.swap(step, column);
        let pivot = a.row(step) / a[(step, step)];
        a.set_row(step, &pivot);
        for r in (0..M).filter(|r| *r != step) {
            let factor = a[(r, step)];
            let eliminated = a.row(r) - factor * pivot;
            a.set_row(r, &eliminated);
        }
    }
    let solution = |free: usize| {
        let mut x = SVector::<f64, N>::zeros();
        x[order[free]] = 1.0;
        for step in 0..M {
            x[order[step]] = -a[(step, free)];
        }
        x.normalize()
    };
    Some((M..N).map(solution).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_its_equations() {
        let a = SMatrix::<f64, 3, 5>::from_fn(|r, c| {
            ((r * r * 7 + c * c * 3 + r * c * 5 + 1) as f64).sin()
        });
        let basis = null_space(a).unwrap();
        assert_eq!(basis.len(), 2);
        for x in basis {
            assert!((a * x).amax() < 1e-14);
        }
        let dependent = SMatrix::<f64, 2, 3>::new(1.0, 2.0, 3.0, 2.0, 4.0, 6.0);
        assert!(null_space(dependent).is_none());
    }
}
