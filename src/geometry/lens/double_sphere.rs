//! The double sphere model, for wide lenses and fisheyes: Kalibr's `ds`.

use nalgebra::{Matrix2x3, Point3, SMatrix, Unit, Vector2, Vector3};

use crate::geometry::lens::model::{
    CoefficientPrior, Distorted, DistortionModel, KalibrModel, ModelFacts,
};
use crate::geometry::pixel::Bearing;

/// With d₁ = √(X² + Y² + Z²), Z₁ = ξ d₁ + Z and d₂ = √(X² + Y² + Z₁²): (x_d, y_d) = (X, Y)/(α d₂ +
/// (1 − α) Z₁).
///
/// V. Usenko, N. Demmel and D. Cremers, *The double sphere camera model*, 3DV 2018, eq. 40 to 52,
/// with −1 < ξ < 1 and 0 ≤ α ≤ 1; with other values the valid region is empty. Projects points
/// beside and behind the camera too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleSphere {
    xi: f64,
    alpha: f64,
    /// The valid region: points with Z > −this·d₁.
    behind: f64,
}

/// A point relative to both spheres.
struct OnSpheres {
    /// d₁, d₂.
    distances: [f64; 2],
    /// Z₁.
    second_z: f64,
    denominator: f64,
}

impl DoubleSphere {
    fn on_spheres(&self, point: &Point3<f64>) -> Option<OnSpheres> {
        let across2 = point.x * point.x + point.y * point.y;
        let first = (across2 + point.z * point.z).sqrt();
        if !(first.is_finite() && first > 0.0 && point.z > -self.behind * first) {
            return None;
        }
        let second_z = self.xi * first + point.z;
        let second = (across2 + second_z * second_z).sqrt();
        let denominator = self.alpha * second + (1.0 - self.alpha) * second_z;
        (denominator > 0.0).then_some(OnSpheres {
            distances: [first, second],
            second_z,
            denominator,
        })
    }
}

impl DistortionModel<2> for DoubleSphere {
    const FACTS: ModelFacts = ModelFacts {
        name: "double_sphere",
        summary: "the double sphere model, for fisheyes: Kalibr's ds",
        auto_order: None,
        focal_coefficient: Some("xi"),
        camera_info: None,
        opencv: None,
        kalibr: Some(KalibrModel { camera: "ds", distortion: "none", coefficients: 0 }),
        mrcal: None,
        colmap: None,
    };

    const NAMES: [&'static str; 2] = ["xi", "alpha"];

    const PRIORS: [CoefficientPrior; 2] =
        [CoefficientPrior::about(0.0), CoefficientPrior::about(0.5)];

    const START: [f64; 2] = [0.0, 0.5];

    fn from_coefficients([xi, alpha]: [f64; 2]) -> Self {
        let first = if (0.0..=0.5).contains(&alpha) {
            alpha / (1.0 - alpha)
        } else {
            (1.0 - alpha) / alpha
        };
        let usable = (0.0..=1.0).contains(&alpha) && xi > -1.0 && xi < 1.0;
        let behind = (first + xi) / (2.0 * first * xi + xi * xi + 1.0).sqrt();
        Self { xi, alpha, behind: if usable { behind } else { f64::NEG_INFINITY } }
    }

    fn coefficients(&self) -> [f64; 2] {
        [self.xi, self.alpha]
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        let OnSpheres { denominator, .. } = self.on_spheres(point_in_camera)?;
        Some(point_in_camera.coords.xy() / denominator)
    }

    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<2>, bool) {
        let seen = self.on_spheres(point_in_camera);
        let inside = seen.is_some();
        let axis = Point3::new(0.0, 0.0, 1.0);
        let Point3 { coords } = if inside { point_in_camera } else { &axis };
        let (across, z) = (coords.xy(), coords.z);
        let OnSpheres { distances: [first, second], second_z, denominator } =
            seen.unwrap_or(OnSpheres { distances: [1.0, 1.0], second_z: 1.0, denominator: 1.0 });
        let Self { xi, alpha, .. } = *self;
        // Derivatives of the denominator: by Z₁, including that of d₂, and by (X, Y) at fixed Z₁.
        let by_second_z = alpha * second_z / second + 1.0 - alpha;
        let by_xy = across * (by_second_z * xi / first + alpha / second);
        let by_z = by_second_z * (xi * z / first + 1.0);
        let normalized = across / denominator;
        let by_denominator = -normalized / denominator;
        let mut by_point = Matrix2x3::zeros();
        by_point.fixed_columns_mut::<2>(0).copy_from(&(by_denominator * by_xy.transpose()));
        by_point[(0, 0)] += 1.0 / denominator;
        by_point[(1, 1)] += 1.0 / denominator;
        by_point.set_column(2, &(by_denominator * by_z));
        let by_coefficients = SMatrix::<f64, 2, 2>::from_columns(&[
            by_denominator * (by_second_z * first),
            by_denominator * (second - second_z),
        ]);
        (Distorted { normalized, by_point, by_coefficients }, inside)
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        let Self { xi, alpha, behind } = *self;
        let radius2 = distorted.norm_squared();
        let under_root = 1.0 - (2.0 * alpha - 1.0) * radius2;
        if !(under_root >= 0.0 && behind.is_finite() && radius2.is_finite()) {
            return None;
        }
        let z = (1.0 - alpha * alpha * radius2) / (alpha * under_root.sqrt() + 1.0 - alpha);
        let far = (z * xi + (z * z + (1.0 - xi * xi) * radius2).sqrt()) / (z * z + radius2);
        let direction = Vector3::new(far * distorted.x, far * distorted.y, far * z - xi);
        // Already of unit length, except for rounding.
        (direction.z > -behind).then(|| Unit::new_normalize(direction))
    }
}
