//! The relative pose from an essential matrix: of four poses the one with the points in front of
//! both cameras (HZ section 9.6.2).

use nalgebra::{Matrix3, Vector3};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::triangulation::triangulate_rays;
use crate::geometry::pose::Pose;

/// The relative pose of two cameras, and its support.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativePose {
    /// The translation has unit length: its true length is not determined.
    pub second_from_first: Pose,
    /// The number of pairs in front of both cameras.
    pub in_front: usize,
}

/// The four poses `second_from_first` of an essential matrix (HZ result 9.19), with unit
/// translations.
pub fn poses_from_essential(e: &Matrix3<f64>) -> Option<[Pose; 4]> {
    let svd = e.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    // The sign of E is arbitrary: choose rotations with determinant 1.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let rotations = [u * w * v_t, u * w.transpose() * v_t];
    let translation: Vector3<f64> = u.column(2).into_owned();
    let usable = u.iter().chain(v_t.iter()).all(|v| v.is_finite());
    usable.then(|| {
        [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)]
            .map(|(k, sign)| Pose::from_matrix(&rotations[k], translation * sign))
    })
}

/// Of the four poses, the one with the most of `pairs` (normalized coordinates) in front of both
/// cameras; `None` if no pair is.
pub fn pose_from_essential(e: &Matrix3<f64>, pairs: &[PointPair]) -> Option<RelativePose> {
    let poses = poses_from_essential(e)?.map(|second_from_first| {
        let in_front = |pair: &&PointPair| is_in_front(&second_from_first, pair);
        RelativePose { second_from_first, in_front: pairs.iter().filter(in_front).count() }
    });
    // Among equals, the first.
    let best = poses.into_iter().rev().max_by_key(|pose| pose.in_front)?;
    (best.in_front > 0).then_some(best)
}

fn is_in_front(second_from_first: &Pose, pair: &PointPair) -> bool {
    let [first, second] = pair.homogeneous();
    triangulate_rays(second_from_first, first, second)
        .is_some_and(|point| point.z > 0.0 && (*second_from_first * point).z > 0.0)
}
