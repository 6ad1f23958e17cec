//! What one view of a board says of a lens: its information matrix, the view's own pose unknown.

use nalgebra::{DMatrix, Matrix2x6, Matrix6, Point3, SMatrix};

use crate::geometry::lens::{Lens, MAX_PARAMETERS, Projection};
use crate::geometry::pose::Pose;

/// A corner with the exactness that it was, or will be, seen with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedCorner {
    /// In meters.
    pub point_in_board: Point3<f64>,
    /// Standard deviation of its pixel per axis, in pixels.
    pub std_px: f64,
}

/// The information matrix of one view over the lens parameters in `free` (indices into
/// [`Lens::parameters`]), with the board's pose eliminated. Each entry is in units of 1 over the
/// product of its two parameters' units. Corners outside the lens's valid region add nothing.
/// `None` where the others do not determine the pose.
pub fn view_information(
    lens: &Lens,
    free: &[usize],
    camera_from_board: &Pose,
    corners: &[WeightedCorner],
) -> Option<DMatrix<f64>> {
    let mut by_lens = SMatrix::<f64, MAX_PARAMETERS, MAX_PARAMETERS>::zeros();
    let mut coupling = SMatrix::<f64, MAX_PARAMETERS, 6>::zeros();
    let mut by_pose = Matrix6::zeros();
    let mean =
        corners.iter().map(|corner| corner.point_in_board.coords).sum::<nalgebra::Vector3<f64>>()
            / corners.len().max(1) as f64;
    // Rotated about the board's middle: rotation and translation then hardly depend on each other.
    let middle_in_camera = (*camera_from_board * Point3::from(mean)).coords;
    for corner in corners {
        let point_in_camera = *camera_from_board * corner.point_in_board;
        let Some(Projection { by_point, by_parameters, .. }) = lens.project(&point_in_camera)
        else {
            continue;
        };
        let lever = point_in_camera.coords - middle_in_camera;
        let mut motion = Matrix2x6::zeros();
        for axis in 0..2 {
            let row = by_point.row(axis).transpose();
            motion.fixed_view_mut::<1, 3>(axis, 0).copy_from(&lever.cross(&row).transpose());
            motion.fixed_view_mut::<1, 3>(axis, 3).copy_from(&row.transpose());
        }
        let weight = 1.0 / (corner.std_px * corner.std_px);
        let weighted = by_parameters.transpose() * weight;
        by_lens += weighted * by_parameters;
        coupling += weighted * motion;
        by_pose += motion.transpose() * motion * weight;
    }
    // Rotations are in radians and translations in meters: the same scale for both before they are
    // inverted.
    let scale = by_pose.diagonal().map(|v| 1.0 / v.max(f64::MIN_POSITIVE).sqrt());
    let scales = Matrix6::from_diagonal(&scale);
    let inverse = scales * (scales * by_pose * scales).cholesky()?.inverse() * scales;
    let reduced = by_lens - coupling * inverse * coupling.transpose();
    let information = DMatrix::from_fn(free.len(), free.len(), |i, j| reduced[(free[i], free[j])]);
    information.iter().all(|v| v.is_finite()).then_some(information)
}
