//! Whether the operator is bringing the board to the suggested view. Frames on the way there are
//! blurred by motion and add less information than the view that is about to come.

use crate::calibration::admission::ONE_MOVEMENT_S;
use crate::calibration::information::camera_information::CameraInformation;
use crate::calibration::view::FrameFacts;
use crate::geometry::pose::Pose;

/// A board that reaches the suggested view within this time at its present speed, in seconds, is
/// waited for (swept: docs/guidance.md).
const ARRIVAL_WAIT_S: f64 = 2.0;

/// How far the board was from the suggested view in the previous frame.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Approach {
    before: Option<(i64, f64)>,
}

impl Approach {
    /// Takes a frame: its time, and the poses of the board in it and in the suggested view, if both
    /// exist.
    pub(super) fn follow(
        &mut self,
        time_ns: i64,
        poses: Option<[&Pose; 2]>,
        information: &CameraInformation,
    ) {
        self.before = poses.map(|[here, there]| (time_ns, information.effort(here, there)));
    }

    /// Whether the board is about to arrive at the suggested view. A named frame is an image file,
    /// not part of a motion: never.
    pub(super) fn is_arriving(
        &self,
        frame: &FrameFacts,
        [here_from_board, there_from_board]: [&Pose; 2],
        information: &CameraInformation,
    ) -> bool {
        let Some((time_ns, before)) = self.before.filter(|_| frame.name.is_none()) else {
            return false;
        };
        let elapsed_s = frame.time_ns().saturating_sub(time_ns) as f64 * 1e-9;
        let left = information.effort(here_from_board, there_from_board);
        // The effort left, at the present speed, takes less than `ARRIVAL_WAIT_S`.
        let is_one_movement = elapsed_s > 0.0 && elapsed_s < ONE_MOVEMENT_S;
        is_one_movement && (before - left) * ARRIVAL_WAIT_S > left * elapsed_s
    }
}
