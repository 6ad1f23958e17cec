//! Kannala and Brandt's fisheye model: OpenCV's `fisheye`, ROS `equidistant`.

use std::f64::consts::PI;

use nalgebra::{Matrix2x3, Point3, SMatrix, Unit, Vector2, Vector3};

use crate::geometry::lens::model::{
    CameraInfoModel, CoefficientPrior, Distorted, DistortionModel, ForeignModel, KalibrModel,
    ModelFacts, OpencvModel,
};
use crate::geometry::pixel::Bearing;
use crate::geometry::polynomial;

/// The coefficients of a lens without distortion: the series of the tangent.
const TANGENT: [f64; 4] = [1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0];

/// With θ the angle off the axis: θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), (x_d, y_d) = θ_d (X,
/// Y)/√(X² + Y²).
///
/// J. Kannala and S. Brandt, *A generic camera model and calibration method*, PAMI 2006, eq. 3 with
/// its leading factor absorbed in fx and fy. Projects points beside and behind the camera too, up
/// to the angle at which θ_d stops rising.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KannalaBrandt {
    k: [f64; 4],
    angle_limit: f64,
}

impl KannalaBrandt {
    fn distorted_angle(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        angle * polynomial::evaluate(&[1.0, k1, k2, k3, k4], angle * angle)
    }

    fn slope(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        polynomial::evaluate(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], angle * angle)
    }

    fn angle_of(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        let radius = point.x.hypot(point.y);
        let angle = radius.atan2(point.z);
        let at_origin = radius == 0.0 && point.z == 0.0;
        (angle < self.angle_limit && !at_origin && radius.is_finite()).then_some((radius, angle))
    }
}

impl DistortionModel<4> for KannalaBrandt {
    const FACTS: ModelFacts = ModelFacts {
        name: "kannala_brandt",
        summary: "OpenCV's fisheye, ROS equidistant",
        // It has one coefficient less than OpenCV's five but comes after them, since every program
        // knows those.
        auto_order: Some(3),
        focal_coefficient: None,
        camera_info: Some(CameraInfoModel {
            ros: "equidistant",
            foxglove: "kannala_brandt",
            also: &["fisheye"],
            coefficients: 4,
        }),
        opencv: Some(OpencvModel { fisheye: true, coefficients: 4 }),
        kalibr: Some(KalibrModel::pinhole("equidistant", 4)),
        mrcal: None,
        colmap: Some(ForeignModel::new("OPENCV_FISHEYE", 4)),
    };

    const NAMES: [&'static str; 4] = ["k1", "k2", "k3", "k4"];

    /// Half way between an equidistant lens (0) and one without distortion.
    const PRIORS: [CoefficientPrior; 4] = [
        CoefficientPrior::about(0.5 * TANGENT[0]),
        CoefficientPrior::about(0.5 * TANGENT[1]),
        CoefficientPrior::about(0.5 * TANGENT[2]),
        CoefficientPrior::about(0.5 * TANGENT[3]),
    ];

    const STRAIGHT: [f64; 4] = TANGENT;

    fn from_coefficients(k: [f64; 4]) -> Self {
        let [k1, k2, k3, k4] = k;
        let fold = polynomial::first_root(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], PI * PI);
        Self { k, angle_limit: fold.map_or(PI, f64::sqrt) }
    }

    fn coefficients(&self) -> [f64; 4] {
        self.k
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        let (radius, angle) = self.angle_of(point_in_camera)?;
        if radius == 0.0 {
            return Some(Vector2::zeros());
        }
        Some(point_in_camera.coords.xy() * (self.distorted_angle(angle) / radius))
    }

    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<4>, bool) {
        let inside = self.angle_of(point_in_camera);
        let (radius, angle) = inside.unwrap_or((0.0, 0.0));
        let axis = Point3::new(0.0, 0.0, 1.0);
        let Point3 { coords } = if inside.is_some() { point_in_camera } else { &axis };
        let (x, y, z) = (coords.x, coords.y, coords.z);
        if radius == 0.0 {
            let by_point = Matrix2x3::new(1.0 / z, 0.0, 0.0, 0.0, 1.0 / z, 0.0);
            return (
                Distorted {
                    normalized: Vector2::zeros(),
                    by_point,
                    by_coefficients: SMatrix::zeros(),
                },
                inside.is_some(),
            );
        }
        let distorted = self.distorted_angle(angle);
        let direction = Vector2::new(x, y) / radius;
        let distance2 = radius * radius + z * z;
        // dθ/d(x, y) = z/(distance²) · direction, dθ/dz = −radius/distance²; the direction changes
        // by 1/radius.
        let radial = self.slope(angle) / distance2;
        let across = distorted / radius;
        let (c, s) = (direction.x, direction.y);
        let by_point = Matrix2x3::new(
            radial * z * c * c + across * s * s,
            (radial * z - across) * c * s,
            -radial * radius * c,
            (radial * z - across) * c * s,
            radial * z * s * s + across * c * c,
            -radial * radius * s,
        );
        let a2 = angle * angle;
        let a3 = angle * a2;
        let by_coefficients = SMatrix::<f64, 2, 4>::from_columns(&[
            direction * a3,
            direction * (a3 * a2),
            direction * (a3 * a2 * a2),
            direction * (a3 * a2 * a2 * a2),
        ]);
        (Distorted { normalized: direction * distorted, by_point, by_coefficients }, true)
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        let radius = distorted.norm();
        let highest = self.distorted_angle(self.angle_limit);
        if !(radius < highest) {
            return None;
        }
        if radius == 0.0 {
            return Some(Vector3::z_axis());
        }
        // The distorted angle is increasing on the whole interval: bisection first, then Newton's
        // method.
        let (mut low, mut high) = (0.0, self.angle_limit);
        for _ in 0..20 {
            let middle = 0.5 * (low + high);
            if self.distorted_angle(middle) < radius { low = middle } else { high = middle }
        }
        let mut angle = 0.5 * (low + high);
        for _ in 0..20 {
            let step = (self.distorted_angle(angle) - radius) / self.slope(angle);
            angle = (angle - step).clamp(low, high);
            if step.abs() < 1e-16 {
                break;
            }
        }
        let (sin, cos) = angle.sin_cos();
        Some(Unit::new_normalize(Vector3::new(
            distorted.x / radius * sin,
            distorted.y / radius * sin,
            cos,
        )))
    }
}
