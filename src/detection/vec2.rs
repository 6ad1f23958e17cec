//! A position or a vector in an image.

use nalgebra::Vector2;

/// A position or a vector in an image, in pixels.
pub(in crate::detection) type Vec2 = Vector2<f32>;
