//! The information of shared views on two cameras: the information matrix over the lenses of a and
//! b and over `b_from_a`, with the board's pose eliminated.
//!
//! ```text
//! Λ = [Λ_a, Λ_b, 0] + Σ over shared views of (joint − [alone in a, alone in b, 0])
//! ```
//!
//! Λ_a and Λ_b are the information of all views of each camera on its own lens, shared views
//! included. A shared view adds to that because both cameras see the same board. A step of
//! `b_from_a` is a rotation about b's axes (radians, from the left) and a translation (meters), as
//! in the solve of a rig.

use nalgebra::{DMatrix, Matrix6, SMatrix, Vector3};

use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::view_information::{ViewNormal, inverse_of_pose};
use crate::estimation::scaled_factor::scaled_inverse;
use crate::geometry::lens::MAX_PARAMETERS;
use crate::geometry::pose::Pose;

/// The information on two cameras, over the free parameters of the first lens, those of the second,
/// and the relative pose, in this order.
#[derive(Debug, Clone, PartialEq)]
pub struct PairInformation {
    /// The free parameters of each lens.
    pub free: [Vec<usize>; 2],
    /// The estimated pose of the first camera in the second.
    pub b_from_a: Pose,
    /// The information matrix: the inverse of their covariance.
    pub matrix: DMatrix<f64>,
}

impl PairInformation {
    /// The information on two lenses, and none on the relative pose; `b_from_a` is where
    /// derivatives are taken.
    pub fn of_lenses([a, b]: [&LensInformation; 2], b_from_a: Pose) -> Self {
        let free = [a.free.clone(), b.free.clone()];
        let matrix = joined([&a.matrix, &b.matrix]);
        Self { free, b_from_a, matrix }
    }

    /// The information of a view that both cameras see; `None` where the corners do not determine
    /// the board's pose.
    pub fn of_view(&self, [a, b]: [&ViewNormal; 2]) -> Option<DMatrix<f64>> {
        let middles = [&a.middle_in_camera, &b.middle_in_camera];
        let RelativeMotion { by_place, by_board } = RelativeMotion::of(&self.b_from_a, middles);
        let of_board = b.by_pose * by_board;
        let inverse = inverse_of_pose(&(a.by_pose + by_board.transpose() * of_board))?;
        // Rows: a's lens, b's lens, b_from_a.
        type Row<const COLUMNS: usize> = SMatrix<f64, { 2 * MAX_PARAMETERS + 6 }, COLUMNS>;
        const ROWS: usize = 2 * MAX_PARAMETERS + 6;
        let at = [0, MAX_PARAMETERS, 2 * MAX_PARAMETERS];
        let mut normal = Row::<ROWS>::zeros();
        let of_lens_by_place = b.coupling * by_place;
        normal.fixed_view_mut::<MAX_PARAMETERS, MAX_PARAMETERS>(at[0], at[0]).copy_from(&a.by_lens);
        normal.fixed_view_mut::<MAX_PARAMETERS, MAX_PARAMETERS>(at[1], at[1]).copy_from(&b.by_lens);
        normal.fixed_view_mut::<MAX_PARAMETERS, 6>(at[1], at[2]).copy_from(&of_lens_by_place);
        normal
            .fixed_view_mut::<6, MAX_PARAMETERS>(at[2], at[1])
            .copy_from(&of_lens_by_place.transpose());
        normal
            .fixed_view_mut::<6, 6>(at[2], at[2])
            .copy_from(&(by_place.transpose() * b.by_pose * by_place));
        let mut coupling = Row::<6>::zeros();
        coupling.fixed_view_mut::<MAX_PARAMETERS, 6>(at[0], 0).copy_from(&a.coupling);
        coupling.fixed_view_mut::<MAX_PARAMETERS, 6>(at[1], 0).copy_from(&(b.coupling * by_board));
        coupling.fixed_view_mut::<6, 6>(at[2], 0).copy_from(&(by_place.transpose() * of_board));
        let known: Vec<usize> = (self.free[0].iter().copied())
            .chain(self.free[1].iter().map(|index| at[1] + index))
            .chain(at[2]..ROWS)
            .collect();
        let weighted = coupling * inverse;
        let entry = |i: usize, j: usize| {
            let (row, column) = (known[i], known[j]);
            normal[(row, column)] - weighted.row(row).dot(&coupling.row(column))
        };
        let information = DMatrix::from_fn(known.len(), known.len(), entry);
        information.iter().all(|v| v.is_finite()).then_some(information)
    }

    /// The information of a shared view beyond `alone`, the information that it gives about each
    /// camera separately.
    pub fn beyond(
        &self,
        normals: [&ViewNormal; 2],
        alone: [&DMatrix<f64>; 2],
    ) -> Option<DMatrix<f64>> {
        Some(self.of_view(normals)? - joined(alone))
    }

    /// What a view of one camera alone, the first or the second, adds to the information on both.
    pub fn of_one(&self, camera: usize, information: &DMatrix<f64>) -> DMatrix<f64> {
        let counts = [self.free[0].len(), self.free[1].len()];
        let nothing = counts.map(|count| DMatrix::zeros(count, count));
        match camera {
            0 => joined([information, &nothing[1]]),
            _ => joined([&nothing[0], information]),
        }
    }

    /// The covariance of the relative pose, with the lenses marginalized; `None` where it is not
    /// determined.
    pub fn place_covariance(&self) -> Option<Matrix6<f64>> {
        let at = self.matrix.nrows() - 6;
        Some(scaled_inverse(&self.matrix)?.fixed_view::<6, 6>(at, at).into_owned())
    }
}

/// Derivatives of the board's motion in b, whose rotations are about the middle of the corners that
/// b sees.
pub(super) struct RelativeMotion {
    /// By a step of `b_from_a`.
    pub(super) by_place: Matrix6<f64>,
    /// By a step of the board in a, whose rotations are about the middle of the corners that a
    /// sees.
    pub(super) by_board: Matrix6<f64>,
}

impl RelativeMotion {
    /// `in_a` and `in_b` are the middle of the corners that a and b see, each in its own frame.
    pub(super) fn of(b_from_a: &Pose, [in_a, in_b]: [&Vector3<f64>; 2]) -> Self {
        let rotation = b_from_a.rotation_matrix();
        let lever = in_b - b_from_a.translation();
        let offset = lever - rotation * in_a;
        let (mut by_place, mut by_board) = (Matrix6::identity(), Matrix6::zeros());
        by_place.fixed_view_mut::<3, 3>(3, 0).copy_from(&-lever.cross_matrix());
        by_board.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        by_board.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        by_board.fixed_view_mut::<3, 3>(3, 0).copy_from(&(-offset.cross_matrix() * rotation));
        Self { by_place, by_board }
    }
}

/// A block diagonal matrix of the two, with zeros for the relative pose.
fn joined([a, b]: [&DMatrix<f64>; 2]) -> DMatrix<f64> {
    let (first, second) = (a.nrows(), b.nrows());
    let mut matrix = DMatrix::zeros(first + second + 6, first + second + 6);
    matrix.view_mut((0, 0), (first, first)).copy_from(a);
    matrix.view_mut((first, first), (second, second)).copy_from(b);
    matrix
}

/// `b_from_a` after a step of the relative pose.
pub fn stepped(b_from_a: &Pose, [rotation, translation]: [Vector3<f64>; 2]) -> Pose {
    let rotation = nalgebra::UnitQuaternion::from_scaled_axis(rotation);
    Pose::new(rotation * b_from_a.rotation(), b_from_a.translation() + translation)
}
