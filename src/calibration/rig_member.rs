//! A sensor of a rig that was calibrated by itself.

use crate::calibration::rig_input::RigSensorInput;
use crate::calibration::solve::SolvedCamera;
use crate::estimation::camera::ViewEstimate;
use crate::estimation::consistent_labels::SensorPoses;
use crate::estimation::problem::BoardView;
use crate::geometry::pose::Pose;

/// A sensor that was calibrated by itself.
pub(super) struct Alone<'a> {
    pub(super) input: &'a RigSensorInput,
    pub(super) solved: SolvedCamera,
}

impl Alone<'_> {
    /// Whether it is of another camera, or another sensor of the only one.
    pub(super) fn is_other_than(&self, other: &Self) -> bool {
        match (&self.input.id.camera, &other.input.id.camera) {
            (None, None) => self.input.id.kind != other.input.id.kind,
            (one, other) => one != other,
        }
    }

    /// The pose of every view in use, with its frame set.
    pub(super) fn poses(&self) -> SensorPoses {
        let views = self.input.views.iter().zip(&self.solved.estimate.views);
        let pose = |((frame_set, _), view): (&(usize, BoardView), &ViewEstimate)| {
            Some((*frame_set, view.camera_from_board.filter(|_| view.fault.is_none())?))
        };
        views.filter_map(pose).collect()
    }

    /// What it saw, with the points of each view where `symmetries` say that they are.
    pub(super) fn with_labels_corrected(
        &self,
        board_from_labels: &[Pose],
        chosen: &[usize],
    ) -> Vec<(usize, BoardView)> {
        let good = self
            .solved
            .estimate
            .views
            .iter()
            .map(|view| view.fault.is_none() && view.camera_from_board.is_some());
        let mut chosen = chosen.iter();
        let views = self.input.views.iter().zip(good);
        let with_labels_corrected = |((frame_set, view), good): (&(usize, BoardView), bool)| {
            let symmetry = if good { chosen.next().copied().unwrap_or(0) } else { 0 };
            let mut view = view.clone();
            for corner in &mut view.correspondences {
                corner.point_in_board = board_from_labels[symmetry] * corner.point_in_board;
            }
            (*frame_set, view)
        };
        views.map(with_labels_corrected).collect()
    }
}
