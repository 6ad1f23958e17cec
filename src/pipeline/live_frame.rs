//! A camera's newest frame set, with the detections in it.

use std::sync::Arc;

use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::session::FrameContent;
use crate::detection::board_detection::{Detection, NoBoard};
use crate::imaging::frame::FrameSet;
use crate::imaging::no_image::NoImage;

/// A frame set with the detections in it: preview, overlay and image are of the same frame.
#[derive(Debug, Clone)]
pub struct LiveFrame {
    /// The frame set as the camera delivered it.
    pub frame_set: Arc<FrameSet>,
    /// The detection in its color frame; `None` while no session states which board to search for.
    pub detection: Option<FrameDetection>,
}

/// The detection in a frame, and the time that it took.
#[derive(Debug, Clone)]
pub struct FrameDetection {
    /// The board, or the features of a scene; or the reason why there is none.
    pub outcome: Result<FrameContent, NoDetection>,
    /// The time that decoding and detection took, in milliseconds.
    pub elapsed_ms: f64,
    /// The board was found near its position in the previous frame: its corners are accurate enough
    /// to decide whether the frame is kept, but are not kept themselves.
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
    /// The image was searched, and no board was found.
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
