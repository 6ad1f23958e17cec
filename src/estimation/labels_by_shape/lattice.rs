//! The corners of a symmetric board, and which corner each label means under each symmetry.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::estimation::consistent_labels::nearest_symmetry;
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::problem::CameraProblem;
use crate::geometry::pose::Pose;

/// Points of the board closer than this, in meters, are the same: boards are stated to 0.1 mm or
/// coarser, and rotations round to 1e-15 m.
const SAME_M: f64 = 1e-7;

/// The board's corners, and what its symmetries do with them.
pub(super) struct BoardLattice {
    pub(super) points: Vec<Point3<f64>>,
    board_from_labels: Vec<Pose>,
    /// One for each of `board_from_labels`.
    pub(super) symmetries: Vec<Symmetry>,
}

/// One symmetry.
pub(super) struct Symmetry {
    /// Of its `board_from_labels`.
    pub(super) rotation: Matrix3<f64>,
    /// By corner as labeled: the corner that it is.
    pub(super) corner: Vec<usize>,
}

impl BoardLattice {
    /// All corners that the views show, and those that the symmetries map them to.
    pub(super) fn of(problem: &CameraProblem, board_from_labels: &[Pose]) -> Self {
        let mut points: Vec<Point3<f64>> = Vec::new();
        let seen = problem.views.iter().flat_map(|view| &view.correspondences);
        for stated in seen.map(|corner| corner.point_in_board) {
            if points.contains(&stated) {
                continue;
            }
            for rotated in board_from_labels.iter().map(|symmetry| symmetry.inverse() * stated) {
                if nearest_point(&points, &rotated).is_none_or(|(distance, _)| distance > SAME_M) {
                    points.push(rotated);
                }
            }
        }
        let symmetry = |board_from_labels: &Pose| {
            let labels_from_board = board_from_labels.inverse();
            let corner =
                |point: &Point3<f64>| nearest_point(&points, &(labels_from_board * *point));
            Symmetry {
                rotation: board_from_labels.rotation_matrix(),
                corner: points.iter().map(|point| corner(point).map_or(0, |(_, at)| at)).collect(),
            }
        };
        let symmetries = board_from_labels.iter().map(symmetry).collect();
        Self { points, board_from_labels: board_from_labels.to_vec(), symmetries }
    }

    /// The measured offsets of its corners; zero where one was not measured.
    pub(super) fn offsets_of(&self, board: &MeasuredBoard) -> Vec<Vector3<f64>> {
        self.points.iter().map(|point| board.offset_at(point).unwrap_or_default()).collect()
    }

    /// The label that occurs most often; the first of several.
    pub(super) fn most_frequent(&self, labels: impl Iterator<Item = usize>) -> usize {
        let mut counts = vec![0; self.symmetries.len()];
        labels.for_each(|label| counts[label] += 1);
        (0..counts.len()).rev().max_by_key(|label| counts[*label]).unwrap_or(0)
    }

    /// The symmetry by which `label` differs from `kept`.
    pub(super) fn relative(&self, label: usize, kept: usize) -> usize {
        let [label, kept] = [label, kept].map(|index| self.board_from_labels[index]);
        nearest_symmetry(&Pose::identity(), &(label * kept.inverse()), &self.board_from_labels)
            .symmetry
    }
}

/// The distance to the nearest of `points`, and its index.
pub(super) fn nearest_point(points: &[Point3<f64>], to: &Point3<f64>) -> Option<(f64, usize)> {
    let distances = points.iter().map(|point| (point - to).norm()).zip(0..);
    distances.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// The index of the least value.
pub(super) fn least(values: &[f64]) -> usize {
    let least = values.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    least.map_or(0, |(index, _)| index)
}
