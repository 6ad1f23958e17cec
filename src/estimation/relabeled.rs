//! Views of a symmetric board under other labels of its corners.

use crate::estimation::camera::{CameraOptions, calibrate_camera};
use crate::estimation::labels_by_shape::labels_by_shape;
use crate::estimation::problem::{BoardView, CameraProblem, CameraStart, Correspondence};
use crate::geometry::pose::Pose;

/// The same corners at `board_from_labels⁻¹ · point_in_board`.
pub fn relabeled(corners: &[Correspondence], board_from_labels: &Pose) -> Vec<Correspondence> {
    let labels_from_board = board_from_labels.inverse();
    let corner = |corner: &Correspondence| Correspondence {
        point_in_board: labels_from_board * corner.point_in_board,
        ..*corner
    };
    corners.iter().map(corner).collect()
}

/// A problem with a symmetry applied to the labels of each view.
#[derive(Debug, Clone, PartialEq)]
pub struct RelabeledProblem {
    /// Under the new labels.
    pub problem: CameraProblem,
    /// The symmetry that was applied to each view.
    pub board_from_labels: Vec<Pose>,
}

impl RelabeledProblem {
    /// `problem` with all views labeled alike ([`labels_by_shape`]), for a board with the
    /// symmetries `board_from_labels` ([`crate::geometry::target::Target::symmetries`]). `None`
    /// where all labels are right as they are, or cannot be compared since there is no estimate
    /// with `options`.
    pub fn labeled_alike(
        problem: &CameraProblem,
        board_from_labels: &[Pose],
        options: &CameraOptions,
    ) -> Option<Self> {
        if board_from_labels.len() < 2 {
            return None;
        }
        let flat = CameraOptions { measured_board: None, copies_count: true, ..options.clone() };
        let flat = calibrate_camera(problem, &flat.as_stated()).ok()?;
        let measured = options.measured_board.as_ref();
        let chosen = labels_by_shape(problem, &flat, board_from_labels, measured);
        if chosen.iter().all(|symmetry| *symmetry == 0) {
            return None;
        }
        let labeled =
            Self::of(problem, chosen.iter().map(|chosen| board_from_labels[*chosen]).collect());
        // The shape biases the lens of a flat board. Once most labels are right, it no longer does.
        let start = options.start.as_ref().map(|start| labeled.start(start));
        let uneven = CameraOptions { start, copies_count: true, ..options.clone() };
        let Ok(uneven) = calibrate_camera(&labeled.problem, &uneven) else { return Some(labeled) };
        let chosen = labels_by_shape(&labeled.problem, &uneven, board_from_labels, measured);
        let both = labeled.board_from_labels.iter().zip(chosen);
        let both = both.map(|(first, second)| *first * board_from_labels[second]).collect();
        Some(Self::of(problem, both))
    }

    /// `problem` with the symmetry `board_from_labels` applied to each view, one per view.
    pub fn of(problem: &CameraProblem, board_from_labels: Vec<Pose>) -> Self {
        let view = |(view, board_from_labels): (&BoardView, &Pose)| BoardView {
            name: view.name.clone(),
            correspondences: relabeled(&view.correspondences, board_from_labels),
        };
        let views = problem.views.iter().zip(&board_from_labels).map(view).collect();
        let problem = CameraProblem { image_size: problem.image_size, views };
        Self { problem, board_from_labels }
    }

    /// A start under the labels as given, for the problem under the new ones.
    pub fn start(&self, start: &CameraStart) -> CameraStart {
        self.rotated(start, |symmetry| *symmetry)
    }

    /// A start under the new labels, for the problem under the labels as given.
    pub fn start_as_given(&self, start: &CameraStart) -> CameraStart {
        self.rotated(start, Pose::inverse)
    }

    fn rotated(&self, start: &CameraStart, rotation: impl Fn(&Pose) -> Pose) -> CameraStart {
        let poses = start.camera_from_board.iter().zip(&self.board_from_labels);
        let pose = |(pose, symmetry): (&Option<Pose>, &Pose)| Some((*pose)? * rotation(symmetry));
        CameraStart { camera_from_board: poses.map(pose).collect(), ..start.clone() }
    }
}
