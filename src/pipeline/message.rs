//! Messages to the thread that owns a session.

use tokio::sync::oneshot;

use crate::calibration::result::Calibration;
use crate::calibration::session::CameraFrame;
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::seen::SeenFrame;
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::solve_job::Estimate;

/// What the cameras of an instrument gave at about the same time, in the instrument's order.
#[derive(Debug)]
pub(super) struct SeenFrameSet {
    pub(super) frames: Vec<Option<SeenFrame>>,
    /// The same as the session observes it.
    pub(super) observed: Vec<Option<CameraFrame>>,
}

/// Where the answer to a start goes.
pub(super) type StartReply = oneshot::Sender<Result<SessionRecord, StartError>>;
/// Where the answer to a stop or an abort goes.
pub(super) type EndReply = oneshot::Sender<Result<SessionRecord, EndError>>;

/// To the thread that owns the session.
#[derive(Debug)]
pub(super) enum Message {
    /// A frame set was searched for the session of this id.
    Seen(Box<SeenFrameSet>, String),
    /// There are no more frames for this session.
    Ended { session: String, reason: String },
    /// The camera at this place gives no frames.
    CameraLost { place: usize, reason: String },
    /// All cameras give frames again.
    CamerasBack,
    /// The device is no longer as the last session held it: what has changed, in words.
    Moved(String),
    /// So many seconds went by without a frame.
    Waited(f64),
    /// A running estimate of a camera's lens, if it could be made.
    Estimated { session: String, place: usize, estimate: Estimate },
    /// A session's solve.
    Solved { session: String, solved: Result<Box<Calibration>, String> },
    /// Begin a session.
    Start(SessionRequest, StartReply),
    /// Solve what has been gathered; answered once solving has begun.
    Stop(String, EndReply),
    /// Give it up.
    Abort(String, EndReply),
    /// It was deleted: nobody is to see it any more. Answered once that holds.
    Forget(String, oneshot::Sender<()>),
    /// Check whether to stop.
    Wake,
}
