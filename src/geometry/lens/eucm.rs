//! The enhanced unified camera model, for wide lenses and fisheyes: Kalibr's `eucm`.

use nalgebra::{Matrix2x3, Point3, SMatrix, Unit, Vector2, Vector3};

use crate::geometry::lens::model::{
    CoefficientPrior, Distorted, DistortionModel, KalibrModel, ModelFacts,
};
use crate::geometry::pixel::Bearing;

/// With d = √(β (X² + Y²) + Z²): (x_d, y_d) = (X, Y)/(α d + (1 − α) Z).
///
/// B. Khomutenko, G. Garcia and P. Martinet, *An enhanced unified camera model*, RA-L 2016, with 0
/// ≤ α ≤ 1 and β > 0; with other values the valid region is empty. The valid region is that of V.
/// Usenko, N. Demmel and D. Cremers, *The double sphere camera model*, 3DV 2018, eq. 30. Projects
/// points beside and behind the camera too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eucm {
    alpha: f64,
    beta: f64,
    /// The valid region: points with Z > −this·d.
    behind: f64,
}

impl Eucm {
    /// The point's distance d and the denominator, for a point in the valid region.
    fn denominator(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        let distance =
            (self.beta * (point.x * point.x + point.y * point.y) + point.z * point.z).sqrt();
        let seen = distance.is_finite() && distance > 0.0 && point.z > -self.behind * distance;
        let denominator = self.alpha * distance + (1.0 - self.alpha) * point.z;
        (seen && denominator > 0.0).then_some((distance, denominator))
    }
}

impl DistortionModel<2> for Eucm {
    const FACTS: ModelFacts = ModelFacts {
        name: "eucm",
        summary: "the enhanced unified model, for fisheyes: Kalibr's eucm",
        auto_order: None,
        focal_coefficient: None,
        camera_info: None,
        opencv: None,
        kalibr: Some(KalibrModel { camera: "eucm", distortion: "none", coefficients: 0 }),
        mrcal: None,
        colmap: None,
    };

    const NAMES: [&'static str; 2] = ["alpha", "beta"];

    const PRIORS: [CoefficientPrior; 2] =
        [CoefficientPrior::about(0.5), CoefficientPrior::about(1.0)];

    const STRAIGHT: [f64; 2] = [0.0, 1.0];

    const START: [f64; 2] = [0.5, 1.0];

    fn from_coefficients([alpha, beta]: [f64; 2]) -> Self {
        let behind = if (0.0..=0.5).contains(&alpha) {
            alpha / (1.0 - alpha)
        } else {
            (1.0 - alpha) / alpha
        };
        let usable = (0.0..=1.0).contains(&alpha) && beta > 0.0 && beta.is_finite();
        Self { alpha, beta, behind: if usable { behind } else { f64::NEG_INFINITY } }
    }

    fn coefficients(&self) -> [f64; 2] {
        [self.alpha, self.beta]
    }

    fn distort(&self, point_in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        let (_, denominator) = self.denominator(point_in_camera)?;
        Some(point_in_camera.coords.xy() / denominator)
    }

    fn distort_or_axis(&self, point_in_camera: &Point3<f64>) -> (Distorted<2>, bool) {
        let inside = self.denominator(point_in_camera);
        let (distance, denominator) = inside.unwrap_or((1.0, 1.0));
        let axis = Point3::new(0.0, 0.0, 1.0);
        let Point3 { coords } = if inside.is_some() { point_in_camera } else { &axis };
        let (across, z) = (coords.xy(), coords.z);
        let normalized = across / denominator;
        let by_xy = across * (self.alpha * self.beta / distance);
        let by_z = self.alpha * z / distance + 1.0 - self.alpha;
        // Derivatives by the denominator, and by (x, y) directly.
        let by_denominator = -normalized / denominator;
        let mut by_point = Matrix2x3::zeros();
        by_point.fixed_columns_mut::<2>(0).copy_from(&(by_denominator * by_xy.transpose()));
        by_point[(0, 0)] += 1.0 / denominator;
        by_point[(1, 1)] += 1.0 / denominator;
        by_point.set_column(2, &(by_denominator * by_z));
        let by_coefficients = SMatrix::<f64, 2, 2>::from_columns(&[
            by_denominator * (distance - z),
            by_denominator * (self.alpha * across.norm_squared() / (2.0 * distance)),
        ]);
        (Distorted { normalized, by_point, by_coefficients }, inside.is_some())
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        let Self { alpha, beta, behind } = *self;
        let radius2 = distorted.norm_squared();
        let under_root = 1.0 - (2.0 * alpha - 1.0) * beta * radius2;
        if !(under_root >= 0.0 && behind >= 0.0 && radius2.is_finite()) {
            return None;
        }
        let z = (1.0 - beta * alpha * alpha * radius2) / (alpha * under_root.sqrt() + 1.0 - alpha);
        let seen = z > -behind * (beta * radius2 + z * z).sqrt();
        seen.then(|| Unit::new_normalize(Vector3::new(distorted.x, distorted.y, z)))
    }
}
