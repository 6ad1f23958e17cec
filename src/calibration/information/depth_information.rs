//! The information on a depth camera beside a color camera: its lens, its pose and its depth error,
//! and how all of these depend on the uncertainty of color's lens.
//!
//! ```text
//! N = Σ over views of (A − C (H + P)⁻¹ Cᵀ) / σ²      K = Σ over views of C (H + P)⁻¹ Gᵀ / σ²
//! covariance of depth = N⁻¹ t + N⁻¹ K Λ⁻¹ Kᵀ N⁻¹     with color = N⁻¹ K Λ⁻¹
//! ```
//!
//! A, C and P are the blocks (depth, depth × pose, pose) of the normal matrix of the board's
//! surface, H and G the blocks (pose, lens × pose) of color's corners, and Λ is the information on
//! color's lens. As in the solve, corners come first: planes determine the depth camera only, and
//! the uncertainty of color's lens propagates to it. t is the variance inflation by correlated
//! errors of neighboring readings.
//!
//! Where infrared sees boards, its corners determine lens and pose, and planes only the depth
//! error. R and S are then the planes' blocks (error, error) and (error, lens and pose) of the sum
//! over views, κ their rows of K for the error, and N₁ and K₁ the corners' N and K for lens and
//! pose:
//!
//! ```text
//! N = [N₁ + Sᵀ R⁻¹ S, Sᵀ; S, R]      K = [K₁ + Sᵀ R⁻¹ κ; κ]
//! ```
//!
//! so that lens and pose have the covariance that corners give, whatever planes say.

use std::borrow::Cow;

use nalgebra::{DMatrix, Matrix6, SMatrix};

use crate::calibration::information::infrared_corners::InfraredNormal;
use crate::calibration::information::lens_information::LensInformation;
use crate::calibration::information::view_information::{ViewNormal, inverse_of_pose};
use crate::estimation::rgbd::plane_information::{PlacedDepth, PlaneNormal};
use crate::estimation::scaled_factor::{ScaledFactor, scaled_inverse};
use crate::geometry::lens::MAX_PARAMETERS;

/// The information on a depth camera.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthInformation {
    /// The free parameters of color's lens.
    pub free: Vec<usize>,
    /// The inverse of the covariance of those.
    pub color: DMatrix<f64>,
    /// What the views add for the depth camera, given color's lens.
    pub depth: DepthNormal,
    /// The parameters of the depth camera before this index are determined by infrared corners; its
    /// correction begins there. `None` where planes determine all of them.
    pub by_infrared: Option<usize>,
    /// The factor by which correlated errors of readings increase the variance of means over many
    /// of them; at least 1.
    pub together: f64,
}

/// N and K of one view, or of several.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthNormal {
    /// N, over the depth camera's parameters.
    pub by_depth: DMatrix<f64>,
    /// K, over the free parameters of color's lens.
    pub by_color: DMatrix<f64>,
}

/// Priors before any view: the relative standard deviation of the focal length, around the one that
/// gives color's field of view …
const PRIOR_FOCAL: f64 = 0.3;
/// … that of the principal point, relative to the focal length, and of the rotation relative to
/// color, in radians …
const PRIOR_ANGLE: f64 = 0.2;
/// … of the translation, in meters: about what devices have …
const PRIOR_PLACE_M: f64 = 0.2;
/// … and of the distortion coefficients: 1 moves pixels one focal length from the center by one
/// focal length. The solve has no such priors.
const PRIOR_DISTORTION: f64 = 1.0;

impl DepthNormal {
    /// The same, scaled by `part`.
    pub fn scaled(&self, part: f64) -> Self {
        Self { by_depth: &self.by_depth * part, by_color: &self.by_color * part }
    }
}

impl DepthInformation {
    /// The prior of `depth`, about what devices are like: weak enough that a few views outweigh it.
    pub fn prior(color: &LensInformation, depth: &PlacedDepth) -> Self {
        let mut by_depth = depth.correction_prior();
        let focal_px = 0.5 * (depth.lens.matrix.fx + depth.lens.matrix.fy);
        let of_lens = |index: &usize| match index {
            0 | 1 => PRIOR_FOCAL * focal_px,
            2 | 3 => PRIOR_ANGLE * focal_px,
            _ => PRIOR_DISTORTION,
        };
        let of_place = [PRIOR_ANGLE, PRIOR_ANGLE, PRIOR_ANGLE].into_iter();
        let of_place = of_place.chain([PRIOR_PLACE_M; 3]);
        for (k, std) in depth.open.iter().map(of_lens).chain(of_place).enumerate() {
            by_depth[(k, k)] += 1.0 / (std * std);
        }
        Self::nothing(color, by_depth)
    }

    /// The prior of the solve itself: that of the correction only.
    pub fn of_solve(color: &LensInformation, depth: &PlacedDepth) -> Self {
        Self::nothing(color, depth.correction_prior())
    }

    fn nothing(color: &LensInformation, by_depth: DMatrix<f64>) -> Self {
        let by_color = DMatrix::zeros(by_depth.nrows(), color.free.len());
        Self {
            free: color.free.clone(),
            color: color.matrix.clone(),
            depth: DepthNormal { by_depth, by_color },
            by_infrared: None,
            together: 1.0,
        }
    }

    /// The same where infrared sees boards too.
    #[must_use]
    pub fn with_infrared(self, depth: &PlacedDepth) -> Self {
        Self { by_infrared: Some(depth.correction_at()), ..self }
    }

    /// What the planes of one view add: `color` has its corners, and `planes` the board's surface
    /// as depth measured it, both with the board's pose about [`ViewNormal::middle_in_camera`].
    /// `None` where the corners do not determine the board's pose.
    pub fn of_view(&self, color: &ViewNormal, planes: &PlaneNormal) -> Option<DepthNormal> {
        let of_surface = (&planes.by_depth, &planes.coupling, &planes.by_pose);
        let mut view = self.without_board(color, of_surface)?;
        if let Some(corner_parameters) = self.by_infrared {
            view.by_depth.view_mut((0, 0), (corner_parameters, corner_parameters)).fill(0.0);
            view.by_color.view_mut((0, 0), (corner_parameters, self.free.len())).fill(0.0);
        }
        Some(view)
    }

    /// As [`Self::of_view`], for a view in which infrared sees the board; `planes` may be missing.
    pub fn of_view_with_infrared(
        &self,
        color: &ViewNormal,
        infrared: &InfraredNormal,
        planes: Option<&PlaneNormal>,
    ) -> Option<DepthNormal> {
        let of_corners = (&infrared.by_depth, &infrared.coupling, &infrared.by_pose);
        let by_corners = self.without_board(color, of_corners)?;
        let (Some(planes), Some(corner_parameters)) = (planes, self.by_infrared) else {
            return Some(by_corners);
        };
        let both = (
            &(&infrared.by_depth + &planes.by_depth),
            &(&infrared.coupling + &planes.coupling),
            &(infrared.by_pose + planes.by_pose),
        );
        let mut all = self.without_board(color, both)?;
        let (lens_and_place, free) =
            ((corner_parameters, corner_parameters), (corner_parameters, self.free.len()));
        all.by_depth
            .view_mut((0, 0), lens_and_place)
            .copy_from(&by_corners.by_depth.view((0, 0), lens_and_place));
        all.by_color.view_mut((0, 0), free).copy_from(&by_corners.by_color.view((0, 0), free));
        Some(all)
    }

    /// Normal equations together with those of color's corners, the board's pose eliminated.
    fn without_board(
        &self,
        color: &ViewNormal,
        (by_depth, coupling, by_pose): (&DMatrix<f64>, &DMatrix<f64>, &Matrix6<f64>),
    ) -> Option<DepthNormal> {
        let inverse = inverse_of_pose(&(color.by_pose + by_pose))?;
        let through = coupling * inverse;
        let by_depth = by_depth - &through * coupling.transpose();
        let coupling: &SMatrix<f64, MAX_PARAMETERS, 6> = &color.coupling;
        let of_free = DMatrix::from_fn(6, self.free.len(), |a, k| coupling[(self.free[k], a)]);
        let by_color = through * of_free;
        let is_finite = by_depth.iter().chain(&by_color).all(|v| v.is_finite());
        is_finite.then_some(DepthNormal { by_depth, by_color })
    }

    /// Adds a view that color's information already includes.
    pub fn add(&mut self, view: &DepthNormal) {
        self.depth.by_depth += &view.by_depth;
        self.depth.by_color += &view.by_color;
    }

    /// The same with one more view: its information on color's lens, and on depth if it was
    /// measured.
    #[must_use]
    pub fn with(&self, color: &DMatrix<f64>, depth: Option<&DepthNormal>) -> Self {
        let mut known = self.clone();
        known.color += color;
        depth.into_iter().for_each(|depth| known.add(depth));
        known
    }

    /// N and K of all views.
    fn of_all_views(&self) -> Option<Cow<'_, DepthNormal>> {
        let Some(at) = self.by_infrared else { return Some(Cow::Borrowed(&self.depth)) };
        let DepthNormal { by_depth, by_color } = &self.depth;
        let (count, free) = (by_depth.nrows() - at, self.free.len());
        let shared = by_depth.view((at, 0), (count, at));
        let error = scaled_inverse(&by_depth.view((at, at), (count, count)).into_owned())?;
        let through = shared.transpose() * error;
        let mut all = self.depth.clone();
        let mut lens_and_place = all.by_depth.view_mut((0, 0), (at, at));
        lens_and_place += &through * shared;
        let mut of_color = all.by_color.view_mut((0, 0), (at, free));
        of_color += &through * by_color.view((at, 0), (count, free));
        Some(Cow::Owned(all))
    }

    /// The covariance of the depth camera's parameters; `None` where they are not determined.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        let views = self.of_all_views()?;
        let by_depth = scaled_inverse(&views.by_depth)?;
        let by_color = &by_depth * &views.by_color;
        Some(
            by_depth * self.together
                + &by_color * scaled_inverse(&self.color)? * by_color.transpose(),
        )
    }

    /// Two matrices with a column per quantity: the squared norms of its two columns add up to its
    /// variance. `by_depth` and `by_color` are the quantities' derivatives, a column each. `None`
    /// where something is undetermined.
    pub(super) fn deviations(
        &self,
        by_depth: &DMatrix<f64>,
        by_color: &DMatrix<f64>,
    ) -> Option<[DMatrix<f64>; 2]> {
        let views = self.of_all_views()?;
        // There are far more columns than parameters: multiplying by the root of the inverse is
        // much faster than solving for each column.
        let root = |matrix| ScaledFactor::of(matrix)?.root_of_inverse();
        let of_depth = root(&views.by_depth)?;
        let own = &of_depth * by_depth;
        let moved = of_depth.transpose() * &own;
        let by_color = by_color + views.by_color.transpose() * moved;
        let through = root(&self.color)? * by_color;
        Some([own * self.together.sqrt(), through])
    }
}
