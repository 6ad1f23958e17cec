//! A corner as the refinement reports it.

use crate::geometry::pixel::Pixel;

/// A refined corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedCorner {
    /// Its position.
    pub pixel: Pixel,
    /// Predicted standard deviation of `pixel`, per axis, in pixels.
    pub std_px: f64,
    /// Width of the blur across the edges, as a Gaussian's standard deviation in pixels, without
    /// the pixel's own width.
    pub blur_px: f64,
    /// White minus black, in gray levels.
    pub contrast: f64,
}
