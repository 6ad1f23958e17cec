//! Resection: the pose of a camera with a known lens from known points. Minimal samples of three
//! points in RANSAC, then all inliers.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::estimation::two_view::ransac::{
    Consensus, RansacOptions, SampledModel, chance_in_disk, ransac,
};
use crate::estimation::two_view::real_roots;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{Bearing, ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// A known point and its pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointInImage {
    /// In the scene's frame.
    pub point: Point3<f64>,
    /// Where it was observed.
    pub pixel: Pixel,
}

/// The up to four poses `camera_from_scene` in which three points lie along three bearings (J.
/// Grunert, 1841, as in R. Haralick et al., *Review and analysis of solutions of the three point
/// perspective pose estimation problem*, 1994, equations 9 and 10).
pub fn poses_from_three(points: &[Point3<f64>; 3], bearings: &[Bearing; 3]) -> Vec<Pose> {
    let square = |i: usize, j: usize| (points[i] - points[j]).norm_squared();
    let (a2, b2, c2) = (square(1, 2), square(0, 2), square(0, 1));
    if !(a2.min(b2).min(c2) > 0.0) {
        return Vec::new();
    }
    let cosine = |i: usize, j: usize| bearings[i].dot(&bearings[j]);
    let (alpha, beta, gamma) = (cosine(1, 2), cosine(0, 2), cosine(0, 1));
    let (p, q) = ((a2 - c2) / b2, (a2 + c2) / b2);
    let quartic = [
        (1.0 + p).powi(2) - 4.0 * a2 / b2 * gamma * gamma,
        4.0 * (-p * (1.0 + p) * beta + 2.0 * a2 / b2 * gamma * gamma * beta
            - (1.0 - q) * alpha * gamma),
        2.0 * (p * p - 1.0 + 2.0 * p * p * beta * beta + 2.0 * (b2 - c2) / b2 * alpha * alpha
            - 4.0 * q * alpha * beta * gamma
            + 2.0 * (b2 - a2) / b2 * gamma * gamma),
        4.0 * (p * (1.0 - p) * beta - (1.0 - q) * alpha * gamma
            + 2.0 * c2 / b2 * alpha * alpha * beta),
        (p - 1.0).powi(2) - 4.0 * c2 / b2 * alpha * alpha,
    ];
    let pose = |v: f64| {
        let u = ((p - 1.0) * v * v - 2.0 * p * beta * v + 1.0 + p) / (2.0 * (gamma - v * alpha));
        let first = (b2 / (1.0 + v * v - 2.0 * v * beta)).sqrt();
        let lengths = [first, u * first, v * first];
        let usable = lengths.iter().all(|length| length.is_finite() && *length > 0.0);
        usable.then(|| {
            let k = |k: usize| Point3::from(bearings[k].into_inner() * lengths[k]);
            aligned(points, &[k(0), k(1), k(2)])
        })?
    };
    real_roots(&quartic).into_iter().filter_map(pose).collect()
}

/// The rigid motion that maps three points to those of a congruent triangle.
fn aligned(from: &[Point3<f64>; 3], to: &[Point3<f64>; 3]) -> Option<Pose> {
    let frame = |p: &[Point3<f64>; 3]| {
        let x = (p[1] - p[0]).try_normalize(1e-12)?;
        let z = x.cross(&(p[2] - p[0])).try_normalize(1e-12)?;
        Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
    };
    let rotation = frame(to)? * frame(from)?.transpose();
    Some(Pose::from_matrix(&rotation, to[0].coords - rotation * from[0].coords))
}

/// The pose `camera_from_scene` whose inliers among `seen` are the least likely to arise by chance;
/// `None` where chance explains them.
pub fn resect(seen: &[PointInImage], lens: &Lens, size: ImageSize) -> Option<Consensus<Pose>> {
    let bearings = seen.iter().map(|seen| lens.bearing_from_pixel(seen.pixel)).collect();
    let options =
        RansacOptions { max_samples: 400, max_limit_px: 12.0, ..RansacOptions::default() };
    ransac(&Resection { seen, bearings, lens, size }, &options)
}

struct Resection<'a> {
    seen: &'a [PointInImage],
    bearings: Vec<Option<Bearing>>,
    lens: &'a Lens,
    size: ImageSize,
}

impl SampledModel for Resection<'_> {
    type Model = Pose;
    const SAMPLE: usize = 3;

    fn count(&self) -> usize {
        self.seen.len()
    }

    fn fit_sample(&self, sample: &[usize]) -> Vec<Pose> {
        let bearings = [0, 1, 2].map(|k| self.bearings[sample[k]]);
        let [Some(a), Some(b), Some(c)] = bearings else { return Vec::new() };
        poses_from_three(&[0, 1, 2].map(|k| self.seen[sample[k]].point), &[a, b, c])
    }

    /// One Gauss–Newton step on the reprojection errors.
    fn fit_inliers(&self, camera_from_scene: &Pose, inliers: &[usize]) -> Option<Pose> {
        let (mut normal, mut gradient) =
            (nalgebra::Matrix6::<f64>::zeros(), nalgebra::Vector6::<f64>::zeros());
        for k in inliers {
            let seen = &self.seen[*k];
            let in_camera = *camera_from_scene * seen.point;
            let Some(projection) = self.lens.project(&in_camera) else { continue };
            let residual = projection.pixel.to_vector() - seen.pixel.to_vector();
            let rotated = in_camera.coords - camera_from_scene.translation();
            let mut by_pose = nalgebra::Matrix2x6::zeros();
            let by_rotation = -projection.by_point * rotated.cross_matrix();
            by_pose.fixed_columns_mut::<3>(0).copy_from(&by_rotation);
            by_pose.fixed_columns_mut::<3>(3).copy_from(&projection.by_point);
            normal += by_pose.tr_mul(&by_pose);
            gradient += by_pose.tr_mul(&residual);
        }
        let step = normal.cholesky()?.solve(&gradient);
        let part = |k: usize| -Vector3::new(step[k], step[k + 1], step[k + 2]);
        let rotation = nalgebra::UnitQuaternion::from_scaled_axis(part(0));
        let translation = camera_from_scene.translation() + part(3);
        Some(Pose::new(rotation * camera_from_scene.rotation(), translation))
    }

    fn squared_residual_px2(&self, camera_from_scene: &Pose, index: usize) -> f64 {
        let seen = &self.seen[index];
        let pixel = self.lens.pixel_from_point(&(*camera_from_scene * seen.point));
        pixel.map_or(f64::INFINITY, |p| (p.to_vector() - seen.pixel.to_vector()).norm_squared())
    }

    fn chance(&self, limit_px: f64) -> f64 {
        chance_in_disk(self.size, limit_px)
    }

    fn max_solutions(&self) -> f64 {
        4.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_points_give_the_pose_that_saw_them() {
        let camera_from_scene =
            Pose::from_axis_angle(Vector3::new(0.3, -0.5, 0.2), Vector3::new(0.1, 0.4, 5.0));
        let points =
            [Point3::new(-1.0, 0.2, 0.3), Point3::new(0.9, -0.7, 0.1), Point3::new(0.2, 1.1, -0.6)];
        let bearings = points.map(|p| Bearing::new_normalize((camera_from_scene * p).coords));
        let poses = poses_from_three(&points, &bearings);
        let error = |found_from_scene: &Pose| {
            found_from_scene.angle_to(&camera_from_scene)
                + (found_from_scene.translation() - camera_from_scene.translation()).norm()
        };
        assert!(poses.iter().any(|pose| error(pose) < 1e-9), "{poses:?}");
        assert!(poses_from_three(&[points[0]; 3], &bearings).is_empty());
    }
}
