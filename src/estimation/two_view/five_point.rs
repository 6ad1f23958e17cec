//! The five-point algorithm for the essential matrix (D. Nistér, *An efficient solution to the
//! five-point relative pose problem*, 2004).

use nalgebra::{Matrix3, SMatrix};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::fundamental::equation;
use crate::estimation::two_view::null_space::null_space;
use crate::estimation::two_view::roots::real_roots;

/// Monomials x^a y^b z^c of degree 3 at most, in Nistér's order. After elimination of the first
/// ten, the last six of those express x², y² and xy by terms that are linear in x and y.
const MONOMIALS: [[usize; 3]; 20] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];

/// A polynomial in x, y, z by [`MONOMIALS`].
type TrivariateCubic = [f64; 20];
/// A polynomial in z, constant term first.
type PolynomialInZ = Vec<f64>;

const fn index_of_monomials() -> [[[usize; 4]; 4]; 4] {
    let mut index = [[[usize::MAX; 4]; 4]; 4];
    let mut k = 0;
    while k < 20 {
        let [a, b, c] = MONOMIALS[k];
        index[a][b][c] = k;
        k += 1;
    }
    index
}

const INDEX: [[[usize; 4]; 4]; 4] = index_of_monomials();

/// The product; the factors are such that no terms of degree above 3 occur.
fn product(p: &TrivariateCubic, q: &TrivariateCubic) -> TrivariateCubic {
    let mut result = [0.0; 20];
    for (i, a) in p.iter().enumerate().filter(|(_, a)| **a != 0.0) {
        for (j, b) in q.iter().enumerate().filter(|(_, b)| **b != 0.0) {
            let e: [usize; 3] = std::array::from_fn(|k| MONOMIALS[i][k] + MONOMIALS[j][k]);
            result[INDEX[e[0]][e[1]][e[2]]] += a * b;
        }
    }
    result
}

fn sum(p: &TrivariateCubic, q: &TrivariateCubic, factor: f64) -> TrivariateCubic {
    std::array::from_fn(|k| p[k] + factor * q[k])
}

/// The up to ten essential matrices that satisfy five pairs of normalized coordinates exactly, with
/// unit norm. Empty where the pairs are linearly dependent.
pub fn essential_from_five(pairs: &[PointPair; 5]) -> Vec<Matrix3<f64>> {
    let mut equations = SMatrix::<f64, 5, 9>::zeros();
    for (k, pair) in pairs.iter().enumerate() {
        equations.set_row(k, &equation(pair).transpose());
    }
    let Some(basis) = null_space(equations) else { return Vec::new() };
    let basis: Vec<Matrix3<f64>> =
        basis.iter().map(|e| Matrix3::from_row_slice(e.as_slice())).collect();
    let Some(reduced) = eliminated(constraints(&basis)) else { return Vec::new() };
    let rows = reduced_in_z(&reduced);
    let minor = |a: usize, b: usize, i: usize, j: usize| {
        subtract(&times(&rows[a][i], &rows[b][j]), &times(&rows[a][j], &rows[b][i]))
    };
    let mut determinant = times(&rows[0][2], &minor(1, 2, 0, 1));
    determinant = subtract(&determinant, &times(&rows[1][2], &minor(0, 2, 0, 1)));
    determinant = subtract(&determinant, &times(&rows[2][2], &minor(1, 0, 0, 1)));
    let at = |p: &PolynomialInZ, z: f64| crate::geometry::polynomial::evaluate(p, z);
    let solution = |z: f64| {
        // (x, y, 1) is the null vector of the rows at z: the cross product of two of them, here of
        // the least parallel two.
        let values = [0, 1, 2].map(|r| {
            nalgebra::Vector3::new(at(&rows[r][0], z), at(&rows[r][1], z), at(&rows[r][2], z))
        });
        let crosses = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| values[a].cross(&values[b]));
        let v = crosses.into_iter().max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        let (x, y) = (v.x / v.z, v.y / v.z);
        let e = basis[0] * x + basis[1] * y + basis[2] * z + basis[3];
        let norm = e.norm();
        (norm.is_finite() && norm > 0.0).then(|| e / norm)
    };
    real_roots(&determinant).into_iter().filter_map(solution).collect()
}

/// det E = 0 and 2 E Eᵀ E − tr(E Eᵀ) E = 0 for E = x X + y Y + z Z + W.
fn constraints(basis: &[Matrix3<f64>]) -> SMatrix<f64, 10, 20> {
    let entry = |r: usize, c: usize| {
        let mut p = [0.0; 20];
        let indices = [INDEX[1][0][0], INDEX[0][1][0], INDEX[0][0][1], INDEX[0][0][0]];
        for (index, matrix) in indices.into_iter().zip(basis) {
            p[index] = matrix[(r, c)];
        }
        p
    };
    let e: [[TrivariateCubic; 3]; 3] =
        std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)));
    let dot = |a: [&TrivariateCubic; 3], b: [&TrivariateCubic; 3]| {
        (0..3).fold([0.0; 20], |s, k| sum(&s, &product(a[k], b[k]), 1.0))
    };
    let row = |r: usize| [&e[r][0], &e[r][1], &e[r][2]];
    let gram: [[TrivariateCubic; 3]; 3] =
        std::array::from_fn(|r| std::array::from_fn(|c| dot(row(r), row(c))));
    let trace = sum(&sum(&gram[0][0], &gram[1][1], 1.0), &gram[2][2], 1.0);
    let mut rows = SMatrix::<f64, 10, 20>::zeros();
    let mut set = |k: usize, p: &TrivariateCubic| (0..20).for_each(|c| rows[(k, c)] = p[c]);
    for (r, gram_row) in gram.iter().enumerate() {
        for (c, entry) in e[r].iter().enumerate() {
            let column = [&e[0][c], &e[1][c], &e[2][c]];
            let cubed = dot([&gram_row[0], &gram_row[1], &gram_row[2]], column);
            set(3 * r + c, &sum(&cubed, &product(&trace, entry), -0.5));
        }
    }
    let minor =
        |a: usize, b: usize| sum(&product(&e[1][a], &e[2][b]), &product(&e[1][b], &e[2][a]), -1.0);
    let minors = [minor(1, 2), minor(2, 0), minor(0, 1)];
    set(9, &dot(row(0), [&minors[0], &minors[1], &minors[2]]));
    rows
}

/// Gauss–Jordan elimination with row pivoting: the identity on the first ten monomials. `None`
/// where that is not possible.
fn eliminated(mut a: SMatrix<f64, 10, 20>) -> Option<SMatrix<f64, 10, 20>> {
    for step in 0..10 {
        let row = (step..10).max_by(|p, q| a[(*p, step)].abs().total_cmp(&a[(*q, step)].abs()))?;
        if !(a[(row, step)].abs() > 1e-14) {
            return None;
        }
        a.swap_rows(step, row);
        let pivot = a.row(step) / a[(step, step)];
        a.set_row(step, &pivot);
        for r in (0..10).filter(|r| *r != step) {
            let factor = a[(r, step)];
            let rest = a.row(r) - factor * pivot;
            a.set_row(r, &rest);
        }
    }
    Some(a)
}

/// Nistér's rows k, l, m: x²z − z · x², y²z − z · y², xyz − z · xy. Each row has three polynomials
/// in z: the coefficients of x, of y, and of 1.
fn reduced_in_z(a: &SMatrix<f64, 10, 20>) -> [[PolynomialInZ; 3]; 3] {
    let row = |first: usize| {
        let (e, f) = (|c: usize| a[(first, c)], |c: usize| a[(first + 1, c)]);
        let linear = |c: usize| vec![e(c + 2), e(c + 1) - f(c + 2), e(c) - f(c + 1), -f(c)];
        let alone = vec![e(19), e(18) - f(19), e(17) - f(18), e(16) - f(17), -f(16)];
        [linear(10), linear(13), alone]
    };
    [row(4), row(6), row(8)]
}

fn times(p: &PolynomialInZ, q: &PolynomialInZ) -> PolynomialInZ {
    let mut result = vec![0.0; p.len() + q.len() - 1];
    for (i, a) in p.iter().enumerate() {
        for (j, b) in q.iter().enumerate() {
            result[i + j] += a * b;
        }
    }
    result
}

fn subtract(p: &PolynomialInZ, q: &PolynomialInZ) -> PolynomialInZ {
    let at = |p: &PolynomialInZ, k: usize| p.get(k).copied().unwrap_or(0.0);
    (0..p.len().max(q.len())).map(|k| at(p, k) - at(q, k)).collect()
}
