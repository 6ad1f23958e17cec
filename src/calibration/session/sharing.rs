//! What the cameras of a rig share: views of the same frame set, which determine the poses between
//! the cameras.

use crate::calibration::placement::Placement;
use crate::calibration::session::action::{CameraFrame, KeptView};
use crate::calibration::session::camera::CameraPart;
use crate::calibration::session_record::SessionMember;

/// Shared views that a camera should have before anything else is asked for.
const WANTED_SHARED_VIEWS: usize = 6;

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

    /// How the board was held in them.
    pub(super) fn placements(self, camera: usize) -> Vec<Placement> {
        let placements = self.cameras.get(camera).map_or(&[][..], CameraPart::placements);
        let placement = |view: &KeptView| placements.get(view.view as usize).copied();
        self.views(camera).filter_map(placement).collect()
    }

    /// The same, if the camera should share more views.
    fn wanted(self, camera: usize) -> Option<Vec<Placement>> {
        Some(self.placements(camera)).filter(|shared| shared.len() < WANTED_SHARED_VIEWS)
    }

    /// Whether the board is held differently than in each of this camera's shared views.
    pub(super) fn is_held_anew(self, camera: usize, seen: &CameraFrame) -> bool {
        let (frame, Some(detection)) = (&seen.frame, seen.board()) else { return false };
        self.cameras[camera].is_new_among(&self.placements(camera), frame, detection)
    }

    /// Whether a camera that should share more sees the board held differently than in each of its
    /// shared views, and another camera sees it `simultaneous` with it. A board is often kept while
    /// it still moves, and then nothing is shared where cameras are not synchronized; once it is
    /// held still, it is new to no camera's own lens.
    pub(super) fn is_new(
        self,
        frame_set: &[Option<CameraFrame>],
        usable: &[bool],
        camera: usize,
        simultaneous: impl Fn(usize, usize) -> bool,
    ) -> bool {
        let Some(seen) = &frame_set[camera] else { return false };
        let (frame, Some(detection)) = (&seen.frame, seen.board()) else { return false };
        let other = |other: usize| other != camera && usable[other] && simultaneous(camera, other);
        usable[camera]
            && (0..usable.len()).any(other)
            && self
                .wanted(camera)
                .is_some_and(|shared| self.cameras[camera].is_new_among(&shared, frame, detection))
    }
}

/// What to do next, for the camera that lacks most. `requested` are the two cameras of the
/// suggested shared view; the board is to be moved in the image of the first.
pub(super) fn next_step(members: &[SessionMember], requested: Option<[usize; 2]>) -> String {
    let is_isolated = |(camera, member): &(usize, &SessionMember)| {
        let is_requested = requested.is_some_and(|requested| requested.contains(camera));
        member.views_kept > 2
            && (member.views_shared as usize) < WANTED_SHARED_VIEWS
            && !is_requested
    };
    if let Some((_, isolated)) = members.iter().enumerate().find(is_isolated) {
        return format!(
            "hold the board still where both {} and another camera see the whole board",
            isolated.camera
        );
    }
    if let Some([first, other]) =
        requested.map(|requested| requested.map(|camera| &members[camera]))
    {
        return format!(
            "keep the board in view of {} and {}; in the image of {}: {}",
            first.camera, other.camera, first.camera, first.guidance.message
        );
    }
    let open = members.iter().filter(|member| !member.guidance.message.is_empty());
    let least = open.min_by(|a, b| a.coverage.fraction().total_cmp(&b.coverage.fraction()));
    least
        .map(|member| format!("{}: {}", member.camera, member.guidance.message))
        .unwrap_or_default()
}
