//! How a session comes to its end. Whether what was gathered can be solved is an argument: `Ok`, or
//! why not.
//!
//! ```text
//! collecting ──stop, goal reached, time up──▶ solving ──▶ finished
//!     │                                          └──────▶ failed (its views stay)
//!     ├──stop with too few views──▶ failed
//!     └──abort──▶ aborted          (also from solving)
//! ```

use crate::calibration::guidance::Guidance;
use crate::calibration::session::action::Action;
use crate::calibration::session_record::{Finish, SessionRecord, SessionState};

/// Fewer views leave the lens undetermined (Zhang, "A flexible new technique for camera
/// calibration", 2000, section 3.3); fewer images of a scene do too.
pub const LEAST_VIEWS: usize = 3;

/// A request that comes too late.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the session is {} already", state.name())]
pub struct SessionOver {
    /// How it ended.
    pub state: SessionState,
}

impl SessionRecord {
    /// By request: solves, or fails where `enough` says why it cannot. Nothing new for one that
    /// solves already.
    pub(super) fn stop(
        &mut self,
        enough: Result<(), String>,
        now_ns: i64,
    ) -> Result<Vec<Action>, SessionOver> {
        match self.state {
            SessionState::Collecting => Ok(self.solve_or_fail(enough, now_ns)),
            SessionState::Solving => Ok(Vec::new()),
            state => Err(SessionOver { state }),
        }
    }

    /// By request: gives it up.
    pub(super) fn abort(&mut self, now_ns: i64) -> Result<Vec<Action>, SessionOver> {
        match self.state {
            SessionState::Collecting | SessionState::Solving => {
                Ok(self.close(SessionState::Aborted, None, now_ns))
            }
            state => Err(SessionOver { state }),
        }
    }

    /// Ends by itself where `finish` is reached; the time is that of its frames.
    pub(super) fn solve_or_fail_by_itself(&mut self, enough: Result<(), String>) -> Vec<Action> {
        let now_ns = self.started_at_ns.saturating_add((self.collecting_s * 1e9) as i64);
        self.solve_or_fail(enough, now_ns)
    }

    /// Whether it has collected as long as it may.
    pub(super) fn is_time_up(&self) -> bool {
        let limit_s = self.request.finish.and_then(|finish| finish.max_seconds);
        limit_s.is_some_and(|limit_s| self.collecting_s >= limit_s)
    }

    /// No frame will ever come again: a session that was to end by itself ends now, another one
    /// waits to be stopped.
    pub(super) fn source_ended(
        &mut self,
        reason: &str,
        enough: Result<(), String>,
        now_ns: i64,
    ) -> Vec<Action> {
        if self.state != SessionState::Collecting {
            return Vec::new();
        }
        if self.request.finish.is_some_and(|finish| finish != Finish::default()) {
            return self.solve_or_fail(enough, now_ns);
        }
        self.reason = Some(format!("{reason}; stop the session to solve what it gathered"));
        vec![Action::Announce]
    }

    /// Takes the outcome of the solve: the id of the calibration, or why there is none.
    pub(super) fn solved(&mut self, outcome: Result<String, String>, now_ns: i64) -> Vec<Action> {
        if self.state != SessionState::Solving {
            return Vec::new();
        }
        match outcome {
            Ok(calibration) => {
                self.calibration = Some(calibration);
                self.close(SessionState::Finished, None, now_ns)
            }
            Err(reason) => self.close(SessionState::Failed, Some(reason), now_ns),
        }
    }

    fn solve_or_fail(&mut self, enough: Result<(), String>, now_ns: i64) -> Vec<Action> {
        if let Err(reason) = enough {
            return self.close(SessionState::Failed, Some(reason), now_ns);
        }
        self.state = SessionState::Solving;
        self.reason = None;
        self.guidance = Guidance::default();
        vec![Action::Announce, Action::Solve]
    }

    fn close(&mut self, state: SessionState, reason: Option<String>, now_ns: i64) -> Vec<Action> {
        self.state = state;
        self.reason = reason;
        self.guidance = Guidance::default();
        self.finished_at_ns = Some(now_ns.max(self.started_at_ns));
        vec![Action::Close]
    }
}
