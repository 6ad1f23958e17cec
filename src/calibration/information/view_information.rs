//! The information of one view of a board on a lens, with the view's pose unknown.

use nalgebra::{DMatrix, Matrix2x3, Matrix2x6, Matrix6, Point3, SMatrix, Vector3};

use crate::geometry::lens::{Lens, MAX_PARAMETERS, Projection};
use crate::geometry::pose::Pose;

/// A corner with its standard deviation, measured or expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedCorner {
    /// In meters.
    pub point_in_board: Point3<f64>,
    /// Standard deviation of its pixel per axis, in pixels.
    pub std_px: f64,
}

/// The normal matrix of one view, over its lens and the board's pose. The pose is a rotation
/// (radians, the camera's axes) about the middle of the corners seen, and a translation (meters):
/// so rotation and translation are hardly correlated.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewNormal {
    /// Over the lens's parameters, in the order of [`Lens::parameters`].
    pub by_lens: SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>,
    /// Lens × pose.
    pub coupling: SMatrix<f64, MAX_PARAMETERS, 6>,
    /// Over the pose.
    pub by_pose: Matrix6<f64>,
    /// The point that the pose's rotation is about.
    pub middle_in_camera: Vector3<f64>,
}

impl ViewNormal {
    /// For a board at `camera_from_board`. Corners outside the lens's valid region add nothing.
    pub fn of(lens: &Lens, camera_from_board: &Pose, corners: &[WeightedCorner]) -> Self {
        let sum = corners.iter().map(|corner| corner.point_in_board.coords).sum::<Vector3<f64>>();
        let mean = sum / corners.len().max(1) as f64;
        let middle_in_camera = (*camera_from_board * Point3::from(mean)).coords;
        let mut normal = Self {
            by_lens: SMatrix::zeros(),
            coupling: SMatrix::zeros(),
            by_pose: Matrix6::zeros(),
            middle_in_camera,
        };
        for corner in corners {
            let point_in_camera = *camera_from_board * corner.point_in_board;
            let Some(Projection { by_point, by_parameters, .. }) = lens.project(&point_in_camera)
            else {
                continue;
            };
            let motion = by_motion(&by_point, &(point_in_camera.coords - middle_in_camera));
            let weight = 1.0 / (corner.std_px * corner.std_px);
            let weighted = by_parameters.transpose() * weight;
            normal.by_lens += weighted * by_parameters;
            normal.coupling += weighted * motion;
            normal.by_pose += motion.transpose() * motion * weight;
        }
        normal
    }

    /// The information matrix over the lens parameters in `free` (indices into
    /// [`Lens::parameters`]), with the board's pose eliminated. Each entry is in units of 1 over
    /// the product of its two parameters' units. `None` where the corners do not determine the
    /// pose.
    pub fn lens_information(&self, free: &[usize]) -> Option<DMatrix<f64>> {
        let inverse = inverse_of_pose(&self.by_pose)?;
        let reduced = self.by_lens - self.coupling * inverse * self.coupling.transpose();
        let information =
            DMatrix::from_fn(free.len(), free.len(), |i, j| reduced[(free[i], free[j])]);
        information.iter().all(|v| v.is_finite()).then_some(information)
    }
}

/// The derivative of a projection by a motion of its point: a rotation, which moves the point by
/// its cross product with `lever`, and a translation.
pub fn by_motion(by_point: &Matrix2x3<f64>, lever: &Vector3<f64>) -> Matrix2x6<f64> {
    let mut motion = Matrix2x6::zeros();
    for axis in 0..2 {
        let row = by_point.row(axis).transpose();
        motion.fixed_view_mut::<1, 3>(axis, 0).copy_from(&lever.cross(&row).transpose());
        motion.fixed_view_mut::<1, 3>(axis, 3).copy_from(&row.transpose());
    }
    motion
}

/// The inverse of a normal matrix over a pose. Rotations are in radians and translations in meters,
/// so the matrix is scaled to a unit diagonal before it is inverted.
pub fn inverse_of_pose(normal: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let scale = normal.diagonal().map(|v| 1.0 / v.max(f64::MIN_POSITIVE).sqrt());
    let scales = Matrix6::from_diagonal(&scale);
    Some(scales * (scales * normal * scales).cholesky()?.inverse() * scales)
}

/// [`ViewNormal::lens_information`] of a view of `corners`.
pub fn view_information(
    lens: &Lens,
    free: &[usize],
    camera_from_board: &Pose,
    corners: &[WeightedCorner],
) -> Option<DMatrix<f64>> {
    ViewNormal::of(lens, camera_from_board, corners).lens_information(free)
}
