//! The newest frame set of a camera, with what was seen in it.

use std::sync::Arc;

use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::session::FrameContent;
use crate::detection::board_detection::{Detection, NoBoard};
use crate::imaging::frame::FrameSet;
use crate::imaging::no_image::NoImage;

/// A frame set with what was seen in it: preview, overlay and image come from one and the same
/// frame.
#[derive(Debug, Clone)]
pub struct LiveFrame {
    /// What the camera gave.
    pub frame_set: Arc<FrameSet>,
    /// What was seen in its color frame; `None` while no session says which board to search for.
    pub detection: Option<FrameDetection>,
}

/// What was seen in a frame, and how long it took to see it.
#[derive(Debug, Clone)]
pub struct FrameDetection {
    /// The board, or features of a scene; or why there is nothing.
    pub outcome: Result<FrameContent, NoDetection>,
    /// The time that decoding and detection took, in milliseconds.
    pub elapsed_ms: f64,
    /// The board was found near where it was in the frame before: its corners are exact enough to
    /// decide on, not to keep.
    pub tracked: bool,
}

impl FrameDetection {
    /// The features of a scene, where they were searched for.
    pub fn scene(&self) -> Option<&SceneImage> {
        self.outcome.as_ref().ok().and_then(FrameContent::scene)
    }

    /// The board, if it was found.
    pub fn board(&self) -> Option<&Detection> {
        self.outcome.as_ref().ok().and_then(FrameContent::board)
    }
}

/// Why a frame shows no board.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoDetection {
    /// It was searched in vain.
    #[error(transparent)]
    NoBoard(#[from] NoBoard),
    /// The frame set has no image.
    #[error(transparent)]
    NoImage(#[from] NoImage),
    /// It could not be decoded.
    #[error("the image cannot be read: {detail}")]
    Unreadable {
        /// What the decoder said.
        detail: String,
    },
}
