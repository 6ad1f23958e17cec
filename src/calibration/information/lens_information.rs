//! The information on a lens, which is the inverse of its covariance; views add to it.

use nalgebra::DMatrix;

use crate::estimation::camera::CameraEstimate;
use crate::estimation::scaled_factor::scaled_inverse;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;

/// The information on the free parameters of a lens.
#[derive(Debug, Clone, PartialEq)]
pub struct LensInformation {
    /// The lens, as far as it is known.
    pub lens: Lens,
    /// The free parameters, as indices into [`Lens::parameters`].
    pub free: Vec<usize>,
    /// The inverse of their covariance.
    pub matrix: DMatrix<f64>,
}

/// Priors of an unknown camera: the relative standard deviation of its focal length (from telephoto
/// to fisheye, around a webcam's) …
const PRIOR_FOCAL: f64 = 0.4;
/// … of the relative difference of fx and fy (pixels are square to a few percent) …
const PRIOR_ASPECT: f64 = 0.02;
/// … of its principal point, relative to the longer side of the image …
const PRIOR_PRINCIPAL_POINT: f64 = 0.05;
/// … and of radial and tangential coefficients.
const PRIOR_RADIAL: f64 = 0.3;
const PRIOR_TANGENTIAL: f64 = 0.003;

impl LensInformation {
    /// The prior before any image, about what cameras' lenses are like. It is weak enough that a
    /// few views outweigh it, and keeps every uncertainty finite.
    pub fn prior(lens: Lens, size: ImageSize) -> Self {
        let model = lens.model();
        let free = open_parameters(model);
        let names = Lens::parameter_names(model);
        let focal_px = 0.5 * (lens.matrix.fx + lens.matrix.fy);
        let std = |name: &str| match name {
            "cx" | "cy" => PRIOR_PRINCIPAL_POINT * f64::from(size.width.max(size.height)),
            "p1" | "p2" => PRIOR_TANGENTIAL,
            _ => PRIOR_RADIAL,
        };
        let mut matrix = DMatrix::zeros(free.len(), free.len());
        for (at, index) in free.iter().enumerate().skip(2) {
            matrix[(at, at)] = std(names[*index]).powi(-2);
        }
        // The inverse of the covariance of fx = f (1 + a / 2) and fy = f (1 − a / 2).
        let (common, differing) =
            ((PRIOR_FOCAL * focal_px).powi(2), (0.5 * PRIOR_ASPECT * focal_px).powi(2));
        let (own, shared) = (common + differing, common - differing);
        let determinant = own * own - shared * shared;
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            matrix[(row, column)] = if row == column { own } else { -shared } / determinant;
        }
        Self { lens, free, matrix }
    }

    /// The information in an estimate: the inverse of its covariance, all variance inflation
    /// included. `None` where no parameter is free or the covariance cannot be inverted.
    pub fn of_estimate(estimate: &CameraEstimate) -> Option<Self> {
        let covariance = &estimate.lens_covariance;
        let free: Vec<usize> =
            (0..covariance.nrows()).filter(|index| covariance[(*index, *index)] > 0.0).collect();
        if free.is_empty() {
            return None;
        }
        let of_free =
            DMatrix::from_fn(free.len(), free.len(), |i, j| covariance[(free[i], free[j])]);
        Some(Self { lens: estimate.lens, matrix: scaled_inverse(&of_free)?, free })
    }

    /// The same with the information of one more view.
    #[must_use]
    pub fn with(&self, view: &DMatrix<f64>) -> Self {
        Self { matrix: &self.matrix + view, ..self.clone() }
    }

    /// The covariance of all of the lens's parameters, in the order of [`Lens::parameter_names`],
    /// with zero rows for fixed ones. `None` where it is not determined.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        over_all(&self.lens, &self.free, &scaled_inverse(&self.matrix)?)
    }

    /// As [`Self::covariance`], with the information of `view` added.
    pub fn covariance_with(&self, view: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        over_all(&self.lens, &self.free, &scaled_inverse(&(&self.matrix + view))?)
    }
}

/// All parameters of a model except skew, which is 0 unless asked for.
pub fn open_parameters(model: LensModel) -> Vec<usize> {
    (0..Lens::parameter_names(model).len()).filter(|index| *index != Lens::SKEW).collect()
}

/// Expands a covariance of the free parameters to all parameters; `None` where it is not finite.
fn over_all(lens: &Lens, free: &[usize], of_free: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let count = lens.parameters().len();
    let mut covariance = DMatrix::zeros(count, count);
    for (i, row) in free.iter().enumerate() {
        for (j, column) in free.iter().enumerate() {
            covariance[(*row, *column)] = of_free[(i, j)];
        }
    }
    covariance.iter().all(|v| v.is_finite()).then_some(covariance)
}
