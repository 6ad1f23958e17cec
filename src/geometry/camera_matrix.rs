//! The camera matrix K: from normalized coordinates to pixels.

use nalgebra::{Matrix3, Vector2};

use crate::geometry::pixel::Pixel;

/// The five parameters of K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], all in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraMatrix {
    /// Focal length in pixels along x.
    pub fx: f64,
    /// Focal length in pixels along y.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
    /// The change of x with normalized y: 0 for every ordinary sensor.
    pub skew: f64,
}

/// The least skew that counts, in pixels. Less is the rounding of a linear solve. Within 45° of the
/// axis it moves no pixel by more than itself, less than a thousandth of the uncertainty of the
/// best corners.
const LEAST_SKEW_PX: f64 = 1e-6;

impl CameraMatrix {
    /// Whether there is skew beyond rounding.
    pub fn has_skew(self) -> bool {
        self.skew.abs() >= LEAST_SKEW_PX
    }

    /// K as a matrix acting on homogeneous normalized coordinates.
    pub fn to_matrix(self) -> Matrix3<f64> {
        Matrix3::new(self.fx, self.skew, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// From an upper triangular matrix, scaled so that its last entry is 1. `None` if that entry is
    /// 0, a focal length is not positive, or anything is not finite.
    pub fn from_matrix(k: &Matrix3<f64>) -> Option<Self> {
        let k = k / k[(2, 2)];
        let matrix =
            Self { fx: k[(0, 0)], fy: k[(1, 1)], cx: k[(0, 2)], cy: k[(1, 2)], skew: k[(0, 1)] };
        let usable = k.iter().all(|v| v.is_finite()) && matrix.fx > 0.0 && matrix.fy > 0.0;
        usable.then_some(matrix)
    }

    /// The pixel at normalized coordinates.
    pub fn pixel_from_normalized(self, normalized: Vector2<f64>) -> Pixel {
        Pixel::new(
            self.fx * normalized.x + self.skew * normalized.y + self.cx,
            self.fy * normalized.y + self.cy,
        )
    }

    /// Normalized coordinates of a pixel.
    pub fn normalized_from_pixel(self, pixel: Pixel) -> Vector2<f64> {
        let y = (pixel.y - self.cy) / self.fy;
        Vector2::new((pixel.x - self.cx - self.skew * y) / self.fx, y)
    }
}
