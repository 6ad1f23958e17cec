//! Whether a session's views can be solved, and whether they reach its goals.

use crate::calibration::session::camera::CameraPart;
use crate::calibration::session::not_enough::{
    CameraRejection, CameraViews, LEAST_VIEWS, NotEnough,
};
use crate::calibration::session::{Action, Session};
use crate::calibration::session_record::SessionMember;

impl Session {
    /// Whether the views can be solved, or what to do.
    pub(super) fn enough(&self) -> Result<(), NotEnough> {
        if let ([only], false) = (self.cameras.as_slice(), self.is_rig()) {
            return only.enough();
        }
        // A lens that is held fixed needs no views of its own: one view determines the camera's
        // pose.
        let is_enough = |camera: &&CameraPart| {
            let is_held = self.record.request.held(&camera.summary().camera).is_some();
            camera.has_enough() || (is_held && camera.kept() > 0)
        };
        if self.cameras.iter().filter(is_enough).count() >= 2 {
            return Ok(());
        }
        let name = |camera: &CameraPart| camera.summary().camera.clone();
        let views = |camera: &CameraPart| CameraViews { camera: name(camera), kept: camera.kept() };
        let mut too_few = self.cameras.iter().filter(|camera| !is_enough(camera));
        let rejected = too_few.find_map(|camera| {
            let rejected = camera.board()?.why_rejected()?;
            Some(CameraRejection { camera: name(camera), rejected })
        });
        Err(NotEnough::RigViews { kept: self.cameras.iter().map(views).collect(), rejected })
    }

    /// As [`Session::enough`]; the reason begins with the camera that the session waits for.
    pub(super) fn enough_or_waiting(&self) -> Result<(), NotEnough> {
        self.enough().map_err(|cause| match self.waiting_for.clone() {
            Some(wait) => NotEnough::Waiting { wait, cause: Box::new(cause) },
            None => cause,
        })
    }

    /// Ends the session if its goals are reached or its time is up.
    pub(super) fn end_if_reached(&mut self) -> Vec<Action> {
        let Some(finish) = self.record.request.finish else { return Vec::new() };
        let shared = |member: &SessionMember| member.views_shared as usize >= LEAST_VIEWS;
        let placed = self.record.members.iter().all(shared);
        let known_together = |goal_px| self.pairs.reach(&self.cameras, goal_px);
        let reached = || {
            self.cameras.iter().all(|camera| camera.reaches(&finish))
                && finish.uncertainty_px.is_none_or(known_together)
        };
        if !(self.record.is_time_up() || (placed && reached())) {
            return Vec::new();
        }
        let time_up = |cause| NotEnough::TimeUp { cause: Box::new(cause) };
        self.record.solve_or_fail_by_itself(self.enough_or_waiting().map_err(time_up))
    }
}
