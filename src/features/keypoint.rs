//! A keypoint: a position in an image with a scale and a direction.

use crate::geometry::pixel::Pixel;

/// A scale-space extremum, in the pixels of the image it was found in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Its position, to a fraction of a pixel.
    pub pixel: Pixel,
    /// The standard deviation of the Gaussian at which it is an extremum, in pixels.
    pub scale_px: f64,
    /// The direction of its dominant gradient, in radians, from x toward y.
    pub angle: f64,
    /// The absolute difference of Gaussians there, for luma from 0 to 1.
    pub contrast: f64,
}

/// The least standard deviation of a keypoint's position in one coordinate, in pixels: the error of
/// the quadratic fit on noise-free images.
const LEAST_STD_PX: f64 = 0.1;

/// The standard deviation of a position relative to its scale: B. Zeisl et al., *Estimation of
/// location uncertainty for scale invariant feature points*, 2009, find the error proportional to
/// the scale.
const STD_PER_SCALE: f64 = 0.1;

impl Keypoint {
    /// The expected standard deviation of the position in each coordinate, in pixels, up to a
    /// factor common to all keypoints of a set of images.
    pub fn std_px(&self) -> f64 {
        LEAST_STD_PX.hypot(STD_PER_SCALE * self.scale_px)
    }
}
