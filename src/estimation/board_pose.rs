//! The pose of a board in a camera with a known lens: both poses where a flat board leaves an
//! ambiguity.

use nalgebra::{Matrix3, Matrix6, Vector3};

use crate::estimation::error::EstimationError;
use crate::estimation::joint::minimize::{Minimum, Stop};
use crate::estimation::joint::{FreeLens, Layout, State};
use crate::estimation::problem::{BoardView, CameraProblem, check};
use crate::estimation::robust::Loss;
use crate::estimation::start::Prepared;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// A pose that fits a view.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardPose {
    /// The board's pose.
    pub camera_from_board: Pose,
    /// Root mean square of the reprojection error, in pixels.
    pub rms_px: f64,
    /// Covariance for corners with standard deviations `std_px`: of a rotation about the camera's
    /// axes (radians) and a translation of the view's mean point (meters).
    pub covariance: Matrix6<f64>,
}

/// Poses with a smaller difference in rotation, in radians, are the same.
const SAME_ROTATION_RAD: f64 = 1e-4;

/// The poses that fit `view` under `lens`, best first: one, or for a distant flat board also the
/// one with reversed tilt (D. Oberkampf, D. DeMenthon, L. Davis, *Iterative pose estimation using
/// coplanar feature points*, 1996). Whether the first is certain follows from how much worse the
/// second fits, relative to the corners' noise.
///
/// # Errors
/// A number is not finite, or the view determines no pose.
pub fn board_poses(lens: &Lens, view: &BoardView) -> Result<Vec<BoardPose>, EstimationError> {
    let problem = CameraProblem { image_size: ImageSize::new(1, 1), views: vec![view.clone()] };
    check(&problem)?;
    let prepared = Prepared::of(&problem);
    let refused = || EstimationError::NoPose {
        view: view.name.clone(),
        reason: prepared.views[0].fault.map_or_else(
            || "the lens sees nothing where its corners are".to_owned(),
            |fault| fault.to_string(),
        ),
    };
    let camera_from_center = prepared.pose(0, lens).ok_or_else(refused)?;
    let mut found: Vec<BoardPose> = Vec::new();
    let reversed = prepared.board_normal().map(|normal| tilt_reversed(&camera_from_center, normal));
    for camera_from_center in [Some(camera_from_center), reversed].into_iter().flatten() {
        let Some(refined) = refine(&prepared, lens, camera_from_center) else { continue };
        let same = |other: &BoardPose| {
            other.camera_from_board.angle_to(&refined.camera_from_board) < SAME_ROTATION_RAD
        };
        if !found.iter().any(same) {
            found.push(refined);
        }
    }
    found.sort_by(|a, b| a.rms_px.total_cmp(&b.rms_px));
    if found.is_empty() { Err(refused()) } else { Ok(found) }
}

/// Depth reversed along the line of sight: the pose with the same image in the limit of infinite
/// distance.
fn tilt_reversed(camera_from_center: &Pose, normal: Vector3<f64>) -> Pose {
    let line_of_sight = camera_from_center.translation().normalize();
    let reversed = |axis: Vector3<f64>| Matrix3::identity() - axis * axis.transpose() * 2.0;
    let rotation =
        reversed(line_of_sight) * camera_from_center.rotation_matrix() * reversed(normal);
    Pose::from_matrix(&rotation, camera_from_center.translation())
}

fn refine(prepared: &Prepared, lens: &Lens, camera_from_center: Pose) -> Option<BoardPose> {
    let fixed = FreeLens { model: lens.model(), free: Vec::new(), square_pixels: false };
    let layout = Layout::new(vec![fixed], None);
    let start = State {
        lenses: vec![*lens],
        sensor_from_rig: vec![Pose::identity()],
        rig_from_board: vec![camera_from_center],
        warp: [0.0; 2],
    };
    let (observations, loss) = (&prepared.observations, Loss::Squares);
    let minimum = Minimum::start(&layout, start, observations, loss)?.descend(
        &layout,
        observations,
        loss,
        Stop::default(),
    );
    let found = minimum.state.rig_from_board[0];
    let residuals = minimum.equations.residuals[0].iter().zip(&observations[0].inverse_std);
    let squares: f64 = residuals.map(|([x, y], s)| (x * x + y * y) / (s * s)).sum();
    Some(BoardPose {
        camera_from_board: Pose::new(
            found.rotation(),
            found.translation() - found * prepared.center_in_board,
        ),
        rms_px: (squares / observations[0].points.len() as f64).sqrt(),
        covariance: minimum.equations.frame_set_covariance(0, &nalgebra::DMatrix::zeros(0, 0))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::problem::Correspondence;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::camera_matrix::CameraMatrix;

    /// Holds also for a board that is not quite flat, whose pose would be determined by noise if
    /// its points were treated as points in space.
    #[test]
    fn an_uneven_board_is_placed_as_a_flat_one_is() {
        let lens =
            Lens::pinhole(CameraMatrix { fx: 800.0, fy: 800.0, cx: 320.0, cy: 240.0, skew: 0.0 });
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap();
        let noise = |k: usize| ((k as f64 * 12.9898).sin() * 43758.5453).fract();
        for view in 0..40 {
            let random = |k: usize| noise(7 * view + k);
            let truth = Pose::from_axis_angle(
                Vector3::new(0.9 * random(0), 0.9 * random(1), random(2)),
                Vector3::new(0.1 * random(3), 0.1 * random(4), 1.5),
            );
            let seen = board.corners_in_board().into_iter().enumerate().map(|(k, mut point)| {
                point.z = 0.0005 * noise(k + 1);
                let mut pixel = lens.pixel_from_point(&(truth * point)).unwrap();
                pixel.x += 0.1 * noise(1000 * view + k);
                Correspondence { point_in_board: point, pixel, std_px: 0.1 }
            });
            let view = BoardView { name: "uneven".to_owned(), correspondences: seen.collect() };
            let found = &board_poses(&lens, &view).unwrap()[0];
            let off = found.camera_from_board.angle_to(&truth);
            assert!(off < 0.02 && found.rms_px < 0.15, "{off} rad, {} px", found.rms_px);
        }
    }

    #[test]
    fn a_far_board_has_two_poses_and_the_better_is_the_true_one() {
        let lens =
            Lens::pinhole(CameraMatrix { fx: 800.0, fy: 800.0, cx: 320.0, cy: 240.0, skew: 0.0 });
        let board = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap();
        for (distance_m, expected) in [(0.5, 1), (3.0, 2)] {
            let truth = Pose::from_axis_angle(
                Vector3::new(0.5, 0.2, 0.1),
                Vector3::new(0.05, 0.02, distance_m),
            );
            let seen = board.corners_in_board().into_iter().map(|point| Correspondence {
                point_in_board: point,
                pixel: lens.pixel_from_point(&(truth * point)).unwrap(),
                std_px: 0.1,
            });
            let view = BoardView { name: "far".to_owned(), correspondences: seen.collect() };
            let found = board_poses(&lens, &view).unwrap();
            assert!(found.len() >= expected, "{} poses at {distance_m} m", found.len());
            assert!(found[0].camera_from_board.angle_to(&truth) < 1e-6);
            assert!(found.iter().skip(1).all(|other| other.rms_px > 0.01));
        }
    }
}
