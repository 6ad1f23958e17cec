//! What defines a lens model: a formula with its derivatives, and facts about it.
//!
//! Whatever other layers need to know of a model by name is data here ([`ModelFacts`]): its names
//! in other programs, its rank in an automatic choice, the prior of its coefficients. So a new
//! model is one file, and its line in the list of [`crate::geometry::lens`].

use nalgebra::{Matrix2x3, Point3, SMatrix, Vector2};

use crate::geometry::pixel::Bearing;

/// The effect of a lens on a ray before the camera matrix: one model with `N` coefficients.
pub trait DistortionModel<const N: usize>: Sized {
    /// Facts about it besides its formula.
    const FACTS: ModelFacts;

    /// The coefficients' names, in the order of every array of coefficients.
    const NAMES: [&'static str; N];

    /// The prior of each coefficient.
    const PRIORS: [CoefficientPrior; N];

    /// The coefficients of a lens without distortion, or the nearest to one.
    const STRAIGHT: [f64; N] = [0.0; N];

    /// The coefficients from which a search starts.
    const START: [f64; N] = [0.0; N];

    /// The model with these coefficients.
    fn from_coefficients(coefficients: [f64; N]) -> Self;

    /// Its coefficients.
    fn coefficients(&self) -> [f64; N];

    /// Distorted normalized coordinates of a point in the camera frame; `None` outside the valid
    /// region.
    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>>;

    /// As [`Self::distort`], with its derivatives.
    fn distort_with_jacobians(&self, point_in_camera: &Point3<f64>) -> Option<Distorted<N>> {
        let (distorted, inside) = self.distort_or_axis(point_in_camera);
        inside.then_some(distorted)
    }

    /// As [`Self::distort_with_jacobians`], and whether the point is inside the valid region. If
    /// not, the derivatives are those at some point inside: finite, but without meaning.
    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<N>, bool);

    /// The direction that [`Self::distort`] maps to `distorted`; `None` outside the valid region.
    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing>;

    /// The same lens by OpenCV's eight coefficients k1, k2, p1, p2, k3, k4, k5, k6; `None` for one
    /// that they cannot describe.
    fn as_rational(&self) -> Option<[f64; 8]> {
        None
    }
}

/// Distorted normalized coordinates with their derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Distorted<const N: usize> {
    /// (x_d, y_d).
    pub normalized: Vector2<f64>,
    /// By the point in the camera frame.
    pub by_point: Matrix2x3<f64>,
    /// By the model's coefficients.
    pub by_coefficients: SMatrix<f64, 2, N>,
}

/// Facts about a model besides its formula.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelFacts {
    /// Its name in documents and on the command line: the contract's `lens.model`.
    pub name: &'static str,
    /// A short description, for the command line's help.
    pub summary: &'static str,
    /// Its rank in the order in which models are preferred in an automatic choice; `None` for a
    /// model that is fitted only on request.
    pub auto_order: Option<u8>,
    /// The coefficient that scales the image's center as the focal lengths do, where there is one.
    /// In the double sphere model, one of ξ, α and the focal lengths f is redundant to first order
    /// at ξ = 0 (δξ = k, δα = k (2α − 1), δf = k f change no image); elsewhere only a wide field of
    /// view separates them.
    pub focal_coefficient: Option<&'static str>,
    /// In `camera_info` messages.
    pub camera_info: Option<CameraInfoModel>,
    /// In OpenCV.
    pub opencv: Option<OpencvModel>,
    /// In Kalibr.
    pub kalibr: Option<KalibrModel>,
    /// In mrcal.
    pub mrcal: Option<ForeignModel>,
    /// In COLMAP.
    pub colmap: Option<ForeignModel>,
}

/// A model in another program, which takes the coefficients in the same order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ForeignModel {
    /// Its name there.
    pub name: &'static str,
    /// Its number of coefficients there; those that the model lacks are 0.
    pub coefficients: usize,
}

/// A model in camera info messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraInfoModel {
    /// The `distortion_model` of ROS.
    pub ros: &'static str,
    /// That of Foxglove.
    pub foxglove: &'static str,
    /// Names that some drivers write.
    pub also: &'static [&'static str],
    /// Its number of coefficients there; those that the model lacks are 0.
    pub coefficients: usize,
}

/// A model in OpenCV.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OpencvModel {
    /// Whether it is that of `cv::fisheye`.
    pub fisheye: bool,
    /// Its number of coefficients there; those that the model lacks are 0.
    pub coefficients: usize,
}

/// A model in Kalibr.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KalibrModel {
    /// Its `camera_model`. Unless that is `pinhole`, the model's coefficients come before the focal
    /// lengths in the intrinsics.
    pub camera: &'static str,
    /// Its `distortion_model`.
    pub distortion: &'static str,
    /// The number of coefficients of that; a lens whose other coefficients are not 0 is refitted.
    pub coefficients: usize,
}

/// The prior of a coefficient: independent and Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoefficientPrior {
    /// Its mean.
    pub mean: f64,
    /// Its standard deviation.
    pub std: f64,
}

impl CoefficientPrior {
    /// A radial coefficient of an ordinary lens.
    pub const RADIAL: Self = Self::about(0.0);
    /// A tangential coefficient of a camera with a mounted lens.
    pub const TANGENTIAL: Self = Self { mean: 0.0, std: 0.0003 };

    /// A coefficient with this `mean`, as uncertain as [`Self::RADIAL`].
    pub const fn about(mean: f64) -> Self {
        Self { mean, std: 0.2 }
    }
}

impl ForeignModel {
    /// A model with this number of coefficients there.
    pub const fn new(name: &'static str, coefficients: usize) -> Self {
        Self { name, coefficients }
    }
}

impl CameraInfoModel {
    /// A model with the same name everywhere.
    pub const fn new(name: &'static str, coefficients: usize) -> Self {
        Self { ros: name, foxglove: name, also: &[], coefficients }
    }
}

impl OpencvModel {
    /// A model of `cv::projectPoints`.
    pub const fn plain(coefficients: usize) -> Self {
        Self { fisheye: false, coefficients }
    }
}

impl KalibrModel {
    /// Its camera with a separate distortion; others have their coefficients among the intrinsics.
    pub const PINHOLE: &'static str = "pinhole";

    /// A `pinhole` camera behind this distortion.
    pub const fn pinhole(distortion: &'static str, coefficients: usize) -> Self {
        Self { camera: Self::PINHOLE, distortion, coefficients }
    }

    /// Whether the coefficients are those of a distortion.
    pub fn is_pinhole(&self) -> bool {
        self.camera == Self::PINHOLE
    }
}
