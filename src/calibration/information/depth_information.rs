//! What is known of a depth camera beside a color camera from planes: its lens, where it is and its
//! error in depth, and how all of it moves with what is not known of color's lens.
//!
//! ```text
//! N = Σ over views of (A − C (H + P)⁻¹ Cᵀ) / σ²      K = Σ over views of C (H + P)⁻¹ Gᵀ / σ²
//! covariance of depth = N⁻¹ t + N⁻¹ K Λ⁻¹ Kᵀ N⁻¹     with color = N⁻¹ K Λ⁻¹
//! ```
//!
//! A, C and P are the blocks (depth, depth × pose, pose) of what the board's surface says, H and G
//! those (pose, lens × pose) of color's corners, Λ what is known of color's lens. As in the solve,
//! corners come first: planes teach the depth camera, and color's lens only passes on what it is
//! not known by. t is by how much neighboring readings err together.

use nalgebra::{DMatrix, DVector, SMatrix};

use crate::calibration::information::lens_information::{LensInformation, inverse};
use crate::calibration::information::view_information::{ViewNormal, inverse_of_pose};
use crate::estimation::rgbd::plane_information::{
    CORRECTION_AT, LENS_PARAMETERS, POSE_AT, PlacedDepth, PlaneNormal,
};
use crate::geometry::lens::MAX_PARAMETERS;

/// What is known of a depth camera.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthInformation {
    /// The parameters of color's lens that are open.
    pub free: Vec<usize>,
    /// The inverse of the covariance of those.
    pub color: DMatrix<f64>,
    /// What planes say of the depth camera, color's lens being known.
    pub depth: DepthNormal,
    /// By how much the variance of means over many readings is greater than if each erred by
    /// itself; at least 1.
    pub together: f64,
}

/// N and K of one view, or of several.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthNormal {
    /// N, over the depth camera's parameters.
    pub by_depth: DMatrix<f64>,
    /// K, by the open parameters of color's lens.
    pub by_color: DMatrix<f64>,
}

/// Before any view: the relative standard deviation of the focal length about one that sees as much
/// as color does …
const PRIOR_FOCAL: f64 = 0.3;
/// … that of the principal point, relative to the focal length, and the rotation beside color, in
/// radians …
const PRIOR_ANGLE: f64 = 0.2;
/// … and where it is, in meters: about where devices have it.
const PRIOR_PLACE_M: f64 = 0.2;

impl DepthNormal {
    /// A part of it.
    pub fn scaled(&self, part: f64) -> Self {
        Self { by_depth: &self.by_depth * part, by_color: &self.by_color * part }
    }
}

impl DepthInformation {
    /// Nothing known of `depth` but about where devices have it: weak enough that a few views
    /// outweigh it.
    pub fn prior(color: &LensInformation, depth: &PlacedDepth) -> Self {
        let mut by_depth = depth.correction_prior();
        let focal_px = 0.5 * (depth.lens.matrix.fx + depth.lens.matrix.fy);
        for k in 0..CORRECTION_AT {
            let std = match k {
                0 | 1 => PRIOR_FOCAL * focal_px,
                _ if k < LENS_PARAMETERS => PRIOR_ANGLE * focal_px,
                _ if k < POSE_AT + 3 => PRIOR_ANGLE,
                _ => PRIOR_PLACE_M,
            };
            by_depth[(k, k)] += 1.0 / (std * std);
        }
        Self::nothing(color, by_depth)
    }

    /// What the solve itself takes for known before it: that of the correction alone.
    pub fn of_solve(color: &LensInformation, depth: &PlacedDepth) -> Self {
        Self::nothing(color, depth.correction_prior())
    }

    fn nothing(color: &LensInformation, by_depth: DMatrix<f64>) -> Self {
        let by_color = DMatrix::zeros(by_depth.nrows(), color.free.len());
        Self {
            free: color.free.clone(),
            color: color.matrix.clone(),
            depth: DepthNormal { by_depth, by_color },
            together: 1.0,
        }
    }

    /// What one view says: color's corners, and the board's surface as depth measured it, with the
    /// board's pose about the same point as [`ViewNormal::middle_in_camera`]. `None` where corners
    /// do not determine the board's pose.
    pub fn of_view(&self, color: &ViewNormal, planes: &PlaneNormal) -> Option<DepthNormal> {
        let inverse = inverse_of_pose(&(color.by_pose + planes.by_pose))?;
        let through = &planes.coupling * inverse;
        let by_depth = &planes.by_depth - &through * planes.coupling.transpose();
        let coupling: &SMatrix<f64, MAX_PARAMETERS, 6> = &color.coupling;
        let of_free = DMatrix::from_fn(6, self.free.len(), |a, k| coupling[(self.free[k], a)]);
        let by_color = through * of_free;
        let is_finite = by_depth.iter().chain(&by_color).all(|v| v.is_finite());
        is_finite.then_some(DepthNormal { by_depth, by_color })
    }

    /// Takes a view in that color's information has already.
    pub fn add(&mut self, view: &DepthNormal) {
        self.depth.by_depth += &view.by_depth;
        self.depth.by_color += &view.by_color;
    }

    /// The same with one more view: what it says of color's lens, and of depth where it is
    /// measured.
    #[must_use]
    pub fn with(&self, color: &DMatrix<f64>, depth: Option<&DepthNormal>) -> Self {
        let mut known = self.clone();
        known.color += color;
        depth.into_iter().for_each(|depth| known.add(depth));
        known
    }

    /// The covariance of the depth camera's parameters; `None` where they are not determined.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        let by_depth = inverse(&self.depth.by_depth)?;
        let by_color = &by_depth * &self.depth.by_color;
        Some(by_depth * self.together + &by_color * inverse(&self.color)? * by_color.transpose())
    }

    /// Rows whose squares add up to the variance of each of some numbers with these derivatives, a
    /// column each, by depth's parameters and by color's. `None` where something is not determined.
    pub(super) fn deviations(
        &self,
        by_depth: &DMatrix<f64>,
        by_color: &DMatrix<f64>,
    ) -> Option<[DMatrix<f64>; 2]> {
        let scale = scales(&self.depth.by_depth);
        let scaled = scaled(&self.depth.by_depth, &scale);
        let factor = scaled.cholesky()?;
        let mut own = DMatrix::from_fn(by_depth.nrows(), by_depth.ncols(), |row, column| {
            by_depth[(row, column)] * scale[row]
        });
        factor.l_dirty().solve_lower_triangular_mut(&mut own).then_some(())?;
        let mut moved = own.clone();
        factor.l_dirty().tr_solve_lower_triangular_mut(&mut moved).then_some(())?;
        moved.row_iter_mut().zip(scale.iter()).for_each(|(mut row, scale)| row *= *scale);
        let by_color = by_color + self.depth.by_color.tr_mul(&moved);
        let scale = scales(&self.color);
        let factor = self::scaled(&self.color, &scale).cholesky()?;
        let mut through = by_color;
        through.row_iter_mut().zip(scale.iter()).for_each(|(mut row, scale)| row *= *scale);
        factor.l_dirty().solve_lower_triangular_mut(&mut through).then_some(())?;
        Some([own * self.together.sqrt(), through])
    }
}

/// Parameters differ by orders of magnitude.
fn scales(matrix: &DMatrix<f64>) -> DVector<f64> {
    matrix.diagonal().map(|value| 1.0 / value.max(f64::MIN_POSITIVE).sqrt())
}

fn scaled(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] * scale[i] * scale[j])
}
