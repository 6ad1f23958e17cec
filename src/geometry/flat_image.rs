//! Flat images: which directions an image without distortion can show.

use nalgebra::{Vector2, Vector3};

/// The largest normalized radius in a flat image: 78° off the axis. Directions further off count as
/// if they were at this radius.
pub const WIDEST: f64 = 4.7;

/// Normalized coordinates of a direction. For a direction that no flat image shows (too far off the
/// axis, sideways or behind), those at the largest radius on its side.
pub fn flat_from_ray(ray: &Vector3<f64>) -> Vector2<f64> {
    let flat = Vector2::new(ray.x, ray.y) / ray.z.max(1e-3);
    if flat.norm() > WIDEST { flat * (WIDEST / flat.norm()) } else { flat }
}
