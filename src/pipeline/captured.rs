//! The messages from the capture thread to the detection thread.

use std::sync::Arc;
use std::time::Instant;

use crate::imaging::frame::FrameSet;
use crate::pipeline::search::CameraSearch;

/// What the capture thread passes on.
#[derive(Debug)]
pub(super) enum Captured {
    /// A frame set, and the search that it is for.
    Frame(CapturedFrame),
    /// There are no more.
    End {
        /// The search that the frames were for.
        search: Option<Arc<CameraSearch>>,
        /// Why the source ended, in words.
        reason: String,
    },
}

/// A frame set on its way to detection.
#[derive(Debug)]
pub(super) struct CapturedFrame {
    pub(super) frame_set: Arc<FrameSet>,
    pub(super) search: Option<Arc<CameraSearch>>,
    /// When it was received from its source.
    pub(super) arrived: Instant,
    /// Whether its source waits until it has been searched.
    pub(super) waits: bool,
}
