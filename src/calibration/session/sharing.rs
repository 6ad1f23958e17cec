//! What the cameras of a rig share: views of the same frame set, which say where the cameras are.

use crate::calibration::placement::Placement;
use crate::calibration::session::action::{CameraFrame, KeptView};
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session_record::SessionMember;

/// Frame sets that a camera should share with another before anything else is asked for.
const WANTED: usize = 6;

/// A session's cameras with what was kept of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sharing<'a> {
    pub(super) cameras: &'a [CameraPart],
    pub(super) kept: &'a [KeptView],
}

impl<'a> Sharing<'a> {
    /// A camera's views of frame sets that another camera has a view of.
    pub(super) fn views(self, camera: usize) -> impl Iterator<Item = &'a KeptView> {
        let own = self.kept.iter().filter(move |view| view.camera == camera);
        own.filter(move |view| {
            self.kept
                .iter()
                .any(|other| other.frame_set == view.frame_set && other.camera != camera)
        })
    }

    /// How the board was held in them, where the camera should share more.
    pub(super) fn wanted(self, camera: usize) -> Option<Vec<Placement>> {
        let part = self.cameras.get(camera)?;
        let placement = |view: &KeptView| part.placements().get(view.view as usize).copied();
        let shared: Vec<Placement> = self.views(camera).filter_map(placement).collect();
        (shared.len() < WANTED).then_some(shared)
    }

    /// Whether a camera sees what none of its shared views shows, and another camera sees it
    /// `together` with it. A board is often kept while it still moves, which shares nothing where
    /// cameras are not synchronized; held still it is new to no camera.
    pub(super) fn is_new(
        self,
        (frame_set, usable): (&[Option<CameraFrame>], &[bool]),
        camera: usize,
        together: impl Fn(usize, usize) -> bool,
    ) -> bool {
        let Some(seen) = &frame_set[camera] else { return false };
        let (frame, Some(detection)) = (&seen.frame, seen.board()) else { return false };
        let other = |other: usize| other != camera && usable[other] && together(camera, other);
        usable[camera]
            && (0..usable.len()).any(other)
            && self
                .wanted(camera)
                .is_some_and(|shared| self.cameras[camera].is_new_among(&shared, frame, detection))
    }
}

/// What to do next for the camera that lacks most.
pub(super) fn next_step(members: &[SessionMember]) -> String {
    let is_isolated =
        |member: &&SessionMember| member.views_kept > 2 && (member.views_shared as usize) < WANTED;
    if let Some(isolated) = members.iter().find(is_isolated) {
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
