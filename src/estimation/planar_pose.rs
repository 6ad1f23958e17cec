//! The pose of a board from the directions of its points in a camera with a known lens: linear, for
//! any field of view.
//!
//! Each direction b gives b × (M X) = 0 for the unknown projection M in homogeneous board
//! coordinates X (the DLT with directions in place of pixels, so that points beside the camera are
//! as good as others). For a flat board M = [r1 r2 t], with eight unknowns and a scale; for points
//! in space M = [R t], with twelve.

use nalgebra::{DMatrix, Matrix3, Matrix3x4, Point3, SMatrix, Vector3};

use crate::estimation::zhang;
use crate::geometry::homography::smallest_eigenvector;
use crate::geometry::pixel::Bearing;
use crate::geometry::pose::Pose;

/// Points with a smaller ratio of breadth to length lie on a line.
const LEAST_BREADTH: f64 = 1e-4;

/// Points with a smaller ratio of thickness to width are treated as coplanar, also those of an
/// uneven board, for a start. Swept with boards 150 px wide and corners known to 0.1 px: started as
/// a plane, none of 200 poses is wrong up to 0.1 (32 at 0.2); started as points in space, none from
/// 0.003 on (23 at 0.001, 84 at 1e-4).
const LEAST_THICKNESS: f64 = 1e-2;

/// The frame in which a set of points is flat.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    /// On a plane: z = 0 in this frame.
    Flat {
        /// To the frame whose xy plane contains the points, with the origin at their mean.
        plane_from_board: Pose,
        /// 1 over the points' rms distance from the mean.
        scale: f64,
    },
    /// In space.
    Solid {
        /// The points' mean.
        center: Point3<f64>,
        /// 1 over the points' rms distance from the mean.
        scale: f64,
    },
}

impl Shape {
    /// `None` for points on a line or in one place, or fewer than 4.
    pub(crate) fn of(points: &[Point3<f64>]) -> Option<Self> {
        if points.len() < 4 {
            return None;
        }
        let n = points.len() as f64;
        let center =
            Point3::from(points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / n);
        let mut scatter = Matrix3::zeros();
        let mut tilted = false;
        for p in points {
            let d = p - center;
            scatter += d * d.transpose();
            tilted |= p.z != 0.0;
        }
        let scale = (n / scatter.trace()).sqrt();
        if !scale.is_finite() {
            return None;
        }
        if !tilted {
            let trace = scatter[(0, 0)] + scatter[(1, 1)];
            let area = scatter[(0, 0)] * scatter[(1, 1)] - scatter[(0, 1)] * scatter[(0, 1)];
            let plane_from_board = Pose::new(nalgebra::UnitQuaternion::identity(), -center.coords);
            return (area > 1e-8 * trace * trace).then_some(Self::Flat { plane_from_board, scale });
        }
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let widths = order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt());
        if widths[1] < LEAST_BREADTH * widths[0] {
            return None;
        }
        if widths[2] > LEAST_THICKNESS * widths[0] {
            return (points.len() >= 6).then_some(Self::Solid { center, scale });
        }
        let (x, y) = (
            eigen.eigenvectors.column(order[0]).into_owned(),
            eigen.eigenvectors.column(order[1]).into_owned(),
        );
        let mut z = x.cross(&y);
        let (mut y, zed) = (y, z.z);
        // Oriented like the board's own z axis, so that front and back are kept.
        if zed < 0.0 {
            (y, z) = (-y, -z);
        }
        let rotation = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
        Some(Self::Flat {
            plane_from_board: Pose::from_matrix(&rotation, -(rotation * center.coords)),
            scale,
        })
    }

    /// Whether the points lie on a plane.
    pub(crate) fn is_flat(&self) -> bool {
        matches!(self, Self::Flat { .. })
    }
}

/// `camera_from_board` from points and their directions; points without a direction are left out.
/// The solution in front of the camera with the least algebraic error, to be refined. `None` where
/// it is not determined.
pub(crate) fn pose_from_bearings(
    shape: &Shape,
    points: &[Point3<f64>],
    bearings: &[Option<Bearing>],
) -> Option<Pose> {
    let seen =
        points.iter().zip(bearings).filter_map(|(point, bearing)| Some((point, (*bearing)?)));
    match shape {
        Shape::Flat { plane_from_board, scale } => flat_pose(plane_from_board, *scale, seen),
        Shape::Solid { center, scale } => solid_pose(center, *scale, seen),
    }
}

fn flat_pose<'a>(
    plane_from_board: &Pose,
    scale: f64,
    seen: impl Iterator<Item = (&'a Point3<f64>, Bearing)> + Clone,
) -> Option<Pose> {
    let translation = plane_from_board.translation();
    let is_translation = plane_from_board.rotation().w == 1.0;
    let mut sums = [[0.0; 6]; 6];
    let mut count = 0;
    for (point, bearing) in seen.clone() {
        let on_plane =
            if is_translation { point + translation } else { *plane_from_board * *point };
        let (x, y) = (on_plane.x * scale, on_plane.y * scale);
        let products = [x * x, x * y, x, y * y, y, 1.0];
        let b = bearing.as_ref();
        let across =
            [1.0 - b.x * b.x, -b.x * b.y, -b.x * b.z, 1.0 - b.y * b.y, -b.y * b.z, 1.0 - b.z * b.z];
        for (sum, factor) in sums.iter_mut().zip(across) {
            for (s, p) in sum.iter_mut().zip(products) {
                *s += factor * p;
            }
        }
        count += 1;
    }
    if count < 4 {
        return None;
    }
    let blocks = sums.map(|[xx, xy, x, yy, y, n]| Matrix3::new(xx, xy, x, xy, yy, y, x, y, n));
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (i, j, block) in [(0, 0, 0), (0, 1, 1), (0, 2, 2), (1, 1, 3), (1, 2, 4), (2, 2, 5)] {
        normal.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&blocks[block]);
        normal.fixed_view_mut::<3, 3>(3 * j, 3 * i).copy_from(&blocks[block]);
    }
    let m = smallest_eigenvector(&normal)?;
    let mut columns = Matrix3::from_row_slice(m.as_slice());
    columns.column_mut(0).scale_mut(scale);
    columns.column_mut(1).scale_mut(scale);
    // Each point lies along its direction, not opposite to it.
    let along: f64 = seen
        .map(|(point, bearing)| {
            let p = *plane_from_board * *point;
            bearing.dot(&(columns * Vector3::new(p.x, p.y, 1.0))).signum()
        })
        .sum();
    if along < 0.0 {
        columns = -columns;
    }
    let facing = |c: &Matrix3<f64>| zhang::pose_from_columns(c);
    // `pose_from_columns` chooses the sign that puts the origin in front. A fisheye may see it
    // beside or behind the camera, so the original sign is restored.
    let camera_from_plane = if columns[(2, 2)] < 0.0 {
        let pose = facing(&-columns)?;
        let r = pose.rotation_matrix();
        let flipped =
            Matrix3::from_columns(&[-r.column(0), -r.column(1), r.column(2).into_owned()]);
        Pose::from_matrix(&flipped, -pose.translation())
    } else {
        facing(&columns)?
    };
    Some(camera_from_plane * *plane_from_board)
}

fn solid_pose<'a>(
    center: &Point3<f64>,
    scale: f64,
    seen: impl Iterator<Item = (&'a Point3<f64>, Bearing)> + Clone,
) -> Option<Pose> {
    let mut normal = DMatrix::<f64>::zeros(12, 12);
    let mut count = 0;
    for (point, bearing) in seen.clone() {
        let x = ((point - center) * scale).push(1.0);
        let across = Matrix3::identity() - bearing.as_ref() * bearing.transpose();
        normal += across.kronecker(&(x * x.transpose()));
        count += 1;
    }
    if count < 6 {
        return None;
    }
    let eigen = normal.symmetric_eigen();
    let m = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let mut columns = Matrix3x4::from_row_slice(m.as_slice());
    let along: f64 = seen
        .map(|(point, bearing)| {
            bearing.dot(&(columns * ((point - center) * scale).push(1.0))).signum()
        })
        .sum();
    if along < 0.0 {
        columns = -columns;
    }
    let linear: Matrix3<f64> = columns.fixed_columns::<3>(0).into_owned();
    let size = linear.determinant().abs().cbrt();
    let rotation = zhang::nearest_rotation(&(linear / size))?;
    let translation = columns.column(3) / (size * scale);
    let pose = Pose::from_matrix(&rotation, translation - rotation * center.coords);
    pose.translation().iter().all(|v| v.is_finite()).then_some(pose)
}

#[cfg(test)]
mod tests {
    use nalgebra::Unit;

    use super::*;

    fn check(points: &[Point3<f64>], camera_from_board: &Pose) {
        let bearings: Vec<_> = points
            .iter()
            .map(|p| Some(Unit::new_normalize((*camera_from_board * *p).coords)))
            .collect();
        let shape = Shape::of(points).unwrap();
        let found = pose_from_bearings(&shape, points, &bearings).unwrap();
        assert!(found.angle_to(camera_from_board) < 1e-7, "{found:?} {camera_from_board:?}");
        assert!((found.translation() - camera_from_board.translation()).norm() < 1e-8);
    }

    #[test]
    fn exact_directions_give_the_exact_pose() {
        let flat: Vec<_> = (0..54)
            .map(|k| Point3::new(f64::from(k % 9) * 0.03, f64::from(k / 9) * 0.03, 0.0))
            .collect();
        let rotation =
            Pose::from_axis_angle(Vector3::new(0.4, -0.3, 0.9), Vector3::new(0.2, -0.1, 0.7));
        let tilted: Vec<_> = flat.iter().map(|p| rotation * *p).collect();
        let solid: Vec<_> = (0..27)
            .map(|k| Point3::new(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9)) * 0.1)
            .collect();
        for (axis, t) in [
            ([0.3, -0.2, 0.1], [-0.1, -0.05, 0.6]),
            ([-0.5, 0.4, 2.0], [0.1, 0.0, 0.4]),
            // Beside the camera and a little behind, as a fisheye lens sees it.
            ([0.1, 1.9, 0.0], [0.5, 0.1, -0.05]),
        ] {
            let camera_from_board = Pose::from_axis_angle(Vector3::from(axis), Vector3::from(t));
            check(&flat, &camera_from_board);
            check(&tilted, &(camera_from_board * rotation.inverse()));
            check(&solid, &camera_from_board);
        }
    }

    #[test]
    fn lines_and_spots_have_no_pose() {
        let line: Vec<_> =
            (0..9).map(|k| Point3::new(f64::from(k), 2.0 * f64::from(k), 0.0)).collect();
        assert!(Shape::of(&line).is_none());
        assert!(Shape::of(&[Point3::new(1.0, 2.0, 3.0); 9]).is_none());
        assert!(Shape::of(&line[..3]).is_none());
    }
}
