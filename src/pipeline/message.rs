//! What goes from thread to thread.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::oneshot;

use crate::calibration::result::Calibration;
use crate::calibration::running_estimate::EstimateSoFar;
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::imaging::frame::FrameSet;
use crate::pipeline::live_frame::Look;
use crate::pipeline::search::Search;
use crate::pipeline::session_request::{EndError, StartError};

/// From capture to detection.
#[derive(Debug)]
pub(super) enum Captured {
    /// A frame set, and what it is to be searched for.
    Frame(CapturedFrame),
    /// There are no more.
    End {
        /// The session that the frames were for.
        search: Option<Arc<Search>>,
        /// In words.
        reason: String,
    },
}

/// A frame set on its way.
#[derive(Debug)]
pub(super) struct CapturedFrame {
    pub(super) frame_set: Arc<FrameSet>,
    pub(super) search: Option<Arc<Search>>,
    /// When it came from its source.
    pub(super) arrived: Instant,
    /// Its source waits for it to be looked at.
    pub(super) waits: bool,
}

/// To the session thread.
#[derive(Debug)]
pub(super) enum Message {
    /// A frame was searched.
    Looked { captured: CapturedFrame, search: Arc<Search>, look: Look },
    /// There are no more frames for this session.
    Ended { search: Option<Arc<Search>>, reason: String },
    /// The camera gives no frames.
    CameraLost(String),
    /// It gives frames again.
    CameraBack,
    /// The device is no longer as the last session held it: what has changed, in words.
    Moved(String),
    /// So many seconds went by without a frame.
    Waited(f64),
    /// A running estimate of a session, if it could be made.
    Estimated { session: String, estimate: Option<Box<EstimateSoFar>> },
    /// A session's solve.
    Solved { session: String, solved: Result<Box<Calibration>, String> },
    /// Begin a session.
    Start(SessionRequest, oneshot::Sender<Result<SessionRecord, StartError>>),
    /// Solve what has been gathered; answered once solving has begun.
    Stop(String, oneshot::Sender<Result<SessionRecord, EndError>>),
    /// Give it up.
    Abort(String, oneshot::Sender<Result<SessionRecord, EndError>>),
    /// Search for a rig's session, and begin none of the camera's own until it is given back.
    Lend(Search, oneshot::Sender<Result<(), StartError>>),
    /// The rig's session with this id needs the camera no more.
    GiveBack(String),
    /// Look whether to stop.
    Wake,
}
