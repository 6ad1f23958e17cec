//! A sensor of a rig that was calibrated by itself.

use crate::calibration::solve::SolvedCamera;
use crate::calibration::solve::rig_input::RigSensorInput;
use crate::estimation::camera::ViewEstimate;
use crate::estimation::consistent_labels::FrameSetPose;
use crate::estimation::rig::FrameSetView;
use crate::geometry::pose::Pose;

/// A sensor that was calibrated by itself.
pub(super) struct SingleSensor<'a> {
    pub(super) input: &'a RigSensorInput,
    pub(super) solved: SolvedCamera,
}

impl SingleSensor<'_> {
    /// Whether it belongs to another camera, or is another sensor of the only one.
    pub(super) fn is_other_than(&self, other: &Self) -> bool {
        match (&self.input.id.camera, &other.input.id.camera) {
            (None, None) => self.input.id.kind != other.input.id.kind,
            (one, other) => one != other,
        }
    }

    /// The pose of every view in use.
    pub(super) fn poses(&self) -> Vec<FrameSetPose> {
        let views = self.input.views.iter().zip(&self.solved.estimate.views);
        let pose = |(seen, view): (&FrameSetView, &ViewEstimate)| {
            let sensor_from_board = view.camera_from_board.filter(|_| view.fault.is_none())?;
            Some(FrameSetPose { frame_set: seen.frame_set, sensor_from_board })
        };
        views.filter_map(pose).collect()
    }

    /// Its observations with the labels of each view corrected by the `chosen` symmetry, and with
    /// its own noise floor in the standard deviation of each corner.
    pub(super) fn with_labels_corrected(
        &self,
        board_from_labels: &[Pose],
        chosen: &[usize],
    ) -> Vec<FrameSetView> {
        let good = self
            .solved
            .estimate
            .views
            .iter()
            .map(|view| view.fault.is_none() && view.camera_from_board.is_some());
        let mut chosen = chosen.iter();
        let views = self.input.views.iter().zip(good);
        let with_labels_corrected = |(seen, good): (&FrameSetView, bool)| {
            let symmetry = if good { chosen.next().copied().unwrap_or(0) } else { 0 };
            let mut seen = seen.clone();
            for corner in &mut seen.view.correspondences {
                corner.std_px = corner.std_px.hypot(self.solved.estimate.noise_floor_px);
                corner.point_in_board = board_from_labels[symmetry] * corner.point_in_board;
            }
            seen
        };
        views.map(with_labels_corrected).collect()
    }
}
