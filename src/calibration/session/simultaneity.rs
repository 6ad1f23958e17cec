//! Whether two cameras of an instrument saw the board in the same place.

use crate::calibration::session::action::CameraFrame;
use crate::detection::board_detection::Detection;

/// How far the board may move between two cameras' images of a frame set, in pixels: about the
/// accuracy of corners.
const SHARED_MOTION_PX: f64 = 0.3;
/// Images closer in time than this are simultaneous, however fast the board moves, in seconds.
const SAME_TIME_S: f64 = 5e-4;

/// How fast the board moves in each camera's images.
#[derive(Debug, Clone)]
pub(super) struct Simultaneity {
    /// Each camera's last frame with a board: its time and the board.
    before: Vec<Option<(i64, Detection)>>,
    /// The board's fastest corner in the newest images, in pixels a second; `None` where that
    /// cannot be measured.
    motion_px_per_s: Vec<Option<f64>>,
}

impl Simultaneity {
    pub(super) fn new(cameras: usize) -> Self {
        Self { before: vec![None; cameras], motion_px_per_s: vec![None; cameras] }
    }

    /// Takes the newest frame set; a single camera has nothing to compare.
    pub(super) fn take(&mut self, frame_set: &[Option<CameraFrame>]) {
        if self.before.len() < 2 {
            return;
        }
        let each = self.before.iter_mut().zip(&mut self.motion_px_per_s).zip(frame_set);
        for ((before, motion), frame) in each {
            *motion = None;
            let Some(camera_frame) = frame else { continue };
            let (frame, seen) = (&camera_frame.frame, camera_frame.board());
            let now = seen.map(|detection| (frame.time_ns(), detection.clone()));
            let before = std::mem::replace(before, now);
            *motion = before.zip(seen).and_then(|(before, detection)| {
                speed_px_per_s(&before, frame.time_ns(), detection)
            });
        }
    }

    /// Whether two cameras took their images at the same time, or the board hardly moved between
    /// them.
    pub(super) fn are_simultaneous(
        &self,
        frame_set: &[Option<CameraFrame>],
        one: usize,
        other: usize,
    ) -> bool {
        let (Some(first), Some(second)) = (&frame_set[one], &frame_set[other]) else {
            return false;
        };
        let elapsed_s =
            first.frame.host_time_ns.saturating_sub(second.frame.host_time_ns) as f64 * 1e-9;
        let speeds = self.motion_px_per_s[one].zip(self.motion_px_per_s[other]);
        let fastest = speeds.map(|(a, b)| a.max(b));
        elapsed_s.abs() <= SAME_TIME_S
            || fastest.is_some_and(|speed| speed * elapsed_s.abs() <= SHARED_MOTION_PX)
    }
}

fn speed_px_per_s(before: &(i64, Detection), now_ns: i64, now: &Detection) -> Option<f64> {
    let elapsed_s = now_ns.saturating_sub(before.0) as f64 * 1e-9;
    let moved = now.corners.iter().filter_map(|corner| {
        let same = before.1.corners.iter().find(|other| other.index == corner.index)?;
        Some(corner.pixel.distance_px(same.pixel))
    });
    let moved_px = moved.max_by(f64::total_cmp)?;
    (elapsed_s > 0.0 && elapsed_s < 0.5).then(|| moved_px / elapsed_s)
}
