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
//! Each model is one file. A new one is a file, its line in the list below, and a line of the
//! conformance tests. Every model has a *valid region*: the largest connected set around the
//! optical axis in which it is one-to-one. Outside it, projecting and unprojecting return `None`
//! instead of a plausible wrong number.

mod brown;
pub mod columns;
mod double_sphere;
mod eucm;
mod kannala_brandt;
pub mod model;
mod pinhole;
mod plane;
mod radial;
mod rational;

use nalgebra::{Matrix2, Matrix2x3, Point3, SMatrix, Vector2};

pub use brown::Brown;
pub use double_sphere::DoubleSphere;
pub use eucm::Eucm;
pub use kannala_brandt::KannalaBrandt;
pub use model::{CoefficientPrior, Distorted, DistortionModel, ModelFacts};
pub use pinhole::Pinhole;
pub use radial::Radial;
pub use rational::Rational;

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::columns::DistortedColumns;
use crate::geometry::pixel::{Bearing, Pixel};

/// The largest number of parameters of a lens: those of its camera matrix and the most coefficients
/// of any model.
pub const MAX_PARAMETERS: usize = Lens::FIRST_COEFFICIENT + MAX_COEFFICIENTS;

/// The models. A model consists of a line here and its file.
macro_rules! lens_models {
    ($($(#[$doc:meta])* $model:ident,)*) => {
        /// Which distortion model: the contract's `lens.model`.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum LensModel {
            $($(#[$doc])* $model,)*
        }

        impl LensModel {
            /// Every model, fewest coefficients first.
            pub const ALL: [Self; MODEL_COUNT] = [$(Self::$model),*];

            /// Every model's name in documents, in the same order.
            pub const NAMES: [&'static str; MODEL_COUNT] = [$($model::FACTS.name),*];

            /// Facts about it besides its formula.
            pub fn facts(self) -> &'static ModelFacts {
                match self {
                    $(Self::$model => &$model::FACTS,)*
                }
            }

            /// Its coefficients' names, in order.
            pub fn coefficient_names(self) -> &'static [&'static str] {
                match self {
                    $(Self::$model => &$model::NAMES,)*
                }
            }

            /// The priors of its coefficients.
            pub fn priors(self) -> &'static [CoefficientPrior] {
                match self {
                    $(Self::$model => &$model::PRIORS,)*
                }
            }

            /// The coefficients of a lens without distortion, or the nearest to one.
            pub fn straight(self) -> &'static [f64] {
                match self {
                    $(Self::$model => &$model::STRAIGHT,)*
                }
            }
        }

        /// A distortion of any of the models.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum Distortion {
            $($(#[$doc])* $model($model),)*
        }

        impl Distortion {
            /// The model `model` with `coefficients`; `None` if their number is not the model's.
            pub fn from_coefficients(model: LensModel, coefficients: &[f64]) -> Option<Self> {
                Some(match model {
                    $(LensModel::$model => {
                        Self::$model($model::from_coefficients(coefficients.try_into().ok()?))
                    })*
                })
            }

            /// The distortion from which a search for a lens of `model` starts.
            pub fn start(model: LensModel) -> Self {
                match model {
                    $(LensModel::$model => {
                        Self::$model($model::from_coefficients($model::START))
                    })*
                }
            }

            /// Which model it is.
            pub fn model(&self) -> LensModel {
                match self {
                    $(Self::$model(_) => LensModel::$model,)*
                }
            }

            /// Its coefficients, in the order of [`LensModel::coefficient_names`].
            pub fn coefficients(&self) -> Vec<f64> {
                match self {
                    $(Self::$model(model) => model.coefficients().to_vec(),)*
                }
            }

            /// The same lens by OpenCV's eight coefficients k1, k2, p1, p2, k3, k4, k5, k6; `None`
            /// for one that they cannot describe.
            pub fn as_rational(&self) -> Option<[f64; 8]> {
                match self {
                    $(Self::$model(model) => model.as_rational(),)*
                }
            }

            /// Distorted normalized coordinates of a point in the camera frame; `None` outside the
            /// valid region.
            pub fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
                match self {
                    $(Self::$model(model) => model.distort(point_in_camera),)*
                }
            }

            /// The direction seen at distorted normalized coordinates; `None` outside the valid
            /// region.
            pub fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
                match self {
                    $(Self::$model(model) => model.undistort(distorted),)*
                }
            }

            #[inline(always)]
            fn fill_columns(&self, points_in_camera: [&[f64]; 3], columns: &mut DistortedColumns) {
                match self {
                    $(Self::$model(model) => columns.fill(model, points_in_camera),)*
                }
            }

            fn project(&self, matrix: &CameraMatrix, point: &Point3<f64>) -> Option<Projection> {
                match self {
                    $(Self::$model(model) => {
                        Some(projection(matrix, &model.distort_with_jacobians(point)?))
                    })*
                }
            }
        }

        const COEFFICIENT_COUNTS: &[usize] = &[$($model::NAMES.len()),*];
    };
}

// Fewest coefficients first.
lens_models! {
    /// No distortion.
    Pinhole,
    /// One radial coefficient.
    Radial,
    /// The double sphere model, Kalibr's `ds`.
    DoubleSphere,
    /// The enhanced unified model, Kalibr's `eucm`.
    Eucm,
    /// OpenCV's `fisheye`, ROS `equidistant`.
    KannalaBrandt,
    /// OpenCV's five coefficients, ROS `plumb_bob`.
    Brown,
    /// OpenCV's eight coefficients, ROS `rational_polynomial`.
    Rational,
}

const MODEL_COUNT: usize = COEFFICIENT_COUNTS.len();

const MAX_COEFFICIENTS: usize = {
    let (mut most, mut model) = (0, 0);
    while model < MODEL_COUNT {
        if COEFFICIENT_COUNTS[model] > most {
            most = COEFFICIENT_COUNTS[model];
        }
        model += 1;
    }
    most
};

impl LensModel {
    /// Its name in documents.
    pub fn name(self) -> &'static str {
        self.facts().name
    }

    /// The model with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The models that are compared where the choice is left open, fewest coefficients first.
    pub fn compared() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|model| model.facts().auto_order.is_some())
    }

    /// Whether this model contains `smaller`: each lens of `smaller` is one of this model with some
    /// coefficients 0.
    pub fn holds(self, smaller: Self) -> bool {
        let polynomial = |model| Distortion::start(model).as_rational().is_some();
        let count = |model: Self| model.coefficient_names().len();
        self == smaller || polynomial(self) && polynomial(smaller) && count(smaller) < count(self)
    }

    /// The model with this `distortion_model` in camera info messages: of those that share a name,
    /// the one with all its coefficients.
    pub fn from_camera_info(distortion_model: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| {
            model.facts().camera_info.is_some_and(|info| {
                let named = [info.ros, info.foxglove].contains(&distortion_model)
                    || info.also.contains(&distortion_model);
                named && info.coefficients == model.coefficient_names().len()
            })
        })
    }
}

impl std::fmt::Display for LensModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl Distortion {
    /// Its first `count` coefficients, 0 where it has fewer.
    pub fn padded_coefficients(&self, count: usize) -> Vec<f64> {
        let mut coefficients = self.coefficients();
        coefficients.resize(count, 0.0);
        coefficients
    }
}

/// A camera's optics: camera matrix and distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// fx, fy, cx, cy, skew.
    pub matrix: CameraMatrix,
    /// The distortion, applied before the camera matrix.
    pub distortion: Distortion,
}

/// A projected point with its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Projection {
    /// The projection of the point.
    pub pixel: Pixel,
    /// Derivatives of the pixel by the point in the camera frame (per meter).
    pub by_point: Matrix2x3<f64>,
    /// Derivatives of the pixel by each lens parameter, in the order of [`Lens::parameters`];
    /// columns past the lens's own are zero.
    pub by_parameters: SMatrix<f64, 2, MAX_PARAMETERS>,
}

/// The index of each parameter in [`Lens::parameters`].
impl Lens {
    /// Focal length along x.
    pub const FX: usize = 0;
    /// Focal length along y.
    pub const FY: usize = 1;
    /// Principal point along x.
    pub const CX: usize = 2;
    /// Principal point along y.
    pub const CY: usize = 3;
    /// Skew.
    pub const SKEW: usize = 4;
    /// The first of the model's coefficients.
    pub const FIRST_COEFFICIENT: usize = 5;
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

    /// The projection of a point in the camera frame (meters); `None` outside the lens's valid
    /// region, which excludes points with z ≤ 0 for every model except those of fisheyes. Inside
    /// it, the result agrees with OpenCV's `projectPoints` and `fisheye::projectPoints`.
    pub fn pixel_from_point(&self, point_in_camera: &Point3<f64>) -> Option<Pixel> {
        Some(self.matrix.pixel_from_normalized(self.distortion.distort(point_in_camera)?))
    }

    /// The direction of the ray through `pixel`; `None` outside the range of the lens model.
    pub fn bearing_from_pixel(&self, pixel: Pixel) -> Option<Bearing> {
        self.distortion.undistort(self.matrix.normalized_from_pixel(pixel))
    }

    /// Distorted normalized coordinates of many points, with their derivatives, as columns; see
    /// [`DistortedColumns`].
    #[inline(always)]
    pub fn distort_columns(&self, points_in_camera: [&[f64]; 3], columns: &mut DistortedColumns) {
        self.distortion.fill_columns(points_in_camera, columns);
    }

    /// As [`Self::pixel_from_point`], with analytic derivatives by point and parameters.
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Projection> {
        self.distortion.project(&self.matrix, point_in_camera)
    }
}

fn projection<const N: usize>(matrix: &CameraMatrix, distorted: &Distorted<N>) -> Projection {
    let CameraMatrix { fx, fy, skew, .. } = *matrix;
    let pixel_by_normalized = Matrix2::new(fx, skew, 0.0, fy);
    let (x, y) = (distorted.normalized.x, distorted.normalized.y);
    let mut by_parameters = SMatrix::<f64, 2, MAX_PARAMETERS>::zeros();
    by_parameters[(0, Lens::FX)] = x;
    by_parameters[(1, Lens::FY)] = y;
    by_parameters[(0, Lens::CX)] = 1.0;
    by_parameters[(1, Lens::CY)] = 1.0;
    by_parameters[(0, Lens::SKEW)] = y;
    by_parameters
        .columns_mut(Lens::FIRST_COEFFICIENT, N)
        .copy_from(&(pixel_by_normalized * distorted.by_coefficients));
    Projection {
        pixel: matrix.pixel_from_normalized(distorted.normalized),
        by_point: pixel_by_normalized * distorted.by_point,
        by_parameters,
    }
}
