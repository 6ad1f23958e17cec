//! The newest frame set of a camera, with what was seen in it.

use std::sync::Arc;

use crate::detection::board_detection::{Detection, NoBoard};
use crate::detection::tracking::Sighting;
use crate::imaging::frame::FrameSet;

/// A frame set with what was seen in it: preview, overlay and picture come from one and the same
/// frame.
#[derive(Debug, Clone)]
pub struct LiveFrame {
    /// What the camera gave.
    pub frame_set: Arc<FrameSet>,
    /// What was seen in its color frame; `None` while no session says which board to look for.
    pub look: Option<Look>,
}

/// What was seen in a frame, and how long it took to see it.
#[derive(Debug, Clone)]
pub struct Look {
    /// The board, or why there is none.
    pub outcome: Result<Arc<Detection>, LookError>,
    /// The time that decoding and detection took, in milliseconds.
    pub elapsed_ms: f64,
    /// The board was found near where it was in the frame before: its corners are exact enough to
    /// decide on, not to keep.
    pub followed: bool,
}

impl Look {
    pub(super) fn of(sighting: Result<Sighting, LookError>, elapsed_ms: f64) -> Self {
        let followed = sighting.as_ref().is_ok_and(|sighting| sighting.followed);
        Self {
            outcome: sighting.map(|sighting| Arc::new(sighting.detection)),
            elapsed_ms,
            followed,
        }
    }
}

/// Why a frame shows no board.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LookError {
    /// It was searched in vain.
    #[error(transparent)]
    NoBoard(#[from] NoBoard),
    /// It could not be decoded, or the frame set has no picture.
    #[error("the picture cannot be read: {detail}")]
    Unreadable {
        /// What the decoder said.
        detail: String,
    },
}
