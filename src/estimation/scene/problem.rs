//! The problem: scene points observed in images.

use crate::estimation::interrupt::Interrupt;
use crate::geometry::pixel::{ImageSize, Pixel};

/// The observation of a scene point in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackPoint {
    /// The image, by index.
    pub image: usize,
    /// Where the point was observed.
    pub pixel: Pixel,
    /// The scale of the feature there: the standard deviation of a Gaussian, in pixels.
    pub scale_px: f64,
    /// The expected standard deviation of each coordinate in pixels, up to a factor common to all.
    pub std_px: f64,
}

/// The observations of one scene point: at most one per image, in the order of the images.
pub type Track = Vec<TrackPoint>;

/// Images of a static scene by one camera with a fixed lens.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneProblem {
    /// The size of all images.
    pub image_size: ImageSize,
    /// Number of images.
    pub images: usize,
    /// The scene points.
    pub tracks: Vec<Track>,
    /// Ends computations early.
    pub interrupt: Interrupt,
}
