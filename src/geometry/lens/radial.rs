//! One radial coefficient: the textbook model.

use nalgebra::{Matrix2, Point3, SMatrix, Vector2};

use crate::geometry::lens::model::{
    CameraInfoModel, CoefficientPrior, Distorted, DistortionModel, ForeignModel, KalibrModel,
    ModelFacts, OpencvModel,
};
use crate::geometry::lens::plane::{self, MAX_RADIUS, PlaneDistortion};
use crate::geometry::pixel::Bearing;

/// (x_d, y_d) = (1 + k1 r²) (x, y) with (x, y) = (X/Z, Y/Z) and r² = x² + y².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radial {
    k1: f64,
    radius2_limit: f64,
}

impl PlaneDistortion<1> for Radial {
    fn radius2_limit(&self) -> f64 {
        self.radius2_limit
    }

    fn radial_factor(&self, r2: f64) -> f64 {
        1.0 + self.k1 * r2
    }

    #[inline(always)]
    fn distorted_with_jacobians(
        &self,
        ideal: Vector2<f64>,
    ) -> (Vector2<f64>, Matrix2<f64>, SMatrix<f64, 2, 1>) {
        let r2 = ideal.norm_squared();
        let factor = self.radial_factor(r2);
        let slope = 2.0 * self.k1;
        let across = slope * ideal.x * ideal.y;
        let by_ideal = Matrix2::new(
            factor + slope * ideal.x * ideal.x,
            across,
            across,
            factor + slope * ideal.y * ideal.y,
        );
        (ideal * factor, by_ideal, ideal * r2)
    }
}

impl DistortionModel<1> for Radial {
    const FACTS: ModelFacts = ModelFacts {
        name: "radial",
        summary: "one coefficient",
        auto_order: Some(1),
        focal_coefficient: None,
        camera_info: Some(CameraInfoModel::new("plumb_bob", 5)),
        opencv: Some(OpencvModel::plain(5)),
        kalibr: Some(KalibrModel::pinhole("radtan", 4)),
        mrcal: Some(ForeignModel::new("LENSMODEL_OPENCV4", 4)),
        colmap: Some(ForeignModel::new("OPENCV", 4)),
    };

    const NAMES: [&'static str; 1] = ["k1"];

    const PRIORS: [CoefficientPrior; 1] = [CoefficientPrior::RADIAL];

    fn from_coefficients([k1]: [f64; 1]) -> Self {
        let fold = if k1 < 0.0 { -1.0 / (3.0 * k1) } else { f64::INFINITY };
        Self { k1, radius2_limit: fold.min(MAX_RADIUS * MAX_RADIUS) }
    }

    fn coefficients(&self) -> [f64; 1] {
        [self.k1]
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        plane::distort(self, point_in_camera)
    }

    #[inline(always)]
    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<1>, bool) {
        plane::distort_or_axis(self, point_in_camera)
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        plane::undistort(self, distorted)
    }

    fn as_rational(&self) -> Option<[f64; 8]> {
        Some([self.k1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    }
}
