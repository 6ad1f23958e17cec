//! The lens without distortion.

use nalgebra::{Matrix2x3, Point3, SMatrix, Unit, Vector2, Vector3};

use crate::geometry::lens::{Distorted, DistortionModel};
use crate::geometry::pixel::Bearing;

/// (x_d, y_d) = (x/z, y/z). Valid for z > 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole;

impl DistortionModel<0> for Pinhole {
    const NAMES: [&'static str; 0] = [];

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

    fn distort_with_jacobians(&self, point_in_camera: &Point3<f64>) -> Option<Distorted<0>> {
        let normalized = self.distort(point_in_camera)?;
        let inverse_z = 1.0 / point_in_camera.z;
        let by_point =
            Matrix2x3::new(inverse_z, 0.0, -normalized.x * inverse_z, 0.0, inverse_z, -normalized.y * inverse_z);
        Some(Distorted { normalized, by_point, by_coefficients: SMatrix::zeros() })
    }

    fn undistort(&self, distorted: Vector2<f64>) -> Option<Bearing> {
        distorted
            .iter()
            .all(|v| v.is_finite())
            .then(|| Unit::new_normalize(Vector3::new(distorted.x, distorted.y, 1.0)))
    }
}
