//! Positions in an image ([`Pixel`]) and directions in space ([`Bearing`]): two types, because a
//! pixel used as a direction is the most common silent error of camera code.

use nalgebra::{Point2, Unit, Vector2, Vector3};

/// A position in an image, in pixels: x right, y down, integer coordinates at pixel *centers*.
///
/// The top-left pixel's center is (0, 0), so an image of width w spans −0.5 … w − 0.5 (OpenCV's
/// convention).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pixel {
    /// Right, in pixels.
    pub x: f64,
    /// Down, in pixels.
    pub y: f64,
}

impl Pixel {
    /// The pixel at (`x`, `y`).
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// The vector from the image's origin to this pixel.
    pub fn to_vector(self) -> Vector2<f64> {
        Vector2::new(self.x, self.y)
    }

    /// The distance to `other`, in pixels.
    pub fn distance_px(self, other: Self) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }

    /// Whether both coordinates are finite.
    pub fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite()
    }
}

impl From<Vector2<f64>> for Pixel {
    fn from(v: Vector2<f64>) -> Self {
        Self::new(v.x, v.y)
    }
}

impl From<Point2<f64>> for Pixel {
    fn from(p: Point2<f64>) -> Self {
        Self::new(p.x, p.y)
    }
}

/// A unit direction in a camera's optical frame (x right, y down, z forward).
pub type Bearing = Unit<Vector3<f64>>;

/// Width and height of an image, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ImageSize {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl ImageSize {
    /// A size of `width` × `height` pixels.
    pub const fn new(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// Whether `pixel` lies inside the image: −0.5 ≤ x < width − 0.5, and so for y.
    pub fn contains(self, pixel: Pixel) -> bool {
        pixel.x >= -0.5
            && pixel.y >= -0.5
            && pixel.x < f64::from(self.width) - 0.5
            && pixel.y < f64::from(self.height) - 0.5
    }

    /// The middle of the image, ((w − 1)/2, (h − 1)/2).
    pub fn center(self) -> Pixel {
        Pixel::new((f64::from(self.width) - 1.0) / 2.0, (f64::from(self.height) - 1.0) / 2.0)
    }

    /// The length of the image's diagonal, in pixels.
    pub fn diagonal_px(self) -> f64 {
        f64::from(self.width).hypot(f64::from(self.height))
    }
}

impl std::fmt::Display for ImageSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}
