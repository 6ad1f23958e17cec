//! Triangulation: points from rays of two or more views.

use nalgebra::{Matrix3, Matrix4, Point2, Point3, Vector3};

use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::essential::essential_from_pose;
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::pose::Pose;

/// The point, in the first camera's frame, that is nearest to both rays. `first` is in the first
/// camera's frame and `second` in the second's, of any length. `None` where the rays are parallel.
pub fn triangulate_rays(
    second_from_first: &Pose,
    first: Vector3<f64>,
    second: Vector3<f64>,
) -> Option<Point3<f64>> {
    let rotated = second_from_first.rotation().inverse() * second;
    let center = second_from_first.inverse().translation();
    // first · a − rotated · b = center in the least squares sense.
    let (ff, ft, tt) = (first.norm_squared(), first.dot(&rotated), rotated.norm_squared());
    let determinant = ff * tt - ft * ft;
    if !(determinant > 1e-14 * ff * tt) {
        return None;
    }
    let (fc, tc) = (first.dot(&center), rotated.dot(&center));
    let a = (tt * fc - ft * tc) / determinant;
    let b = (ft * fc - ff * tc) / determinant;
    Some(Point3::from(0.5 * (first * a + center + rotated * b)))
}

/// The point, in the scene's frame, with the least algebraic error to all observations (pose
/// `camera_from_scene`, normalized coordinates) (HZ section 12.2). `None` for fewer than two, or a
/// point at infinity.
pub fn triangulate_linear(seen: &[(Pose, Point2<f64>)]) -> Option<Point3<f64>> {
    if seen.len() < 2 {
        return None;
    }
    let mut normal = Matrix4::zeros();
    for (camera_from_scene, at) in seen {
        let projection = camera_from_scene.rotation_matrix().insert_column(3, 0.0);
        let mut projection = projection;
        projection.set_column(3, &camera_from_scene.translation());
        for (row, value) in [(0, at.x), (1, at.y)] {
            let equation = projection.row(2) * value - projection.row(row);
            let equation = equation.transpose().normalize();
            normal += equation * equation.transpose();
        }
    }
    let eigen = normal.symmetric_eigen();
    let x = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let point = Point3::from(x.xyz() / x.w);
    point.iter().all(|v| v.is_finite()).then_some(point)
}

/// The pair nearest to `pair`, in the sum of squared pixel distances, that satisfies `f` exactly:
/// the most likely one where both carry equal noise. P. Lindstrom, *Triangulation made easy*, 2010,
/// two iterations: the optimum of HZ algorithm 12.1 to many digits.
pub fn nearest_epipolar_pair(f: &Matrix3<f64>, pair: &PointPair) -> PointPair {
    let [first, second] = pair.homogeneous();
    let block = f.fixed_view::<2, 2>(0, 0).into_owned();
    let (in_second, in_first) = ((f * first).xy(), f.tr_mul(&second).xy());
    let a = in_second.dot(&(block * in_first));
    let b = 0.5 * (in_second.norm_squared() + in_first.norm_squared());
    let c = second.dot(&(f * first));
    let d = (b * b - a * c).max(0.0).sqrt();
    let lambda = c / (b + d).max(f64::MIN_POSITIVE);
    let next_second = in_second - block * (in_first * lambda);
    let next_first = in_first - block.transpose() * (in_second * lambda);
    let squares = next_second.norm_squared() + next_first.norm_squared();
    let lambda = lambda * 2.0 * d / squares.max(f64::MIN_POSITIVE);
    PointPair {
        first: pair.first - next_first * lambda,
        second: pair.second - next_second * lambda,
    }
}

/// The maximum-likelihood point, in the first camera's frame, of a pair of pixels with equal noise:
/// the intersection of the rays of [`nearest_epipolar_pair`]. `None` where they are parallel.
pub fn triangulate_pair(
    second_from_first: &Pose,
    cameras: [CameraMatrix; 2],
    pair: &PointPair,
) -> Option<Point3<f64>> {
    let [first, second] = [cameras[0], cameras[1]].map(|camera| camera.to_matrix().try_inverse());
    let (first, second) = (first?, second?);
    let (rotation, translation) =
        (second_from_first.rotation_matrix(), second_from_first.translation());
    let f = second.tr_mul(&essential_from_pose(&rotation, &translation)) * first;
    let [at_first, at_second] = nearest_epipolar_pair(&f, pair).homogeneous();
    triangulate_rays(second_from_first, first * at_first, second * at_second)
}

/// The angle between the rays from two cameras to a point, in radians.
pub fn parallax(first_center: &Point3<f64>, second_center: &Point3<f64>, at: &Point3<f64>) -> f64 {
    (first_center - at).angle(&(second_center - at))
}
