//! The fundamental matrix: x₂ᵀ F x₁ = 0 for every pair of pixels that show one point.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::null_space::null_space;
use crate::estimation::two_view::roots::real_roots;
use crate::geometry::homography::smallest_eigenvector;

/// The normalized eight-point algorithm (HZ algorithm 11.1): the least algebraic error over at
/// least 8 `pairs`, rank 2 enforced, unit Frobenius norm. `None` for fewer, or where the pairs do
/// not determine F.
pub fn fundamental_from_many(pairs: &[PointPair]) -> Option<Matrix3<f64>> {
    weighted_fundamental(pairs, |_| 1.0)
}

/// As [`fundamental_from_many`], with a weight for each pair.
pub(super) fn weighted_fundamental(
    pairs: &[PointPair],
    weight: impl Fn(usize) -> f64,
) -> Option<Matrix3<f64>> {
    if pairs.len() < 8 {
        return None;
    }
    let normalizing = Normalizing::of(pairs)?;
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (k, pair) in pairs.iter().enumerate() {
        let row = equation(&normalizing.apply(pair));
        normal.ger(weight(k), &row, &row, 1.0);
    }
    let f = smallest_eigenvector(&normal)?;
    normalizing.undo(&with_rank_two(&Matrix3::from_row_slice(f.as_slice())))
}

/// The seven-point algorithm (HZ section 11.1.2): the one or three matrices of rank 2 that satisfy
/// all seven pairs. Empty where the pairs are linearly dependent.
pub fn fundamental_from_seven(pairs: &[PointPair; 7]) -> Vec<Matrix3<f64>> {
    let Some(normalizing) = Normalizing::of(pairs) else { return Vec::new() };
    let mut equations = SMatrix::<f64, 7, 9>::zeros();
    for (k, pair) in pairs.iter().enumerate() {
        equations.set_row(k, &equation(&normalizing.apply(pair)).transpose());
    }
    let Some(basis) = null_space(equations) else { return Vec::new() };
    let [first, second] = [0, 1].map(|k| Matrix3::from_row_slice(basis[k].as_slice()));
    // det(first + a · second) is a cubic in a: from its values at 0, 1 and −1, and its leading
    // coefficient.
    let at = |a: f64| (first + second * a).determinant();
    let (at_0, at_1, at_m, end) = (at(0.0), at(1.0), at(-1.0), second.determinant());
    let even = 0.5 * (at_1 + at_m) - at_0;
    let odd = 0.5 * (at_1 - at_m) - end;
    let matrices = real_roots(&[at_0, odd, even, end]).into_iter().map(|a| first + second * a);
    matrices.filter_map(|f| normalizing.undo(&f)).collect()
}

/// The Sampson distance of a pair from satisfying `f`, signed, in pixels: the distance to first
/// order (HZ equation 11.9).
pub fn sampson_distance_px(f: &Matrix3<f64>, pair: &PointPair) -> f64 {
    let [first, second] = pair.homogeneous();
    let (in_second, in_first) = (f * first, f.tr_mul(&second));
    let squares = in_second.xy().norm_squared() + in_first.xy().norm_squared();
    second.dot(&in_second) / squares.sqrt().max(f64::MIN_POSITIVE)
}

/// The epipole of the first image: the projection of the second camera's center, homogeneous.
pub fn epipole_in_first(f: &Matrix3<f64>) -> Vector3<f64> {
    // It is orthogonal to all rows: the cross product of the least parallel two.
    let row = |k: usize| f.row(k).transpose();
    let products = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| row(a).cross(&row(b)));
    let longest = products.into_iter().max_by(|a, b| a.norm().total_cmp(&b.norm()));
    longest.map_or_else(Vector3::zeros, |epipole| epipole.normalize())
}

/// The nearest matrix of rank 2 in the Frobenius norm.
fn with_rank_two(f: &Matrix3<f64>) -> Matrix3<f64> {
    let mut svd = f.svd(true, true);
    svd.singular_values[2] = 0.0;
    svd.recompose().unwrap_or(*f)
}

/// x₂ᵀ F x₁ = 0 as a row over F's entries, row by row.
pub(super) fn equation(pair: &PointPair) -> SVector<f64, 9> {
    let [first, second] = pair.homogeneous();
    SVector::<f64, 9>::from_fn(|k, _| second[k / 3] * first[k % 3])
}

/// Similarities that bring the points of each image to mean 0 and mean squared distance 2.
struct Normalizing {
    first: Matrix3<f64>,
    second: Matrix3<f64>,
}

impl Normalizing {
    fn of(pairs: &[PointPair]) -> Option<Self> {
        let n = pairs.len() as f64;
        let similarity = |at: fn(&PointPair) -> nalgebra::Point2<f64>| {
            let mean = pairs.iter().map(|p| at(p).coords).sum::<nalgebra::Vector2<f64>>() / n;
            let squares = pairs.iter().map(|p| (at(p).coords - mean).norm_squared()).sum::<f64>();
            let scale = (2.0 * n / squares).sqrt();
            let usable = scale.is_finite() && scale > 0.0;
            usable.then(|| {
                Matrix3::new(
                    scale,
                    0.0,
                    -scale * mean.x,
                    0.0,
                    scale,
                    -scale * mean.y,
                    0.0,
                    0.0,
                    1.0,
                )
            })
        };
        Some(Self { first: similarity(|p| p.first)?, second: similarity(|p| p.second)? })
    }

    fn apply(&self, pair: &PointPair) -> PointPair {
        let [first, second] = pair.homogeneous();
        let point = |v: Vector3<f64>| nalgebra::Point2::new(v.x, v.y);
        PointPair { first: point(self.first * first), second: point(self.second * second) }
    }

    /// F for pixels from F for normalized points, with unit norm; `None` if that is not finite.
    fn undo(&self, f: &Matrix3<f64>) -> Option<Matrix3<f64>> {
        let f = self.second.tr_mul(f) * self.first;
        let norm = f.norm();
        (norm.is_finite() && norm > 0.0).then(|| f / norm)
    }
}
