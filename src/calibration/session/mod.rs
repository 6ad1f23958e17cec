//! What the product decides: a calibration session of an instrument as a state machine. Frame sets
//! go in (what each camera gave at about the same time), [`Action`]s come out, and the owner of the
//! session performs them. `ending` has how it ends, `camera` what one camera gathers.
//!
//! A single camera is an instrument of one. Each camera keeps the views that add information about
//! its own lens. With each of them, the other cameras that see the board in that frame set keep
//! theirs too, new to them or not: such a view constrains the poses between the cameras. Views that
//! two cameras share are also kept for their information about the pair (`pairs`), and depth for
//! its information about the depth camera (`depth_part`). A view is shared only if the board hardly
//! moved between the two images.
//!
//! It reads no clock and starts no thread: time comes inside frames and requests. Which views are
//! kept depends on the frames alone; only reaching an uncertainty goal depends on when estimates
//! are ready.

mod action;
mod advice;
mod approach;
mod board_part;
pub mod camera;
mod camera_wait;
mod depth_frame;
mod depth_part;
mod ending;
mod enough;
pub mod gate;
mod last_rejections;
mod not_enough;
mod pairs;
mod progress;
mod raw_depth;
mod resume;
mod scene_part;
mod scene_steps;
mod sharing;
mod simultaneity;

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::guidance::Guidance;
use crate::calibration::placement::Placement;
use crate::calibration::result::Calibration;
use crate::calibration::running_estimate::EstimateSoFar;
use crate::calibration::scene::key_frames::KeyFrame;
use crate::calibration::scene::so_far::SceneSoFar;
pub use crate::calibration::session::action::{
    Action, CameraFrame, FrameContent, KeptView, Observed,
};
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session::camera_wait::CameraWait;
pub use crate::calibration::session::depth_frame::DepthFrame;
pub use crate::calibration::session::ending::SessionOver;
pub use crate::calibration::session::not_enough::LEAST_VIEWS;
use crate::calibration::session::pairs::Pairs;
use crate::calibration::session::sharing::{Sharing, next_step};
use crate::calibration::session::simultaneity::Simultaneity;
use crate::calibration::session_record::{SessionMember, SessionRecord, SessionState};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;

/// An instrument's session.
#[derive(Debug, Clone)]
pub struct Session {
    record: SessionRecord,
    cameras: Vec<CameraPart>,
    /// The camera that it waits for while it collects; the record has the same in words.
    waiting_for: Option<CameraWait>,
    simultaneity: Simultaneity,
    pairs: Pairs,
    kept: Vec<KeptView>,
    /// Numbers are never reused, even if their views were exchanged.
    next_number: u32,
    frame_sets: u32,
    /// Time before this run, and time waited without frames.
    other_collecting_s: f64,
}

impl Session {
    /// A session that collects from the next frame set on. `cameras` are the names of a rig's
    /// cameras; none for an instrument that is one camera.
    pub fn begin(record: SessionRecord, cameras: &[String], options: &AdmissionOptions) -> Self {
        let of_rig = cameras.iter().map(|camera| {
            let known = record.members.iter().find(|member| member.camera == *camera);
            known.cloned().unwrap_or_else(|| SessionMember::begin(camera))
        });
        let mut summaries: Vec<SessionMember> = of_rig.collect();
        if summaries.is_empty() {
            summaries.push(record.to_member());
        }
        let part = |summary| CameraPart::new(&record.request, summary, options);
        let cameras_of: Vec<CameraPart> = summaries.into_iter().map(part).collect();
        let mut session = Self {
            simultaneity: Simultaneity::new(cameras_of.len()),
            cameras: cameras_of,
            waiting_for: None,
            pairs: Pairs::default(),
            other_collecting_s: record.collecting_s,
            record,
            kept: Vec::new(),
            next_number: 0,
            frame_sets: 0,
        };
        session.renew(!cameras.is_empty());
        session
    }

    /// The session as seen from outside.
    pub fn record(&self) -> &SessionRecord {
        &self.record
    }

    /// The kept views of all cameras, in the order they were kept.
    pub fn kept(&self) -> &[KeptView] {
        &self.kept
    }

    /// The part of the camera of this index.
    pub fn camera(&self, camera: usize) -> Option<&CameraPart> {
        self.cameras.get(camera)
    }

    /// The view that was kept as `kept`.
    pub fn view(&self, kept: &KeptView) -> Option<&View> {
        self.cameras.get(kept.camera)?.views().get(kept.view as usize)
    }

    /// The key frame that was kept as `kept`.
    pub fn key_frame(&self, kept: &KeptView) -> Option<&KeyFrame> {
        self.cameras.get(kept.camera)?.key_frames().get(kept.view as usize)
    }

    /// The last key frame that the camera of this index kept.
    pub fn last_key_frame(&self, camera: usize) -> Option<&KeyFrame> {
        self.cameras.get(camera)?.key_frames().last()
    }

    /// Takes one frame set: the frame of each camera, in the instrument's order. `None` once the
    /// session takes no more.
    pub fn observe(&mut self, frame_set: &[Option<CameraFrame>]) -> Option<Observed> {
        if self.record.state != SessionState::Collecting {
            return None;
        }
        self.simultaneity.take(frame_set);
        let mut admissions: Vec<Option<Result<u32, Rejection>>> = (self.cameras.iter_mut())
            .zip(frame_set)
            .map(|(camera, seen)| Some(camera.observe(seen.as_ref()?)))
            .collect();
        let kept = self.keep(frame_set, &mut admissions);
        if !kept.is_empty() {
            self.pair_up();
        }
        let grown = |camera: usize| kept.iter().any(|kept| kept.camera == camera);
        let mut actions = self.request_estimates(grown);
        let before = self.record.guidance.clone();
        self.renew(self.is_rig());
        if before != self.record.guidance || !kept.is_empty() {
            actions.push(Action::Announce);
        }
        actions.extend(self.end_if_reached());
        Some(Observed { admissions, kept, actions })
    }

    /// As [`Session::observe`], of an instrument that is one camera.
    pub fn observe_frame(
        &mut self,
        frame: FrameFacts,
        seen: Result<impl Into<FrameContent>, Rejection>,
    ) -> Option<Observed> {
        let seen = seen.map(Into::into);
        self.observe(&[Some(CameraFrame { frame, seen, depth: None })])
    }

    /// Whether the camera of this index would keep `frame` for what was detected in it, if it were
    /// observed now.
    pub fn would_keep(&self, camera: usize, frame: &FrameFacts, detection: &Detection) -> bool {
        self.record.state == SessionState::Collecting
            && self.cameras.get(camera).is_some_and(|camera| camera.would_keep(frame, detection))
    }

    /// Takes the estimate that [`Action::Estimate`] requested; `None`, if it could not be made,
    /// keeps the previous one.
    pub fn estimated(&mut self, camera: usize, estimate: Option<EstimateSoFar>) -> Vec<Action> {
        let estimate = estimate.filter(|_| !self.record.state.is_over());
        let is_new = estimate.is_some();
        if let Some(part) = self.cameras.get_mut(camera) {
            part.estimated(estimate);
        }
        self.after_estimate(camera, is_new)
    }

    /// As [`Session::estimated`], of a session without a board.
    pub fn scene_estimated(&mut self, camera: usize, so_far: Option<SceneSoFar>) -> Vec<Action> {
        let so_far = so_far.filter(|_| !self.record.state.is_over());
        let is_new = so_far.is_some();
        if let Some(part) = self.cameras.get_mut(camera) {
            part.scene_estimated(so_far);
        }
        self.after_estimate(camera, is_new)
    }

    fn after_estimate(&mut self, camera: usize, is_new: bool) -> Vec<Action> {
        let mut actions = Vec::new();
        if is_new {
            actions.push(Action::Announce);
        }
        if self.record.state.is_over() {
            return actions;
        }
        self.renew(self.is_rig());
        if self.record.state == SessionState::Collecting {
            let outdated = self.cameras.get(camera).is_some_and(CameraPart::is_estimate_outdated);
            actions.extend(self.request_estimates(|other| other == camera && outdated));
            actions.extend(self.end_if_reached());
        } else {
            // The estimate renewed the guidance, which a session that no longer collects must not
            // show.
            self.record.clear_guidance();
        }
        actions
    }

    /// Solves what has been gathered; with too few views it fails at once. No actions if it is
    /// solving already. `now_ns` is UTC since the Unix epoch.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn stop(&mut self, now_ns: i64) -> Result<Vec<Action>, SessionOver> {
        let enough = self.enough_or_waiting();
        self.record.stop(enough, now_ns)
    }

    /// Gives the session up; its views stay. `now_ns` is UTC since the Unix epoch.
    ///
    /// # Errors
    /// [`SessionOver`].
    pub fn abort(&mut self, now_ns: i64) -> Result<Vec<Action>, SessionOver> {
        self.record.abort(now_ns)
    }

    /// Takes the answer to [`Action::Solve`]: the id of the calibration. [`Session::fail`] takes
    /// why there is none.
    pub fn solved(&mut self, calibration: &str, now_ns: i64) -> Vec<Action> {
        self.record.solved(calibration, now_ns)
    }

    /// Takes the calibration that answers [`Action::Solve`]: from now on the estimate is that of
    /// the calibration.
    pub fn calibrated(&mut self, calibration: &Calibration) -> Vec<Action> {
        self.record.calibrated(calibration)
    }

    /// Ends it for `reason`, a solve without a result or a fault of the program; its views stay.
    /// `now_ns` is UTC since the Unix epoch.
    pub fn fail(&mut self, reason: &str, now_ns: i64) -> Vec<Action> {
        self.record.fail(reason, now_ns)
    }

    /// The camera of this index delivers no frames for `reason`: the session waits for it, and
    /// reports this.
    pub fn camera_lost(&mut self, camera: usize, reason: &str) -> Vec<Action> {
        let is_rig = self.is_rig();
        let Some(part) = self.cameras.get_mut(camera) else { return Vec::new() };
        part.lost();
        let wait = CameraWait {
            camera: is_rig.then(|| part.summary().camera.clone()),
            reason: reason.to_owned(),
        };
        if self.record.state != SessionState::Collecting || self.waiting_for.as_ref() == Some(&wait)
        {
            return Vec::new();
        }
        self.record.reason = Some(wait.to_string());
        self.waiting_for = Some(wait);
        vec![Action::Announce]
    }

    /// A camera gives frames again.
    pub fn camera_back(&mut self) -> Vec<Action> {
        self.waiting_for = None;
        if self.record.state == SessionState::Collecting && self.record.reason.take().is_some() {
            return vec![Action::Announce];
        }
        Vec::new()
    }

    /// `device` gives the frames of `camera`. If it is not the device of the earlier frames, the
    /// session ends: views of two devices must not mix. `now_ns` is UTC since the Unix epoch.
    pub fn device_gives_frames(&mut self, camera: &str, device: &str, now_ns: i64) -> Vec<Action> {
        if self.record.state != SessionState::Collecting {
            return Vec::new();
        }
        match self.record.take_device(camera, device) {
            Ok(()) => Vec::new(),
            Err(other) => self.record.give_up(&other.to_string(), now_ns),
        }
    }

    /// `seconds` went by without a frame.
    pub fn waited(&mut self, seconds: f64) -> Vec<Action> {
        if self.record.state != SessionState::Collecting {
            return Vec::new();
        }
        self.other_collecting_s += seconds.max(0.0);
        self.renew(self.is_rig());
        self.end_if_reached()
    }

    /// No frame will ever come again from any camera: a session with a goal ends now, another one
    /// waits to be stopped.
    pub fn source_ended(&mut self, reason: &str, now_ns: i64) -> Vec<Action> {
        let enough = self.enough();
        self.waiting_for = None;
        self.record.source_ended(reason, enough, now_ns)
    }

    fn sharing(&self) -> Sharing<'_> {
        Sharing { cameras: &self.cameras, kept: &self.kept }
    }

    /// The placements of the board in the shared views of a rig's camera: a board held differently
    /// may be kept for its information about two cameras together.
    fn shared_placements(&self, camera: usize) -> Option<Vec<Placement>> {
        self.is_rig().then(|| self.sharing().placements(camera))
    }

    /// Updates the information in the kept views about each pair of cameras, and requests the next
    /// view.
    fn pair_up(&mut self) {
        if self.cameras.len() > 1 && self.record.state == SessionState::Collecting {
            let goal_px = self.record.request.finish.and_then(|finish| finish.uncertainty_px);
            self.pairs = Pairs::of(&self.cameras, &self.kept, goal_px);
            self.pairs.request_shared(&mut self.cameras);
        }
    }

    fn is_rig(&self) -> bool {
        self.cameras.len() > 1 || !self.record.members.is_empty()
    }

    /// Keeps what is new to a camera, and with it the views of the other cameras in the same frame
    /// set.
    fn keep(
        &mut self,
        frame_set: &[Option<CameraFrame>],
        admissions: &mut [Option<Result<u32, Rejection>>],
    ) -> Vec<KeptView> {
        let mut kept: Vec<KeptView> = Vec::new();
        let is_usable = |admission: &Option<Result<u32, Rejection>>| match admission {
            Some(Ok(_)) => true,
            Some(Err(rejection)) => rejection.is_known_already(),
            None => false,
        };
        let usable: Vec<bool> = admissions.iter().map(is_usable).collect();
        let simultaneous =
            |one: usize, other: usize| self.simultaneity.are_simultaneous(frame_set, one, other);
        let is_new: Vec<bool> = (0..admissions.len())
            .map(|camera| {
                matches!(admissions[camera], Some(Ok(_)))
                    || self.sharing().is_new(frame_set, &usable, camera, simultaneous)
                    || self.pairs.share_informative_view(
                        self.sharing(),
                        frame_set,
                        &usable,
                        camera,
                        simultaneous,
                    )
            })
            .collect();
        for first in (0..is_new.len()).filter(|camera| is_new[*camera]) {
            if kept.iter().any(|kept| kept.camera == first) {
                continue;
            }
            let number = self.frame_sets;
            self.frame_sets += 1;
            for other in 0..is_new.len() {
                let is_simultaneous =
                    other == first || self.simultaneity.are_simultaneous(frame_set, first, other);
                if !is_simultaneous || kept.iter().any(|kept| kept.camera == other) {
                    continue;
                }
                let is_known = Rejection::is_known_already;
                if let Some(Err(rejection)) = &admissions[other]
                    && is_known(rejection)
                    && let Some(seen) = &frame_set[other]
                    && let Some(view) = self.cameras[other].keep_shared(seen, rejection)
                {
                    admissions[other] = Some(Ok(view));
                }
                if let Some(Ok(view)) = admissions[other] {
                    let (camera, frame_set) = (other, number);
                    // The new view has the index of the one it was exchanged for.
                    self.kept.retain(|old| (old.camera, old.view) != (camera, view));
                    kept.push(KeptView { number: self.next_number, camera, frame_set, view });
                    self.next_number += 1;
                }
            }
        }
        self.kept.extend(&kept);
        kept
    }

    fn request_estimates(&mut self, wanted: impl Fn(usize) -> bool) -> Vec<Action> {
        let each = self.cameras.iter_mut().enumerate().filter(|(camera, _)| wanted(*camera));
        each.filter_map(|(camera, part)| {
            part.request_estimate().then_some(Action::Estimate(camera))
        })
        .collect()
    }

    /// Renews the record's summary of each camera and of all of them.
    fn renew(&mut self, is_rig: bool) {
        let longest_s = self.cameras.iter().map(CameraPart::collecting_s).fold(0.0, f64::max);
        let record = &mut self.record;
        record.collecting_s = self.other_collecting_s + longest_s;
        if let ([only], false) = (self.cameras.as_slice(), is_rig) {
            record.take_member(only.summary());
            return;
        }
        let sharing = Sharing { cameras: &self.cameras, kept: &self.kept };
        let member = |(camera, part): (usize, &CameraPart)| SessionMember {
            views_shared: sharing.views(camera).count() as u32,
            ..part.summary().clone()
        };
        let members: Vec<SessionMember> = self.cameras.iter().enumerate().map(member).collect();
        record.frames_seen = members.iter().map(|member| member.frames_seen).sum();
        record.boards_seen = members.iter().map(|member| member.boards_seen).sum();
        record.views_kept = self.frame_sets;
        record.rejected.set_sum(members.iter().map(|member| &member.rejected));
        let worst =
            members.iter().min_by(|a, b| a.coverage.fraction().total_cmp(&b.coverage.fraction()));
        record.coverage = worst.map(|member| member.coverage.clone()).unwrap_or_default();
        record.estimate = SessionMember::worst_estimate(&members);
        if record.state == SessionState::Collecting {
            // Named first: a camera that sees the board now, if one of the two does.
            let sees = |camera: usize| {
                self.cameras[camera].board().is_some_and(|part| part.newest().is_some())
            };
            let requested = self.pairs.requested_pair();
            let requested =
                requested.map(|[a, b]| if !sees(a) && sees(b) { [b, a] } else { [a, b] });
            let (expected_uncertainty_px, views_to_go) =
                self.pairs.figures(members.iter().map(|member| &member.guidance));
            record.guidance = Guidance {
                message: next_step(&members, requested),
                expected_uncertainty_px,
                views_to_go,
                ..Guidance::default()
            };
        }
        record.members = members;
    }
}

#[cfg(test)]
mod rig_tests;
#[cfg(test)]
mod scene_tests;
#[cfg(test)]
mod tests;
