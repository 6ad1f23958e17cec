//! Messages to the thread that owns a session.

use tokio::sync::oneshot;

use crate::calibration::result::Calibration;
use crate::calibration::session::CameraFrame;
use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::seen::SeenFrame;
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::solve_job::{Estimate, SolveFailure};

/// What the cameras of an instrument gave at about the same time, in the instrument's order.
#[derive(Debug)]
pub(super) struct SeenFrameSet {
    pub(super) frames: Vec<Option<SeenFrame>>,
    /// The same as the session observes it.
    pub(super) observed: Vec<Option<CameraFrame>>,
}

/// The channel for the answer to a start.
pub(super) type StartReply = oneshot::Sender<Result<SessionRecord, StartError>>;
/// The channel for the answer to a stop or an abort.
pub(super) type EndReply = oneshot::Sender<Result<SessionRecord, EndError>>;

/// A message to the thread that owns the session.
#[derive(Debug)]
pub(super) enum Message {
    /// A frame set was searched for the session of this id.
    Seen(Box<SeenFrameSet>, String),
    /// There are no more frames for this session.
    Ended { session: String, reason: String },
    /// The camera at this place delivers no frames.
    CameraLost { place: usize, reason: String },
    /// All cameras deliver frames again.
    CamerasBack,
    /// A setting that the last session fixed has changed on the device: which one, in words.
    Moved(String),
    /// This many seconds passed without a frame.
    Waited(f64),
    /// A running estimate of a camera's lens, if it could be made.
    Estimated { session: String, place: usize, estimate: Estimate },
    /// A session's solve.
    Solved { session: String, solved: Result<Box<Calibration>, SolveFailure> },
    /// Start a session.
    Start(SessionRequest, StartReply),
    /// Solve what has been collected; answered once solving has begun.
    Stop(String, EndReply),
    /// Abort the session.
    Abort(String, EndReply),
    /// The session was deleted and must no longer be shown. Answered once it is not.
    Forget(String, oneshot::Sender<()>),
    /// Check whether to stop.
    Wake,
}
