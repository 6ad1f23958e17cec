//! What a device is asked for.

use crate::geometry::pixel::ImageSize;

/// Size, format and rate; what is `None` stays as the device has it, or is chosen so that the rest
/// can be had.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModeRequest {
    /// The size of its images.
    pub size: Option<ImageSize>,
    /// Its pixel format as a four-character code, as in `MJPG`.
    pub format: Option<String>,
    /// Frames a second.
    pub fps: Option<f64>,
}
