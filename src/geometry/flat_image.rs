//! Flat images: what a lens without distortion can show of a direction.

use nalgebra::{Vector2, Vector3};

/// The widest that a flat image can show of a lens: 78° off the axis. Beyond, everything is edge.
pub const WIDEST: f64 = 4.7;

/// Normalized coordinates of a direction; of one that no flat image shows (too far off the axis,
/// sideways or behind), those at the widest on its side.
pub fn flat_from_ray(ray: &Vector3<f64>) -> Vector2<f64> {
    let flat = Vector2::new(ray.x, ray.y) / ray.z.max(1e-3);
    if flat.norm() > WIDEST { flat * (WIDEST / flat.norm()) } else { flat }
}
