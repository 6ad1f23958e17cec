//! The rational model: OpenCV's eight coefficients, ROS `rational_polynomial`.

use nalgebra::{Matrix2, Point3, SMatrix, Vector2};

use crate::geometry::lens::model::{
    CameraInfoModel, CoefficientPrior, Distorted, DistortionModel, ForeignModel, KalibrModel,
    ModelFacts, OpencvModel,
};
use crate::geometry::lens::plane::{self, MAX_RADIUS, PlaneDistortion};
use crate::geometry::pixel::Bearing;
use crate::geometry::polynomial;

/// [`crate::geometry::lens::Brown`] with d = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6
/// r⁶): OpenCV's `CALIB_RATIONAL_MODEL`, in its order k1, k2, p1, p2, k3, k4, k5, k6.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rational {
    numerator: [f64; 4],
    denominator: [f64; 4],
    p1: f64,
    p2: f64,
    radius2_limit: f64,
}

impl Rational {
    /// d and its derivative by r², and the denominator.
    #[inline(always)]
    fn factor_and_slope(&self, r2: f64) -> (f64, f64, f64) {
        let slope = |c: &[f64; 4]| c[1] + r2 * (2.0 * c[2] + 3.0 * r2 * c[3]);
        let denominator = polynomial::evaluate(&self.denominator, r2);
        let factor = polynomial::evaluate(&self.numerator, r2) / denominator;
        (
            factor,
            (slope(&self.numerator) - factor * slope(&self.denominator)) / denominator,
            denominator,
        )
    }
}

impl PlaneDistortion<8> for Rational {
    fn radius2_limit(&self) -> f64 {
        self.radius2_limit
    }

    fn radial_factor(&self, r2: f64) -> f64 {
        self.factor_and_slope(r2).0
    }

    #[inline(always)]
    fn distorted_with_jacobians(
        &self,
        ideal: Vector2<f64>,
    ) -> (Vector2<f64>, Matrix2<f64>, SMatrix<f64, 2, 8>) {
        let (x, y) = (ideal.x, ideal.y);
        let (p1, p2) = (self.p1, self.p2);
        let (xx, xy, yy) = (x * x, x * y, y * y);
        let r2 = xx + yy;
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let (factor, half_slope, denominator) = self.factor_and_slope(r2);
        let slope = 2.0 * half_slope;
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
        let above = 1.0 / denominator;
        let below = -factor / denominator;
        let column = |by_factor: f64| ideal * by_factor;
        let by_coefficients = SMatrix::<f64, 2, 8>::from_columns(&[
            column(r2 * above),
            column(r4 * above),
            Vector2::new(2.0 * xy, ay),
            Vector2::new(ax, 2.0 * xy),
            column(r6 * above),
            column(r2 * below),
            column(r4 * below),
            column(r6 * below),
        ]);
        (distorted, by_ideal, by_coefficients)
    }
}

/// The squared radius at which r N(r²)/D(r²) stops rising, or D reaches zero: with s = r², the
/// first root of D, or of N D + 2 s (N' D − N D').
fn fold(numerator: &[f64; 4], denominator: &[f64; 4]) -> f64 {
    let end = MAX_RADIUS * MAX_RADIUS;
    let mut rise = [0.0; 7];
    for (i, n) in numerator.iter().enumerate() {
        for (j, d) in denominator.iter().enumerate() {
            rise[i + j] += n * d * (1.0 + 2.0 * (i as f64 - j as f64));
        }
    }
    let pole = polynomial::first_root(denominator, end).unwrap_or(end);
    polynomial::first_root(&rise, end).unwrap_or(end).min(pole)
}

impl DistortionModel<8> for Rational {
    const FACTS: ModelFacts = ModelFacts {
        name: "rational",
        summary: "OpenCV's 8 coefficients, ROS rational_polynomial",
        auto_order: Some(4),
        focal_coefficient: None,
        camera_info: Some(CameraInfoModel::new("rational_polynomial", 8)),
        opencv: Some(OpencvModel::plain(8)),
        kalibr: Some(KalibrModel::pinhole("radtan", 4)),
        mrcal: Some(ForeignModel::new("LENSMODEL_OPENCV8", 8)),
        colmap: Some(ForeignModel::new("FULL_OPENCV", 8)),
    };

    const NAMES: [&'static str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];

    const PRIORS: [CoefficientPrior; 8] = [
        CoefficientPrior::RADIAL,
        CoefficientPrior::RADIAL,
        CoefficientPrior::TANGENTIAL,
        CoefficientPrior::TANGENTIAL,
        CoefficientPrior::RADIAL,
        CoefficientPrior::RADIAL,
        CoefficientPrior::RADIAL,
        CoefficientPrior::RADIAL,
    ];

    fn from_coefficients([k1, k2, p1, p2, k3, k4, k5, k6]: [f64; 8]) -> Self {
        let (numerator, denominator) = ([1.0, k1, k2, k3], [1.0, k4, k5, k6]);
        Self { numerator, denominator, p1, p2, radius2_limit: fold(&numerator, &denominator) }
    }

    fn coefficients(&self) -> [f64; 8] {
        let ([_, k1, k2, k3], [_, k4, k5, k6]) = (self.numerator, self.denominator);
        [k1, k2, self.p1, self.p2, k3, k4, k5, k6]
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        plane::distort(self, point_in_camera)
    }

    #[inline(always)]
    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<8>, bool) {
        plane::distort_or_axis(self, point_in_camera)
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        plane::undistort(self, distorted)
    }

    fn as_rational(&self) -> Option<[f64; 8]> {
        Some(self.coefficients())
    }
}
