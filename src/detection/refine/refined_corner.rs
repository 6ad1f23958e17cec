//! A corner as the refinement reports it.

use crate::geometry::pixel::Pixel;

/// A refined corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedCorner {
    /// Its position.
    pub pixel: Pixel,
    /// Predicted standard deviation of `pixel`, per axis, in pixels.
    pub std_px: f64,
    /// Width of the blur across the edges, as a Gaussian's standard deviation in pixels, the
    /// pixel's own width not counted.
    pub blur_px: f64,
    /// White less black, in gray levels.
    pub contrast: f64,
}
