//! Scene points seen in images.

use crate::estimation::interrupt::Interrupt;
use crate::geometry::pixel::{ImageSize, Pixel};

/// A scene point in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackPoint {
    /// Which image.
    pub image: usize,
    /// Where.
    pub pixel: Pixel,
    /// The size of what is seen there: the standard deviation of a Gaussian, in pixels.
    pub scale_px: f64,
    /// Expected standard deviation of each coordinate in pixels, up to a factor that all share.
    pub std_px: f64,
}

/// One scene point: where it is seen, at most once an image, by image.
pub type Track = Vec<TrackPoint>;

/// Images of a static scene by one camera with a fixed lens.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneProblem {
    /// The size of all images.
    pub image_size: ImageSize,
    /// How many images there are.
    pub images: usize,
    /// The scene points.
    pub tracks: Vec<Track>,
    /// Ends what is computed of it early, when nobody waits for it any more.
    pub interrupt: Interrupt,
}
