//! The residuals of a view as a field over the board, without what the view's own pose and motion
//! explain.

use nalgebra::{DMatrix, Matrix2x3, SMatrix, SVector, Vector2};

use crate::estimation::camera_estimate::{CameraEstimate, ViewEstimate};
use crate::estimation::labels_by_shape::lattice::{BoardLattice, Symmetry, nearest_point};
use crate::estimation::labels_by_shape::shape::CornerOffsets;
use crate::estimation::problem::BoardView;
use crate::estimation::view_motion::read_out_time;
use crate::geometry::lens::{MAX_PARAMETERS, Projection};

/// The parameters of a view that are projected out: six of its pose, six of its motion.
const OWN: usize = 12;

/// The least corners of a view whose labels can be tested: with fewer, little is left of the
/// residuals beyond pose and motion.
const LEAST_CORNERS: usize = 2 * OWN;

/// The residuals of one view without what its pose and motion explain, in standard deviations.
pub(super) struct ResidualField {
    /// Its index among the views.
    pub(super) view: usize,
    pub(super) corners: Vec<CornerField>,
}

/// One corner of a view.
pub(super) struct CornerField {
    /// As labeled.
    pub(super) corner: usize,
    pub(super) residual: Vector2<f64>,
    /// By the corner's offset in the board frame, in meters.
    pub(super) by_offset: Matrix2x3<f64>,
    /// By the parameters of the lens, without what pose and motion explain.
    pub(super) by_lens: SMatrix<f64, 2, MAX_PARAMETERS>,
    /// Its rows of an orthonormal basis of what pose and motion explain.
    own: SMatrix<f64, 2, OWN>,
}

impl ResidualField {
    /// `None` for a view without a pose or with too few corners.
    pub(super) fn of(
        index: usize,
        view: &BoardView,
        estimate: &ViewEstimate,
        camera: &CameraEstimate,
        lattice: &BoardLattice,
    ) -> Option<Self> {
        let camera_from_board = estimate.camera_from_board?;
        let rotation = camera_from_board.rotation_matrix();
        let height_px = f64::from(camera.image_size.height);
        let mut corners = Vec::new();
        for seen in &view.correspondences {
            let point_in_camera = camera_from_board * seen.point_in_board;
            let Projection { pixel, by_point, by_parameters } =
                camera.lens.project(&point_in_camera)?;
            let inverse_std = seen.std_px.hypot(camera.noise_floor_px).recip();
            let from_center = point_in_camera.coords - camera_from_board.translation();
            // By the predicted row: times of measured rows contain the residuals, so that motion
            // would explain a part of any.
            let time = read_out_time(pixel.y, height_px);
            let mut own = SMatrix::<f64, 2, OWN>::zeros();
            own.fixed_columns_mut::<3>(0).copy_from(&(-by_point * from_center.cross_matrix()));
            own.fixed_columns_mut::<3>(3).copy_from(&by_point);
            let of_pose = own.fixed_columns::<6>(0).into_owned();
            own.fixed_columns_mut::<6>(6).copy_from(&(of_pose * time));
            corners.push(CornerField {
                corner: nearest_point(&lattice.points, &seen.point_in_board)?.1,
                residual: (seen.pixel.to_vector() - pixel.to_vector()) * inverse_std,
                by_offset: by_point * rotation * inverse_std,
                by_lens: by_parameters * inverse_std,
                own: own * inverse_std,
            });
        }
        if corners.len() < LEAST_CORNERS {
            return None;
        }
        let mut field = Self { view: index, corners };
        field.project_own_out();
        Some(field)
    }

    fn project_own_out(&mut self) {
        let own = DMatrix::from_fn(2 * self.corners.len(), OWN, |row, column| {
            self.corners[row / 2].own[(row % 2, column)]
        });
        let basis = own.qr().q();
        for (index, corner) in self.corners.iter_mut().enumerate() {
            corner.own = basis.fixed_view::<2, OWN>(2 * index, 0).into_owned();
        }
        let mut explained = SVector::<f64, OWN>::zeros();
        let mut lens_explained = SMatrix::<f64, OWN, MAX_PARAMETERS>::zeros();
        for corner in &self.corners {
            explained += corner.own.tr_mul(&corner.residual);
            lens_explained += corner.own.tr_mul(&corner.by_lens);
        }
        for corner in &mut self.corners {
            corner.residual -= corner.own * explained;
            corner.by_lens -= corner.own * lens_explained;
        }
    }

    /// The residuals that `shape` leaves.
    pub(super) fn left(&self, symmetry: &Symmetry, shape: &CornerOffsets) -> Vec<Vector2<f64>> {
        let left = |seen: &CornerField| {
            let offset = symmetry.rotation * shape.offsets[symmetry.corner[seen.corner]];
            seen.residual - seen.by_offset * offset - seen.by_lens * shape.lens
        };
        let mut left: Vec<Vector2<f64>> = self.corners.iter().map(left).collect();
        let corners = || self.corners.iter();
        let explained: SVector<f64, OWN> =
            corners().zip(&left).map(|(corner, left)| corner.own.tr_mul(left)).sum();
        for (left, corner) in left.iter_mut().zip(corners()) {
            *left -= corner.own * explained;
        }
        left
    }

    /// The sum of squares of the residuals that `shape` leaves.
    fn misfit(&self, symmetry: &Symmetry, shape: &CornerOffsets) -> f64 {
        self.left(symmetry, shape).iter().map(Vector2::norm_squared).sum()
    }

    /// The same under each symmetry.
    pub(super) fn misfits(&self, lattice: &BoardLattice, shape: &CornerOffsets) -> Vec<f64> {
        lattice.symmetries.iter().map(|symmetry| self.misfit(symmetry, shape)).collect()
    }

    /// The sum of squares for a flat board.
    pub(super) fn square(&self) -> f64 {
        self.corners.iter().map(|corner| corner.residual.norm_squared()).sum()
    }

    /// The degrees of freedom that pose and motion leave.
    pub(super) fn freedom(&self) -> f64 {
        (2 * self.corners.len() - OWN) as f64
    }
}
