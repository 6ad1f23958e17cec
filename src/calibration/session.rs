//! What the product decides: a calibration session as a state machine. Events go in (a frame was
//! looked at, an estimate is ready, someone asks to stop), [`Action`]s come out; whoever owns the
//! session performs them. How it ends is in [`super::session_end`].
//!
//! It reads no clock and starts no thread: time comes inside frames and requests. Which views are
//! kept depends on the frames alone; only reaching an uncertainty goal depends on when estimates
//! are ready.

use crate::calibration::admission::{AdmissionOptions, Rejection, SeenBefore, admit};
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::{Guidance, advise};
use crate::calibration::placement::Placement;
use crate::calibration::running_estimate::{EstimateSoFar, GoingOn};
use crate::calibration::session_end::Ending;
pub use crate::calibration::session_end::SessionOver;
use crate::calibration::session_record::{Finish, SessionRecord, SessionState};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;

/// Fewer views leave the lens undetermined (Zhang, "A flexible new technique for camera
/// calibration", 2000, section 3.3).
pub const LEAST_VIEWS: usize = 3;
/// An uncertainty estimated from fewer views is not worth stopping for, unless the request says so.
const LEAST_VIEWS_FOR_GOAL: u32 = 8;
/// So many frames in a row with the same obstacle, and the operator is told.
const OBSTACLE_FRAMES: u32 = 4;

/// What whoever owns the session has to do, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Store the view with this number, with the picture that was just observed, before taking the
    /// next frame.
    Keep(u32),
    /// Estimate from [`Session::views`] beside the frames, and answer with [`Session::estimated`].
    Estimate,
    /// Announce that the record changed in a way the operator should see.
    Announce,
    /// Take no more frames, solve [`Session::views`], and answer with [`Session::solved`].
    Solve,
    /// Store the record for good: the session is over.
    Close,
}

/// What became of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// The number of the view it became, or why it became none.
    pub admission: Result<u32, Rejection>,
    /// What to do now.
    pub actions: Vec<Action>,
}

impl From<Ending> for Action {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Announce => Self::Announce,
            Ending::Solve => Self::Solve,
            Ending::Close => Self::Close,
        }
    }
}

/// One camera's session.
#[derive(Debug, Clone)]
pub struct Session {
    record: SessionRecord,
    views: Vec<View>,
    placements: Vec<Placement>,
    before: Option<SeenBefore>,
    last_time_ns: Option<i64>,
    obstacle: Option<(Rejection, u32)>,
    going_on: Option<GoingOn>,
    estimating: bool,
    /// A view was kept while an estimate was being made.
    estimate_outdated: bool,
    options: AdmissionOptions,
}

impl Session {
    /// A session that collects from the next frame on.
    pub fn begin(record: SessionRecord, options: &AdmissionOptions) -> Self {
        Self {
            record,
            views: Vec::new(),
            placements: Vec::new(),
            before: None,
            last_time_ns: None,
            obstacle: None,
            going_on: None,
            estimating: false,
            estimate_outdated: false,
            options: *options,
        }
    }

    /// A session as it was stored, with its views in order. One that was collecting goes on
    /// collecting, one that was solving solves again.
    pub fn resume(
        record: SessionRecord,
        views: Vec<View>,
        options: &AdmissionOptions,
    ) -> (Self, Vec<Action>) {
        let mut session = Self::begin(record, options);
        session.record.coverage = Coverage::default();
        session.record.reason = None;
        for view in views {
            // What was admitted once has a placement; a view without one would shift the numbers
            // that rejections name.
            if let Some(placement) = Placement::of(&view.detection, view.frame.image_size) {
                session.add(view, placement);
            }
        }
        let mut actions = vec![Action::Announce];
        match session.record.state {
            SessionState::Solving => actions.push(Action::Solve),
            SessionState::Collecting => actions.extend(session.wish_estimate()),
            _ => {}
        }
        (session, actions)
    }

    /// The session as seen from outside.
    pub fn record(&self) -> &SessionRecord {
        &self.record
    }

    /// The kept views, in order.
    pub fn views(&self) -> &[View] {
        &self.views
    }

    /// The size of its pictures; `None` before the first view.
    pub fn image_size(&self) -> Option<ImageSize> {
        self.views.first().map(|view| view.frame.image_size)
    }

    /// Looks at one frame: what was detected in it, or why nothing was. `None` once the session
    /// takes no more frames.
    pub fn observe(
        &mut self,
        frame: &FrameFacts,
        seen: Result<&Detection, Rejection>,
    ) -> Option<Observed> {
        if self.record.state != SessionState::Collecting {
            return None;
        }
        self.record.frames_seen += 1;
        self.count_time(frame.time_ns());
        let admission = self.admit(frame, seen);
        let mut actions = Vec::new();
        match &admission {
            Ok(number) => {
                self.obstacle = None;
                actions.push(Action::Keep(*number));
                actions.extend(self.wish_estimate());
            }
            Err(rejection) => {
                self.record.rejected.count(rejection);
                self.note_obstacle(rejection);
            }
        }
        let advised = self.advise(frame.image_size);
        if advised || admission.is_ok() {
            actions.push(Action::Announce);
        }
        actions.extend(self.end_if_reached());
        Some(Observed { admission, actions })
    }

    /// Whether the session would keep `frame` for what was detected in it, if it were observed now.
    pub fn would_keep(&self, frame: &FrameFacts, detection: &Detection) -> bool {
        self.record.state == SessionState::Collecting
            && self.image_size().is_none_or(|expected| expected == frame.image_size)
            && admit(detection, frame, self.before.as_ref(), &self.placements, &self.options)
                .is_ok()
    }

    /// Keeps a detection that teaches this camera nothing new, for what it teaches of a rig:
    /// another camera of it saw the board at the same moment. The number of the view; `None` where
    /// it cannot be a view at all.
    pub fn keep_shared(&mut self, frame: &FrameFacts, detection: &Detection) -> Option<u32> {
        let room = self.views.len() < self.options.view_limit as usize;
        let fits = self.image_size().is_none_or(|expected| expected == frame.image_size);
        let placement = Placement::of(detection, frame.image_size).filter(|_| room && fits)?;
        let number = self.views.len() as u32;
        self.add(View { number, frame: frame.clone(), detection: detection.clone() }, placement);
        Some(number)
    }

    /// Whether the views reach the goals of `finish` but for its time.
    pub fn reaches(&self, finish: &Finish) -> bool {
        self.goals_reached(finish)
    }

    /// Takes the estimate that [`Action::Estimate`] asked for; one that could not be made leaves
    /// the one before.
    pub fn estimated(&mut self, estimate: Option<EstimateSoFar>) -> Vec<Action> {
        self.estimating = false;
        if self.record.state.is_over() {
            return Vec::new();
        }
        let mut actions = Vec::new();
        if let Some(EstimateSoFar { running, going_on }) = estimate {
            self.record.estimate = Some(running);
            self.going_on = going_on;
            actions.push(Action::Announce);
        }
        if self.record.state == SessionState::Collecting {
            if self.estimate_outdated {
                actions.extend(self.wish_estimate());
            }
            actions.extend(self.end_if_reached());
        }
        actions
    }

    /// What the newest estimate left for the next one to go on from.
    pub fn going_on(&self) -> Option<&GoingOn> {
        self.going_on.as_ref()
    }

    /// Whether an estimate is being made.
    pub fn is_estimating(&self) -> bool {
        self.estimating
    }

    /// Solves what has been gathered; with too few views it fails at once. Nothing new for one that
    /// solves already. `now_ns` is UTC since the Unix epoch.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn stop(&mut self, now_ns: i64) -> Result<Vec<Action>, SessionOver> {
        let enough = self.enough();
        self.record.stop(enough, now_ns)
    }

    /// Gives it up; its views stay. `now_ns` is UTC since the Unix epoch.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn abort(&mut self, now_ns: i64) -> Result<Vec<Action>, SessionOver> {
        self.record.abort(now_ns)
    }

    /// Takes the answer to [`Action::Solve`]: the id of the calibration, or why there is none.
    pub fn solved(&mut self, outcome: Result<String, String>, now_ns: i64) -> Vec<Action> {
        self.record.solved(outcome, now_ns)
    }

    /// The camera gives no frames for `reason`: the session waits for it, and says so.
    pub fn camera_lost(&mut self, reason: &str) -> Vec<Action> {
        self.before = None;
        self.last_time_ns = None;
        let reason = Some(format!("waits for the camera: {reason}"));
        if self.record.state != SessionState::Collecting || self.record.reason == reason {
            return Vec::new();
        }
        self.record.reason = reason;
        vec![Action::Announce]
    }

    /// The camera gives frames again.
    pub fn camera_back(&mut self) -> Vec<Action> {
        if self.record.state == SessionState::Collecting && self.record.reason.take().is_some() {
            return vec![Action::Announce];
        }
        Vec::new()
    }

    /// `seconds` went by without a frame.
    pub fn waited(&mut self, seconds: f64) -> Vec<Action> {
        if self.record.state != SessionState::Collecting {
            return Vec::new();
        }
        self.record.collecting_s += seconds.max(0.0);
        self.end_if_reached()
    }

    /// No frame will ever come again: a session that was to end by itself ends now, another one
    /// waits to be stopped.
    pub fn source_ended(&mut self, reason: &str, now_ns: i64) -> Vec<Action> {
        let enough = self.enough();
        self.record.source_ended(reason, enough, now_ns)
    }

    /// Whether the views can be solved, or what to do.
    fn enough(&self) -> Result<(), String> {
        if self.views.len() >= LEAST_VIEWS {
            return Ok(());
        }
        Err(format!(
            "{} views were kept and at least {LEAST_VIEWS} are needed; start again and show the board in more positions, tilted in different directions",
            self.views.len()
        ))
    }

    fn admit(
        &mut self,
        frame: &FrameFacts,
        seen: Result<&Detection, Rejection>,
    ) -> Result<u32, Rejection> {
        let detection = seen.inspect_err(|_| self.before = None)?;
        self.record.boards_seen += 1;
        let now = SeenBefore { time_ns: frame.time_ns(), detection: detection.clone() };
        let before = self.before.replace(now);
        match self.image_size() {
            Some(expected) if expected != frame.image_size => {
                return Err(Rejection::OtherImageSize { got: frame.image_size, expected });
            }
            _ => {}
        }
        let placement = admit(detection, frame, before.as_ref(), &self.placements, &self.options)?;
        let number = self.views.len() as u32;
        self.add(View { number, frame: frame.clone(), detection: detection.clone() }, placement);
        Ok(number)
    }

    fn add(&mut self, view: View, placement: Placement) {
        let size = view.frame.image_size;
        if self.views.is_empty() {
            self.record.coverage = Coverage::empty(size);
        }
        self.record.coverage.add(&view.detection, size);
        self.views.push(view);
        self.placements.push(placement);
        self.record.views_kept = self.views.len() as u32;
    }

    /// Frame time goes on counting as long as it rises in plausible steps.
    fn count_time(&mut self, time_ns: i64) {
        let last_ns = self.last_time_ns.replace(time_ns);
        let elapsed_s =
            last_ns.map_or(0.0, |last_ns| time_ns.saturating_sub(last_ns) as f64 * 1e-9);
        if (0.0..60.0).contains(&elapsed_s) {
            self.record.collecting_s += elapsed_s;
        }
    }

    fn note_obstacle(&mut self, rejection: &Rejection) {
        let frames = match &self.obstacle {
            Some((before, frames)) if before.kind() == rejection.kind() => frames + 1,
            _ => 1,
        };
        self.obstacle = Some((rejection.clone(), frames));
    }

    /// Renews the guidance; whether it changed.
    fn advise(&mut self, size: ImageSize) -> bool {
        let lasting = self
            .obstacle
            .as_ref()
            .filter(|(_, frames)| *frames >= OBSTACLE_FRAMES)
            .map(|(what, _)| what);
        let guidance: Guidance =
            advise(&self.record.request.target, size, &self.placements, lasting);
        let changed = guidance != self.record.guidance;
        self.record.guidance = guidance;
        changed
    }

    fn wish_estimate(&mut self) -> Option<Action> {
        if self.views.len() < LEAST_VIEWS {
            return None;
        }
        self.estimate_outdated = self.estimating;
        (!std::mem::replace(&mut self.estimating, true)).then_some(Action::Estimate)
    }

    fn end_if_reached(&mut self) -> Vec<Action> {
        let Some(finish) = self.record.request.finish else { return Vec::new() };
        if !(self.record.is_time_up() || self.goals_reached(&finish)) {
            return Vec::new();
        }
        let enough = self.enough().map_err(|why| format!("the time is up: {why}"));
        self.record.solve_or_fail_by_itself(enough)
    }

    fn goals_reached(&self, finish: &Finish) -> bool {
        let kept = self.record.views_kept;
        match (finish.uncertainty_px, finish.min_views) {
            (None, None) => false,
            (None, Some(least)) => kept >= least.max(LEAST_VIEWS as u32),
            (Some(goal_px), least) => self.record.estimate.is_some_and(|estimate| {
                estimate.views >= least.unwrap_or(LEAST_VIEWS_FOR_GOAL)
                    && estimate.uncertainty_px.median <= goal_px
            }),
        }
    }
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
