//! The essential matrix: F of normalized coordinates, with two equal singular values.

use nalgebra::{Matrix3, Vector3};

use crate::estimation::two_view::PointPair;
pub use crate::estimation::two_view::five_point::essential_from_five;
use crate::estimation::two_view::fundamental::fundamental_from_many;
use crate::geometry::camera_matrix::CameraMatrix;

/// E = K₂ᵀ F K₁ (HZ equation 9.12), not yet with equal singular values.
pub fn essential_from_fundamental(
    f: &Matrix3<f64>,
    first: CameraMatrix,
    second: CameraMatrix,
) -> Matrix3<f64> {
    let e = second.to_matrix().tr_mul(f) * first.to_matrix();
    e / e.norm()
}

/// E of a rotation and a translation `second_from_first`: `[t]`ₓ R (HZ equation 9.11).
pub fn essential_from_pose(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Matrix3<f64> {
    translation.cross_matrix() * rotation
}

/// From at least 8 pairs of normalized coordinates (HZ section 9.6): the nearest essential matrix
/// to the result of the eight-point algorithm.
pub fn essential_from_many(pairs: &[PointPair]) -> Option<Matrix3<f64>> {
    Some(nearest_essential(&fundamental_from_many(pairs)?))
}

/// The nearest matrix with singular values s, s, 0, scaled to √2 · s = 1.
pub fn nearest_essential(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let mut svd = matrix.svd(true, true);
    svd.singular_values = Vector3::new(1.0, 1.0, 0.0) / f64::sqrt(2.0);
    svd.recompose().unwrap_or(*matrix)
}

/// The difference of the two nonzero singular values of `matrix`, over their sum: 0 for an
/// essential matrix, at most 1.
pub fn singular_gap(matrix: &Matrix3<f64>) -> f64 {
    let s = matrix.singular_values();
    (s[0] - s[1]) / (s[0] + s[1]).max(f64::MIN_POSITIVE)
}
