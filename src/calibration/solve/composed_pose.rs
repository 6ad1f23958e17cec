//! The composition of two poses, with its standard deviations.

use nalgebra::{Matrix3, Vector3};

use crate::calibration::result::Extrinsics;

/// `a_from_c` from `a_from_b` and `b_from_c`, whose errors are taken as independent: a rotation of
/// c about b's axes is rotated into a, and a rotation of b about a's axes moves c by the lever
/// between them.
pub(super) fn through(a_from_b: &Extrinsics, b_from_c: &Extrinsics) -> Extrinsics {
    let a_from_b_rotation = a_from_b.target_from_source.rotation_matrix();
    let lever = a_from_b_rotation * b_from_c.target_from_source.translation();
    let variance = |std: [f64; 3]| Matrix3::from_diagonal(&Vector3::from(std).map(|s| s * s));
    let carried = |std: [f64; 3]| a_from_b_rotation * variance(std) * a_from_b_rotation.transpose();
    let rotation = variance(a_from_b.rotation_std) + carried(b_from_c.rotation_std);
    let by_lever = lever.cross_matrix();
    let translation = variance(a_from_b.translation_std_m)
        + carried(b_from_c.translation_std_m)
        + by_lever * variance(a_from_b.rotation_std) * by_lever.transpose();
    let std = |covariance: Matrix3<f64>| covariance.diagonal().map(|v| v.max(0.0).sqrt()).into();
    Extrinsics {
        target: a_from_b.target.clone(),
        source: b_from_c.source.clone(),
        target_from_source: a_from_b.target_from_source * b_from_c.target_from_source,
        rotation_std: std(rotation),
        translation_std_m: std(translation),
    }
}
