//! What the corners in infrared add for the depth camera with the same image geometry, and for the
//! board's pose: the normal equations of one view over the same parameters as those of its planes.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::calibration::information::pair_information::RelativeMotion;
use crate::calibration::information::view_information::ViewNormal;
use crate::estimation::rgbd::plane_information::PlacedDepth;

/// The normal matrix of one view over the depth camera's parameters and the board's pose, where the
/// pose is a step of the board's pose in color.
#[derive(Debug, Clone, PartialEq)]
pub struct InfraredNormal {
    /// Over the depth camera's parameters; zero for its correction.
    pub by_depth: DMatrix<f64>,
    /// Depth camera × pose.
    pub coupling: DMatrix<f64>,
    /// Over the pose.
    pub by_pose: Matrix6<f64>,
}

impl InfraredNormal {
    /// From the normal matrix `infrared` of a view's corners in the infrared image; the pose is
    /// about `middle_in_color`.
    pub fn of(depth: &PlacedDepth, middle_in_color: &Vector3<f64>, infrared: &ViewNormal) -> Self {
        let middles = [middle_in_color, &infrared.middle_in_camera];
        let RelativeMotion { by_place, by_board } =
            RelativeMotion::of(&depth.depth_from_color, middles);
        let (lens, at) = (&depth.open, depth.pose_at());
        let count = depth.parameters();
        let mut by_depth = DMatrix::zeros(count, count);
        let mut coupling = DMatrix::zeros(count, 6);
        let of_place = infrared.coupling * by_place;
        let of_board = infrared.coupling * by_board;
        for (i, row) in lens.iter().enumerate() {
            for (j, column) in lens.iter().enumerate() {
                by_depth[(i, j)] = infrared.by_lens[(*row, *column)];
            }
            for k in 0..6 {
                by_depth[(i, at + k)] = of_place[(*row, k)];
                by_depth[(at + k, i)] = of_place[(*row, k)];
                coupling[(i, k)] = of_board[(*row, k)];
            }
        }
        let moved = by_place.transpose() * infrared.by_pose;
        by_depth.view_mut((at, at), (6, 6)).copy_from(&(moved * by_place));
        coupling.view_mut((at, 0), (6, 6)).copy_from(&(moved * by_board));
        let by_pose = by_board.transpose() * infrared.by_pose * by_board;
        Self { by_depth, coupling, by_pose }
    }
}
