//! Brown's model with three radial and two tangential coefficients: OpenCV's five, ROS `plumb_bob`.

use nalgebra::{Matrix2, Point3, SMatrix, Vector2};

use crate::geometry::lens::model::{
    CameraInfoModel, CoefficientPrior, Distorted, DistortionModel, ForeignModel, KalibrModel,
    ModelFacts, OpencvModel,
};
use crate::geometry::lens::plane::{self, MAX_RADIUS, PlaneDistortion};
use crate::geometry::pixel::Bearing;
use crate::geometry::polynomial;

/// With (x, y) = (X/Z, Y/Z), r² = x² + y² and d = 1 + k1 r² + k2 r⁴ + k3 r⁶:
/// x_d = d x + 2 p1 x y + p2 (r² + 2 x²), y_d = d y + p1 (r² + 2 y²) + 2 p2 x y.
///
/// D. C. Brown, *Close-range camera calibration*, 1971; the order of OpenCV's `calibrateCamera`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brown {
    k1: f64,
    k2: f64,
    p1: f64,
    p2: f64,
    k3: f64,
    radius2_limit: f64,
}

impl PlaneDistortion<5> for Brown {
    fn radius2_limit(&self) -> f64 {
        self.radius2_limit
    }

    fn radial_factor(&self, r2: f64) -> f64 {
        1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
    }

    #[inline(always)]
    fn distorted_with_jacobians(
        &self,
        ideal: Vector2<f64>,
    ) -> (Vector2<f64>, Matrix2<f64>, SMatrix<f64, 2, 5>) {
        let (x, y) = (ideal.x, ideal.y);
        let (p1, p2) = (self.p1, self.p2);
        let (xx, xy, yy) = (x * x, x * y, y * y);
        let r2 = xx + yy;
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let factor = self.radial_factor(r2);
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3));
        let (ax, ay) = (r2 + 2.0 * xx, r2 + 2.0 * yy);
        let distorted = Vector2::new(
            factor * x + 2.0 * p1 * xy + p2 * ax,
            factor * y + p1 * ay + 2.0 * p2 * xy,
        );
        let across = slope * xy + 2.0 * (p1 * x + p2 * y);
        let by_ideal = Matrix2::new(
            factor + slope * xx + 2.0 * p1 * y + 6.0 * p2 * x,
            across,
            across,
            factor + slope * yy + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        let by_coefficients = SMatrix::<f64, 2, 5>::new(
            x * r2,
            x * r4,
            2.0 * xy,
            ax,
            x * r6,
            y * r2,
            y * r4,
            ay,
            2.0 * xy,
            y * r6,
        );
        (distorted, by_ideal, by_coefficients)
    }
}

impl DistortionModel<5> for Brown {
    const FACTS: ModelFacts = ModelFacts {
        name: "brown",
        summary: "OpenCV's 5 coefficients, ROS plumb_bob",
        auto_order: Some(2),
        focal_coefficient: None,
        camera_info: Some(CameraInfoModel::new("plumb_bob", 5)),
        opencv: Some(OpencvModel::plain(5)),
        // All but k3.
        kalibr: Some(KalibrModel::pinhole("radtan", 4)),
        mrcal: Some(ForeignModel::new("LENSMODEL_OPENCV5", 5)),
        colmap: Some(ForeignModel::new("FULL_OPENCV", 8)),
    };

    const NAMES: [&'static str; 5] = ["k1", "k2", "p1", "p2", "k3"];

    const PRIORS: [CoefficientPrior; 5] = [
        CoefficientPrior::RADIAL,
        CoefficientPrior::RADIAL,
        CoefficientPrior::TANGENTIAL,
        CoefficientPrior::TANGENTIAL,
        CoefficientPrior::RADIAL,
    ];

    fn from_coefficients([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        let end = MAX_RADIUS * MAX_RADIUS;
        let fold = polynomial::first_root(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3], end);
        Self { k1, k2, p1, p2, k3, radius2_limit: fold.unwrap_or(end) }
    }

    fn coefficients(&self) -> [f64; 5] {
        [self.k1, self.k2, self.p1, self.p2, self.k3]
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        plane::distort(self, point_in_camera)
    }

    #[inline(always)]
    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<5>, bool) {
        plane::distort_or_axis(self, point_in_camera)
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        plane::undistort(self, distorted)
    }

    fn as_rational(&self) -> Option<[f64; 8]> {
        Some([self.k1, self.k2, self.p1, self.p2, self.k3, 0.0, 0.0, 0.0])
    }
}
