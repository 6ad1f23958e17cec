//! Why a source gave no frame.

use std::time::Duration;

/// What [`FrameSource::next_frame`](crate::capture::FrameSource::next_frame) answers instead of
/// frames.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CaptureError {
    /// No frame came within the time given; the source may still be well.
    #[error("no frame within {} ms", waited.as_millis())]
    TimedOut {
        /// How long was waited.
        waited: Duration,
    },
    /// After the last frame of a recording.
    #[error("the recording has ended")]
    Ended,
    /// The device went away or stopped answering; opening it again may help.
    #[error("{device} was lost: {reason}")]
    Lost {
        /// The source's identity.
        device: String,
        /// What happened, in words.
        reason: String,
    },
    /// The source cannot go on, and opening it again will not help.
    #[error("{reason}")]
    Failed {
        /// What is wrong and what to do, in one line.
        reason: String,
    },
}
