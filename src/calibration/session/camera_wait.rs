//! The camera that a session waits for.

use std::fmt;

/// A camera that delivers no frames while its session collects.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct CameraWait {
    /// Its name; `None` for an instrument that is one camera.
    pub(super) camera: Option<String>,
    /// Why it delivers none, in words.
    pub(super) reason: String,
}

impl fmt::Display for CameraWait {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.camera {
            Some(camera) => write!(f, "waiting for camera `{camera}`: {}", self.reason),
            None => write!(f, "waiting for the camera: {}", self.reason),
        }
    }
}
