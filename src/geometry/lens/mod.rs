//! Lenses: from a point in the camera frame to a pixel, and back.
//!
//! A [`Lens`] is a [`CameraMatrix`] behind a [`Distortion`]. A distortion maps a point to
//! *distorted normalized coordinates* (meters at unit distance), the camera matrix maps those to
//! pixels:
//!
//! ```text
//! point in camera --Distortion--> (x_d, y_d) --CameraMatrix--> pixel
//! ```
//!
//! One model a file; a new one is a file, an arm of [`Distortion`], and a line of the conformance
//! tests. Every model knows its *valid region*: the largest connected set around the optical axis
//! in which it is one-to-one. Outside it, projecting and unprojecting answer `None` instead of a
//! plausible wrong number.

mod brown;
pub mod columns;
mod kannala_brandt;
mod pinhole;
mod plane;
mod radial;
mod rational;

use nalgebra::{Matrix2, Matrix2x3, Point3, SMatrix, Vector2};

pub use brown::Brown;
pub use kannala_brandt::KannalaBrandt;
pub use pinhole::Pinhole;
pub use radial::Radial;
pub use rational::Rational;

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::columns::DistortedColumns;
use crate::geometry::pixel::{Bearing, Pixel};

/// The most parameters a lens has: fx, fy, cx, cy, skew and the eight of [`Rational`].
pub const MAX_PARAMETERS: usize = 5 + 8;

/// What a lens does to a ray before the camera matrix: one model with `N` coefficients.
pub trait DistortionModel<const N: usize>: Sized {
    /// The coefficients' names, in the order of every array of coefficients.
    const NAMES: [&'static str; N];

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

    /// As [`Self::distort_with_jacobians`], and whether the point is inside the valid region; if
    /// not, the derivatives are those at some point inside, finite and without meaning.
    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<N>, bool);

    /// The direction that [`Self::distort`] maps to `distorted`; `None` outside the valid region.
    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing>;
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

/// Which distortion model: the contract's `lens.model`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LensModel {
    /// No distortion.
    Pinhole,
    /// One radial coefficient.
    Radial,
    /// OpenCV's five coefficients, ROS `plumb_bob`.
    Brown,
    /// OpenCV's eight coefficients, ROS `rational_polynomial`.
    Rational,
    /// OpenCV's `fisheye`, ROS `equidistant`.
    KannalaBrandt,
}

impl LensModel {
    /// Every model, fewest parameters first.
    pub const ALL: [Self; 5] =
        [Self::Pinhole, Self::Radial, Self::KannalaBrandt, Self::Brown, Self::Rational];

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::Radial => "radial",
            Self::Brown => "brown",
            Self::Rational => "rational",
            Self::KannalaBrandt => "kannala_brandt",
        }
    }

    /// The model with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// Its coefficients' names, in order.
    pub fn coefficient_names(self) -> &'static [&'static str] {
        match self {
            Self::Pinhole => &Pinhole::NAMES,
            Self::Radial => &Radial::NAMES,
            Self::Brown => &Brown::NAMES,
            Self::Rational => &Rational::NAMES,
            Self::KannalaBrandt => &KannalaBrandt::NAMES,
        }
    }
}

impl std::fmt::Display for LensModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A distortion of any of the five models.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// See [`Pinhole`].
    Pinhole(Pinhole),
    /// See [`Radial`].
    Radial(Radial),
    /// See [`Brown`].
    Brown(Brown),
    /// See [`Rational`].
    Rational(Rational),
    /// See [`KannalaBrandt`].
    KannalaBrandt(KannalaBrandt),
}

/// Runs one expression with `$model` bound to the model inside a [`Distortion`].
macro_rules! with_model {
    ($distortion:expr, $model:ident => $result:expr) => {
        match $distortion {
            Distortion::Pinhole($model) => $result,
            Distortion::Radial($model) => $result,
            Distortion::Brown($model) => $result,
            Distortion::Rational($model) => $result,
            Distortion::KannalaBrandt($model) => $result,
        }
    };
}

impl Distortion {
    /// The model `model` with `coefficients`; `None` if their number is not the model's.
    pub fn from_coefficients(model: LensModel, coefficients: &[f64]) -> Option<Self> {
        Some(match model {
            LensModel::Pinhole => {
                Self::Pinhole(Pinhole::from_coefficients(coefficients.try_into().ok()?))
            }
            LensModel::Radial => {
                Self::Radial(Radial::from_coefficients(coefficients.try_into().ok()?))
            }
            LensModel::Brown => {
                Self::Brown(Brown::from_coefficients(coefficients.try_into().ok()?))
            }
            LensModel::Rational => {
                Self::Rational(Rational::from_coefficients(coefficients.try_into().ok()?))
            }
            LensModel::KannalaBrandt => {
                Self::KannalaBrandt(KannalaBrandt::from_coefficients(coefficients.try_into().ok()?))
            }
        })
    }

    /// Which model it is.
    pub fn model(&self) -> LensModel {
        match self {
            Self::Pinhole(_) => LensModel::Pinhole,
            Self::Radial(_) => LensModel::Radial,
            Self::Brown(_) => LensModel::Brown,
            Self::Rational(_) => LensModel::Rational,
            Self::KannalaBrandt(_) => LensModel::KannalaBrandt,
        }
    }

    /// Its coefficients, in the order of [`LensModel::coefficient_names`].
    pub fn coefficients(&self) -> Vec<f64> {
        with_model!(self, model => model.coefficients().to_vec())
    }

    /// Distorted normalized coordinates of a point in the camera frame; `None` outside the valid
    /// region.
    pub fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        with_model!(self, model => model.distort(point_in_camera))
    }

    /// The direction seen at distorted normalized coordinates; `None` outside the valid region.
    pub fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        with_model!(self, model => model.undistort(distorted))
    }
}

/// A camera's optics: camera matrix and distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// fx, fy, cx, cy, skew.
    pub matrix: CameraMatrix,
    /// What bends the rays before it.
    pub distortion: Distortion,
}

/// A projected point with its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Projection {
    /// Where the point is seen.
    pub pixel: Pixel,
    /// Pixels by the point in the camera frame (per meter).
    pub by_point: Matrix2x3<f64>,
    /// Pixels by each lens parameter, in the order of [`Lens::parameters`]; columns past the lens's
    /// own are zero.
    pub by_parameters: SMatrix<f64, 2, MAX_PARAMETERS>,
}

impl Lens {
    /// A lens without distortion.
    pub fn pinhole(matrix: CameraMatrix) -> Self {
        Self { matrix, distortion: Distortion::Pinhole(Pinhole) }
    }

    /// Which model it is.
    pub fn model(&self) -> LensModel {
        self.distortion.model()
    }

    /// The parameters' names: fx, fy, cx, cy, skew, then the model's coefficients.
    pub fn parameter_names(model: LensModel) -> Vec<&'static str> {
        let mut names = vec!["fx", "fy", "cx", "cy", "skew"];
        names.extend(model.coefficient_names());
        names
    }

    /// Its parameters, in the order of [`Self::parameter_names`].
    pub fn parameters(&self) -> Vec<f64> {
        let CameraMatrix { fx, fy, cx, cy, skew } = self.matrix;
        let mut parameters = vec![fx, fy, cx, cy, skew];
        parameters.extend(self.distortion.coefficients());
        parameters
    }

    /// The lens of `model` with `parameters`, in the order of [`Self::parameter_names`]; `None` if
    /// their number is wrong.
    pub fn from_parameters(model: LensModel, parameters: &[f64]) -> Option<Self> {
        let [fx, fy, cx, cy, skew, coefficients @ ..] = parameters else { return None };
        let matrix = CameraMatrix { fx: *fx, fy: *fy, cx: *cx, cy: *cy, skew: *skew };
        Some(Self { matrix, distortion: Distortion::from_coefficients(model, coefficients)? })
    }

    /// Where a point of the camera frame (meters) is seen; `None` outside the lens's valid region
    /// (for every model but [`KannalaBrandt`] that includes all points with z ≤ 0). Agrees with
    /// OpenCV's `projectPoints` and `fisheye::projectPoints` inside it.
    pub fn pixel_from_point(&self, point_in_camera: &Point3<f64>) -> Option<Pixel> {
        Some(self.matrix.pixel_from_normalized(self.distortion.distort(point_in_camera)?))
    }

    /// The direction seen at `pixel`; `None` where the lens model sees nothing.
    pub fn bearing_from_pixel(&self, pixel: Pixel) -> Option<Bearing> {
        self.distortion.undistort(self.matrix.normalized_from_pixel(pixel))
    }

    /// Distorted normalized coordinates of many points, with their derivatives, as columns; see
    /// [`DistortedColumns`].
    #[inline(always)]
    pub fn distort_columns(&self, points_in_camera: [&[f64]; 3], columns: &mut DistortedColumns) {
        with_model!(&self.distortion, model => columns.fill(model, points_in_camera));
    }

    /// As [`Self::pixel_from_point`], with analytic derivatives by point and parameters.
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Projection> {
        with_model!(&self.distortion, model => Some(self.projection(&model.distort_with_jacobians(point_in_camera)?)))
    }

    fn projection<const N: usize>(&self, distorted: &Distorted<N>) -> Projection {
        let CameraMatrix { fx, fy, skew, .. } = self.matrix;
        let pixel_by_normalized = Matrix2::new(fx, skew, 0.0, fy);
        let (x, y) = (distorted.normalized.x, distorted.normalized.y);
        let mut by_parameters = SMatrix::<f64, 2, MAX_PARAMETERS>::zeros();
        by_parameters[(0, 0)] = x;
        by_parameters[(1, 1)] = y;
        by_parameters[(0, 2)] = 1.0;
        by_parameters[(1, 3)] = 1.0;
        by_parameters[(0, 4)] = y;
        by_parameters
            .columns_mut(5, N)
            .copy_from(&(pixel_by_normalized * distorted.by_coefficients));
        Projection {
            pixel: self.matrix.pixel_from_normalized(distorted.normalized),
            by_point: pixel_by_normalized * distorted.by_point,
            by_parameters,
        }
    }
}
