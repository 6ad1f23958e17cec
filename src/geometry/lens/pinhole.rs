//! The lens without distortion.

use nalgebra::{Matrix2x3, Point3, SMatrix, Unit, Vector2, Vector3};

use crate::geometry::lens::model::{
    CameraInfoModel, CoefficientPrior, Distorted, DistortionModel, ForeignModel, KalibrModel,
    ModelFacts, OpencvModel,
};
use crate::geometry::pixel::Bearing;

/// (x_d, y_d) = (x/z, y/z). Valid for z > 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole;

impl DistortionModel<0> for Pinhole {
    const FACTS: ModelFacts = ModelFacts {
        name: "pinhole",
        summary: "no distortion",
        auto_order: Some(0),
        focal_coefficient: None,
        camera_info: Some(CameraInfoModel::new("plumb_bob", 5)),
        opencv: Some(OpencvModel::plain(5)),
        kalibr: Some(KalibrModel::pinhole("none", 0)),
        mrcal: Some(ForeignModel::new("LENSMODEL_PINHOLE", 0)),
        colmap: Some(ForeignModel::new("PINHOLE", 0)),
    };

    const NAMES: [&'static str; 0] = [];

    const PRIORS: [CoefficientPrior; 0] = [];

    fn from_coefficients(_: [f64; 0]) -> Self {
        Self
    }

    fn coefficients(&self) -> [f64; 0] {
        []
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        let normalized = point_in_camera.coords.xy() / point_in_camera.z;
        let seen = point_in_camera.z > 0.0 && normalized.x.is_finite() && normalized.y.is_finite();
        seen.then_some(normalized)
    }

    #[inline(always)]
    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<0>, bool) {
        let inverse_z = 1.0 / point_in_camera.z;
        let (x, y) = (point_in_camera.x * inverse_z, point_in_camera.y * inverse_z);
        let seen = (point_in_camera.z > 0.0) & x.is_finite() & y.is_finite();
        let inverse_z = if seen { inverse_z } else { 1.0 };
        let (x, y) = if seen { (x, y) } else { (0.0, 0.0) };
        let by_point =
            Matrix2x3::new(inverse_z, 0.0, -x * inverse_z, 0.0, inverse_z, -y * inverse_z);
        (
            Distorted {
                normalized: Vector2::new(x, y),
                by_point,
                by_coefficients: SMatrix::zeros(),
            },
            seen,
        )
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        distorted
            .iter()
            .all(|v| v.is_finite())
            .then(|| Unit::new_normalize(Vector3::new(distorted.x, distorted.y, 1.0)))
    }

    fn as_rational(&self) -> Option<[f64; 8]> {
        Some([0.0; 8])
    }
}
