//! How a session ends. Whether what was gathered can be solved is an argument: `Ok`, or why not.
//!
//! ```text
//! collecting ──stop, goal reached, time up──▶ solving ──▶ finished
//!     │                                          └──────▶ failed (its views stay)
//!     ├──stop with too few views──▶ failed
//!     ├──fault──▶ failed           (also from solving)
//!     └──abort, another source──▶ aborted  (also from solving)
//! ```

use crate::calibration::guidance::Guidance;
use crate::calibration::result::{CalibratedSensor, Calibration, ImageCalibration};
use crate::calibration::sensor::SensorId;
use crate::calibration::session::action::Action;
use crate::calibration::session::not_enough::NotEnough;
use crate::calibration::session_record::{
    Finish, RunningEstimate, SessionMember, SessionRecord, SessionState,
};
use crate::imaging::frame::SensorKind;

/// A request that comes too late.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the session is {} already", state.name())]
pub struct SessionOver {
    /// How it ended.
    pub state: SessionState,
}

impl SessionRecord {
    /// On request: solves, or fails for the reason in `enough`. No actions if it is solving
    /// already.
    pub(super) fn stop(
        &mut self,
        enough: Result<(), NotEnough>,
        now_ns: i64,
    ) -> Result<Vec<Action>, SessionOver> {
        match self.state {
            SessionState::Collecting => Ok(self.solve_or_fail(enough, now_ns)),
            SessionState::Solving => Ok(Vec::new()),
            state => Err(SessionOver { state }),
        }
    }

    /// On request: gives the session up.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn abort(&mut self, now_ns: i64) -> Result<Vec<Action>, SessionOver> {
        match self.state {
            SessionState::Collecting | SessionState::Solving => {
                Ok(self.close(SessionState::Aborted, None, now_ns))
            }
            state => Err(SessionOver { state }),
        }
    }

    /// Gives it up for `reason`; its views stay.
    pub(super) fn give_up(&mut self, reason: &str, now_ns: i64) -> Vec<Action> {
        self.close(SessionState::Aborted, Some(reason.to_owned()), now_ns)
    }

    /// A solve without a result, or a fault of the program; the views stay.
    pub(super) fn fail(&mut self, reason: &str, now_ns: i64) -> Vec<Action> {
        match self.state {
            SessionState::Collecting | SessionState::Solving => {
                self.close(SessionState::Failed, Some(reason.to_owned()), now_ns)
            }
            _ => Vec::new(),
        }
    }

    /// Ends by itself once `finish` is reached; the time of the end comes from its frames.
    pub(super) fn solve_or_fail_by_itself(&mut self, enough: Result<(), NotEnough>) -> Vec<Action> {
        let now_ns = self.started_at_ns.saturating_add((self.collecting_s * 1e9) as i64);
        self.solve_or_fail(enough, now_ns)
    }

    /// Whether it has collected as long as it may.
    pub(super) fn is_time_up(&self) -> bool {
        let limit_s = self.request.finish.and_then(|finish| finish.max_seconds);
        limit_s.is_some_and(|limit_s| self.collecting_s >= limit_s)
    }

    /// No frame will ever come again: a session with a goal ends now, another one waits to be
    /// stopped.
    pub(super) fn source_ended(
        &mut self,
        reason: &str,
        enough: Result<(), NotEnough>,
        now_ns: i64,
    ) -> Vec<Action> {
        if self.state != SessionState::Collecting {
            return Vec::new();
        }
        if self.request.finish.is_some_and(|finish| finish != Finish::default()) {
            let ended = |cause| NotEnough::SourceEnded {
                reason: reason.to_owned(),
                cause: Box::new(cause),
            };
            return self.solve_or_fail(enough.map_err(ended), now_ns);
        }
        self.reason = Some(format!("{reason}; stop the session to solve from the kept views"));
        vec![Action::Announce]
    }

    /// Takes the id of the calibration that was solved.
    pub(super) fn solved(&mut self, calibration: &str, now_ns: i64) -> Vec<Action> {
        if self.state != SessionState::Solving {
            return Vec::new();
        }
        self.calibration = Some(calibration.to_owned());
        self.close(SessionState::Finished, None, now_ns)
    }

    /// Takes the calibration made from its views; the estimates become those of the calibration.
    pub(super) fn calibrated(&mut self, calibration: &Calibration) -> Vec<Action> {
        if self.state == SessionState::Solving {
            if self.members.is_empty() {
                take_estimate(&mut self.estimate, calibration.guide());
            }
            for member in &mut self.members {
                let color = SensorId::of(&member.camera, SensorKind::Color);
                let sensor = calibration.sensor(&color).and_then(CalibratedSensor::as_image);
                take_estimate(&mut member.estimate, sensor);
            }
            if !self.members.is_empty() {
                self.estimate = SessionMember::worst_estimate(&self.members);
            }
        }
        self.solved(&calibration.id, calibration.created_at_ns)
    }

    fn solve_or_fail(&mut self, enough: Result<(), NotEnough>, now_ns: i64) -> Vec<Action> {
        if let Err(why) = enough {
            return self.close(SessionState::Failed, Some(why.to_string()), now_ns);
        }
        self.state = SessionState::Solving;
        self.reason = None;
        self.clear_guidance();
        vec![Action::Announce, Action::Solve]
    }

    /// Clears the guidance of the session and of every camera.
    pub(super) fn clear_guidance(&mut self) {
        self.guidance = Guidance::default();
        for member in &mut self.members {
            member.guidance = Guidance::default();
        }
    }

    fn close(&mut self, state: SessionState, reason: Option<String>, now_ns: i64) -> Vec<Action> {
        self.state = state;
        self.reason = reason;
        self.clear_guidance();
        self.finished_at_ns = Some(now_ns.max(self.started_at_ns));
        vec![Action::Close]
    }
}

/// Replaces an estimate by the calibration of its sensor; the uncertainty map stays.
fn take_estimate(estimate: &mut Option<RunningEstimate>, sensor: Option<&ImageCalibration>) {
    let Some(sensor) = sensor else { return };
    *estimate = Some(RunningEstimate {
        lens: sensor.lens,
        rms_px: sensor.rms_px,
        uncertainty_px: sensor.uncertainty_px,
        uncertainty_map: estimate.take().and_then(|before| before.uncertainty_map),
        views: sensor.views.iter().filter(|view| view.used).count() as u32,
    });
}
