//! A session of several cameras that are fixed to each other: moments go in (what each camera saw
//! at about the same time), actions come out, as for one camera.
//!
//! Each camera keeps the views that teach something of its own lens, by the rules of [`Session`].
//! With each of them, the other cameras that see the board at that moment keep theirs too, new to
//! them or not: it tells where they are. A view is shared only if the board hardly moved between
//! the two pictures.

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::guidance::Guidance;
use crate::calibration::running_estimate::EstimateSoFar;
use crate::calibration::session::{LEAST_VIEWS, Session, SessionOver};
use crate::calibration::session_end::Ending;
use crate::calibration::session_record::{
    RunningEstimate, SessionMember, SessionRecord, SessionRequest, SessionState,
};
use crate::calibration::solve_rig::{RigCameraInput, RigInput};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;

/// What one camera saw, or why it saw no board.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// The frame.
    pub frame: FrameFacts,
    /// What was seen in it.
    pub seen: Result<Detection, Rejection>,
}

/// A view of a rig's session.
#[derive(Debug, Clone, PartialEq)]
pub struct RigView {
    /// Counts the views of all cameras, from 0.
    pub number: u32,
    /// The camera, as its place in the rig.
    pub member: usize,
    /// The moment; views of the same one were seen together.
    pub moment: u32,
    /// Which of the camera's own views it is.
    pub view: u32,
}

/// What whoever owns the session has to do, in this order.
#[derive(Debug, Clone, PartialEq)]
pub enum RigAction {
    /// Store this view, with the picture that was just observed.
    Keep(RigView),
    /// Estimate the lens of the camera at this place from [`RigSession::session`], and answer with
    /// [`RigSession::estimated`].
    Estimate(usize),
    /// Announce that the record changed in a way the operator should see.
    Announce,
    /// Take no more frames, solve [`RigSession::input`], and answer with [`RigSession::solved`].
    Solve,
    /// Store the record for good: the session is over.
    Close,
}

impl From<Ending> for RigAction {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Announce => Self::Announce,
            Ending::Solve => Self::Solve,
            Ending::Close => Self::Close,
        }
    }
}

/// What became of a moment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ObservedMoment {
    /// Camera by camera: the number of the camera's view that it became, or why it became none;
    /// `None` for one that gave no frame.
    pub admissions: Vec<Option<Result<u32, Rejection>>>,
    /// What to do now.
    pub actions: Vec<RigAction>,
}

/// One rig's session.
#[derive(Debug, Clone)]
pub struct RigSession {
    record: SessionRecord,
    members: Vec<Member>,
    views: Vec<RigView>,
    /// Numbers are never used twice, whatever became of the views that had them.
    next_number: u32,
    moments: u32,
}

#[derive(Debug, Clone)]
struct Member {
    camera: String,
    session: Session,
    /// The last frame with a board: its time and its corners, for the board's speed.
    before: Option<(i64, Detection)>,
}

/// How far the board may have moved between two cameras' pictures of one moment, in pixels.
const SHARED_MOTION_PX: f64 = 0.3;
/// Pictures nearer in time than this were taken together whatever the board does, in seconds.
const SAME_TIME_S: f64 = 5e-4;

impl RigSession {
    /// A session of `cameras` that collects from the next moment on.
    pub fn begin(record: SessionRecord, cameras: &[String], options: &AdmissionOptions) -> Self {
        let member = |camera: &String| {
            // No member ends by itself: the rig does.
            let request = SessionRequest { finish: None, ..record.request.clone() };
            let own = SessionRecord::begin(&record.id, camera, request, record.started_at_ns);
            Member { camera: camera.clone(), session: Session::begin(own, options), before: None }
        };
        let mut session = Self {
            members: cameras.iter().map(member).collect(),
            record,
            views: Vec::new(),
            next_number: 0,
            moments: 0,
        };
        session.renew();
        session
    }

    /// A session as it was stored, with its views in order; those of a camera that is not in the
    /// rig any more have a place that it does not have, and are left out. One that was solving
    /// solves again.
    pub fn resume(
        record: SessionRecord,
        cameras: &[String],
        views: Vec<(RigView, View)>,
        options: &AdmissionOptions,
    ) -> (Self, Vec<RigAction>) {
        let mut session = Self::begin(record, cameras, options);
        session.record.reason = None;
        for (place, view) in views {
            session.next_number = session.next_number.max(place.number + 1);
            let Some(member) = session.members.get_mut(place.member) else { continue };
            if let Some(own) = member.session.keep_shared(&view.frame, &view.detection) {
                session.moments = session.moments.max(place.moment + 1);
                session.views.push(RigView { view: own, ..place });
            }
        }
        session.renew();
        let mut actions = vec![RigAction::Announce];
        match session.record.state {
            SessionState::Solving => actions.push(RigAction::Solve),
            SessionState::Collecting => {
                actions.extend((0..session.members.len()).map(RigAction::Estimate))
            }
            _ => {}
        }
        (session, actions)
    }

    /// The session as seen from outside.
    pub fn record(&self) -> &SessionRecord {
        &self.record
    }

    /// The views of all cameras, in the order they were kept.
    pub fn views(&self) -> &[RigView] {
        &self.views
    }

    /// The part of the camera at place `member`.
    pub fn session(&self, member: usize) -> Option<&Session> {
        self.members.get(member).map(|member| &member.session)
    }

    /// What has been gathered, as a problem to solve.
    pub fn input(&self) -> RigInput {
        let board = self.record.request.target;
        let camera = |(place, member): (usize, &Member)| {
            let views = self.views.iter().filter(|view| view.member == place);
            let view = |of_rig: &RigView| {
                let view = member.session.views().get(of_rig.view as usize)?;
                Some((of_rig.moment as usize, view.to_board_view(&board)))
            };
            Some(RigCameraInput {
                name: member.camera.clone(),
                image_size: member.session.image_size()?,
                views: views.filter_map(view).collect(),
            })
        };
        RigInput { board, cameras: self.members.iter().enumerate().filter_map(camera).collect() }
    }

    /// Looks at one moment: what each camera saw, in the rig's order. `None` once the session takes
    /// no more.
    pub fn observe(&mut self, sightings: &[Option<Sighting>]) -> Option<ObservedMoment> {
        if self.record.state != SessionState::Collecting {
            return None;
        }
        let longest_s = self.collecting_s();
        let motion = self.motion_px_per_s(sightings);
        let mut admissions = self.admissions(sightings);
        let mut actions = self.keep(sightings, &mut admissions, &motion);
        self.record.collecting_s += self.collecting_s() - longest_s;
        let before = (self.record.guidance.clone(), self.record.views_kept);
        self.renew();
        if before != (self.record.guidance.clone(), self.record.views_kept) || !actions.is_empty() {
            actions.push(RigAction::Announce);
        }
        actions.extend(self.end_if_reached());
        Some(ObservedMoment { admissions, actions })
    }

    /// What each camera makes of its own picture.
    fn admissions(
        &mut self,
        sightings: &[Option<Sighting>],
    ) -> Vec<Option<Result<u32, Rejection>>> {
        let each = self.members.iter_mut().zip(sightings);
        each.map(|(member, sighting)| {
            let Sighting { frame, seen } = sighting.as_ref()?;
            Some(member.session.observe(frame, seen.as_ref().map_err(Clone::clone))?.admission)
        })
        .collect()
    }

    /// Keeps what is new to a camera, and with it what the others saw at the same moment.
    fn keep(
        &mut self,
        sightings: &[Option<Sighting>],
        admissions: &mut [Option<Result<u32, Rejection>>],
        motion_px_per_s: &[Option<f64>],
    ) -> Vec<RigAction> {
        let mut actions = Vec::new();
        let is_new: Vec<bool> =
            admissions.iter().map(|admission| matches!(admission, Some(Ok(_)))).collect();
        let mut moment_of: Vec<Option<u32>> = vec![None; is_new.len()];
        for first in (0..is_new.len()).filter(|member| is_new[*member]) {
            if moment_of[first].is_some() {
                continue;
            }
            let moment = self.moments;
            self.moments += 1;
            for other in 0..is_new.len() {
                let seen_together =
                    other == first || together(sightings, motion_px_per_s, first, other);
                if moment_of[other].is_some() || !seen_together {
                    continue;
                }
                if let Some(Err(Rejection::TooSimilar { .. })) = &admissions[other]
                    && let Some(Sighting { frame, seen: Ok(detection) }) = &sightings[other]
                    && let Some(view) = self.members[other].session.keep_shared(frame, detection)
                {
                    admissions[other] = Some(Ok(view));
                }
                if let Some(Ok(view)) = admissions[other] {
                    moment_of[other] = Some(moment);
                    let place = RigView { number: self.next_number, member: other, moment, view };
                    self.next_number += 1;
                    self.views.push(place.clone());
                    actions.push(RigAction::Keep(place));
                }
            }
        }
        let grown = (0..is_new.len()).filter(|member| moment_of[*member].is_some());
        let enough = |member: &usize| self.members[*member].session.views().len() >= LEAST_VIEWS;
        actions.extend(grown.filter(enough).map(RigAction::Estimate));
        actions
    }

    /// Takes the estimate that [`RigAction::Estimate`] asked for; one that could not be made leaves
    /// the one before.
    pub fn estimated(&mut self, member: usize, estimate: Option<EstimateSoFar>) -> Vec<RigAction> {
        if self.record.state.is_over() {
            return Vec::new();
        }
        let mut actions = if estimate.is_some() { vec![RigAction::Announce] } else { Vec::new() };
        if let Some(member) = self.members.get_mut(member) {
            member.session.estimated(estimate);
        }
        self.renew();
        if self.record.state == SessionState::Collecting {
            actions.extend(self.end_if_reached());
        }
        actions
    }

    /// Solves what has been gathered; with too few views it fails at once. `now_ns` is UTC since
    /// the Unix epoch.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn stop(&mut self, now_ns: i64) -> Result<Vec<RigAction>, SessionOver> {
        let enough = self.enough();
        self.record.stop(enough, now_ns)
    }

    /// Gives it up; its views stay. `now_ns` is UTC since the Unix epoch.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn abort(&mut self, now_ns: i64) -> Result<Vec<RigAction>, SessionOver> {
        self.record.abort(now_ns)
    }

    /// Takes the answer to [`RigAction::Solve`]: the id of the calibration, or why there is none.
    pub fn solved(&mut self, outcome: Result<String, String>, now_ns: i64) -> Vec<RigAction> {
        self.record.solved(outcome, now_ns)
    }

    /// No frame will ever come again from any camera: a session that was to end by itself ends now,
    /// another one waits to be stopped.
    pub fn sources_ended(&mut self, reason: &str, now_ns: i64) -> Vec<RigAction> {
        let enough = self.enough();
        self.record.source_ended(reason, enough, now_ns)
    }

    /// Whether the views can be solved, or what to do.
    fn enough(&self) -> Result<(), String> {
        let enough = |member: &&Member| member.session.views().len() >= LEAST_VIEWS;
        if self.members.iter().filter(enough).count() >= 2 {
            return Ok(());
        }
        let kept: Vec<String> = self
            .members
            .iter()
            .map(|member| format!("{} {}", member.camera, member.session.views().len()))
            .collect();
        Err(format!(
            "views kept: {}; two cameras need at least {LEAST_VIEWS} each: start again and show the board where two cameras see all of it",
            kept.join(", ")
        ))
    }

    fn end_if_reached(&mut self) -> Vec<RigAction> {
        let Some(finish) = self.record.request.finish else { return Vec::new() };
        let shared = |member: &SessionMember| member.views_shared as usize >= LEAST_VIEWS;
        let reached = || self.members.iter().all(|member| member.session.reaches(&finish));
        if !(self.record.is_time_up() || (self.record.members.iter().all(shared) && reached())) {
            return Vec::new();
        }
        let enough = self.enough().map_err(|why| format!("the time is up: {why}"));
        self.record.solve_or_fail_by_itself(enough)
    }

    /// The longest that any camera has collected.
    fn collecting_s(&self) -> f64 {
        self.members.iter().map(|member| member.session.record().collecting_s).fold(0.0, f64::max)
    }

    /// How fast the board's fastest corner moves in each picture, in pixels a second; `None` where
    /// that cannot be told.
    fn motion_px_per_s(&mut self, sightings: &[Option<Sighting>]) -> Vec<Option<f64>> {
        let each = self.members.iter_mut().zip(sightings).map(|(member, sighting)| {
            let Sighting { frame, seen } = sighting.as_ref()?;
            let now = seen.as_ref().ok().map(|detection| (frame.time_ns(), detection.clone()));
            let before = std::mem::replace(&mut member.before, now);
            speed(&before?, frame.time_ns(), seen.as_ref().ok()?)
        });
        each.collect()
    }

    /// Renews what the record says of the cameras and of all of them together.
    fn renew(&mut self) {
        let shared = |place: usize| {
            let of_member = self.views.iter().filter(|view| view.member == place);
            let other = |view: &&RigView| {
                self.views.iter().any(|other| other.moment == view.moment && other.member != place)
            };
            of_member.filter(other).count() as u32
        };
        let member = |(place, member): (usize, &Member)| {
            let record = member.session.record();
            SessionMember {
                camera: member.camera.clone(),
                frames_seen: record.frames_seen,
                boards_seen: record.boards_seen,
                views_kept: record.views_kept,
                views_shared: shared(place),
                rejected: record.rejected.clone(),
                coverage: record.coverage.clone(),
                guidance: record.guidance.clone(),
                estimate: record.estimate,
            }
        };
        let members: Vec<SessionMember> = self.members.iter().enumerate().map(member).collect();
        let record = &mut self.record;
        record.frames_seen = members.iter().map(|member| member.frames_seen).sum();
        record.boards_seen = members.iter().map(|member| member.boards_seen).sum();
        record.views_kept = self.moments;
        record.rejected.set_sum(members.iter().map(|member| &member.rejected));
        let worst =
            members.iter().min_by(|a, b| a.coverage.fraction().total_cmp(&b.coverage.fraction()));
        record.coverage = worst.map(|member| member.coverage.clone()).unwrap_or_default();
        let all_estimated = members.iter().all(|member| member.estimate.is_some());
        let median = |estimate: &RunningEstimate| estimate.uncertainty_px.median;
        let estimates =
            members.iter().filter(|_| all_estimated).filter_map(|member| member.estimate);
        record.estimate = estimates.max_by(|a, b| median(a).total_cmp(&median(b)));
        if record.state == SessionState::Collecting {
            record.guidance = Guidance { message: next_step(&members), outline_px: Vec::new() };
        }
        record.members = members;
    }
}

/// Moments that a camera should share with another before anything else is asked for.
const WANTED_SHARED: u32 = 6;

/// What to do next for the camera that lacks most.
fn next_step(members: &[SessionMember]) -> String {
    if let Some(isolated) =
        members.iter().find(|member| member.views_kept > 2 && member.views_shared < WANTED_SHARED)
    {
        return format!(
            "hold the board still where {} and another camera see all of it",
            isolated.camera
        );
    }
    let open = members.iter().filter(|member| !member.guidance.message.is_empty());
    let least = open.min_by(|a, b| a.coverage.fraction().total_cmp(&b.coverage.fraction()));
    least
        .map(|member| format!("{}: {}", member.camera, member.guidance.message))
        .unwrap_or_default()
}

/// Whether two cameras saw the board in the same place: at the same time, or with a board that
/// hardly moved meanwhile.
fn together(
    sightings: &[Option<Sighting>],
    motion_px_per_s: &[Option<f64>],
    one: usize,
    other: usize,
) -> bool {
    let (Some(first), Some(second)) = (&sightings[one], &sightings[other]) else { return false };
    let apart_s = (first.frame.host_time_ns - second.frame.host_time_ns) as f64 * 1e-9;
    let fastest = motion_px_per_s[one].zip(motion_px_per_s[other]).map(|(a, b)| a.max(b));
    apart_s.abs() <= SAME_TIME_S
        || fastest.is_some_and(|speed| speed * apart_s.abs() <= SHARED_MOTION_PX)
}

fn speed((time_ns, before): &(i64, Detection), now_ns: i64, now: &Detection) -> Option<f64> {
    let elapsed_s = (now_ns - time_ns) as f64 * 1e-9;
    let moved = now.corners.iter().filter_map(|corner| {
        let same = before.corners.iter().find(|other| other.index == corner.index)?;
        Some(corner.pixel.distance_px(same.pixel))
    });
    let moved_px = moved.max_by(f64::total_cmp)?;
    (elapsed_s > 0.0 && elapsed_s < 0.5).then(|| moved_px / elapsed_s)
}

#[cfg(test)]
#[path = "rig_session_tests.rs"]
mod tests;
