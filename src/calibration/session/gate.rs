//! Whether a frame set may bring a view, decided before the session itself observes it: what is
//! costly (the full search of a tracked board, the other sensors' images) is done for these alone.
//!
//! A gate works with a snapshot of the views that the session had kept. While there is room, views
//! are only added, and each kept view rejects more frames: so a gate lets through all that the
//! session will keep, and little else. A full session exchanges views; then no frame is stopped for
//! resembling a kept view.

use crate::calibration::admission::{AdmissionOptions, PreviousBoard, admit};
use crate::calibration::placement::Placement;
use crate::calibration::session::Session;
use crate::calibration::session::action::CameraFrame;
use crate::calibration::view::FrameFacts;
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;

/// What a session has kept, camera by camera, as far as admission depends on it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KeptViews {
    cameras: Vec<KeptCameraViews>,
}

#[derive(Debug, Clone, PartialEq, Default)]
struct KeptCameraViews {
    image_size: Option<ImageSize>,
    placements: Vec<Placement>,
    /// The placements of views that another camera shares; `None` for a single camera.
    shared: Option<Vec<Placement>>,
}

impl KeptViews {
    /// What `session` has kept by now.
    pub fn of(session: &Session) -> Self {
        let of_camera = |camera: usize| {
            let part = session.camera(camera)?;
            Some(KeptCameraViews {
                image_size: part.image_size(),
                placements: part.placements().to_vec(),
                shared: session.shared_placements(camera),
            })
        };
        Self { cameras: (0..).map_while(of_camera).collect() }
    }
}

fn with_board(seen: &CameraFrame) -> Option<(&FrameFacts, &Detection)> {
    Some((&seen.frame, seen.board()?))
}

/// Decides on each frame set, in their order.
#[derive(Debug, Clone)]
pub struct Gate {
    options: AdmissionOptions,
    /// The previous frame of each camera, if it shows the board.
    before: Vec<Option<PreviousBoard>>,
}

impl Gate {
    /// A gate for a session that begins, or resumes, with its next frame set.
    pub fn new(cameras: usize, options: &AdmissionOptions) -> Self {
        Self { options: *options, before: vec![None; cameras] }
    }

    /// Whether the session may keep something of this frame set, as far as `kept` says.
    pub fn may_keep(&self, frame_set: &[Option<CameraFrame>], kept: &KeptViews) -> bool {
        let none = KeptCameraViews::default();
        let of = |camera: usize| kept.cameras.get(camera).unwrap_or(&none);
        let is_new = |camera: usize, placements: &[Placement]| {
            let Some((frame, detection)) = frame_set[camera].as_ref().and_then(with_board) else {
                return false;
            };
            let before = self.before.get(camera).and_then(Option::as_ref);
            of(camera).image_size.is_none_or(|expected| expected == frame.image_size)
                && admit(detection, frame, before, placements, &self.options).is_ok()
        };
        let may_be_new = |camera: usize, placements: &[Placement]| {
            let is_full = of(camera).placements.len() >= self.options.view_limit as usize;
            is_new(camera, if is_full { &[] } else { placements })
        };
        let seen = frame_set.iter().flatten().filter(|frame| frame.seen.is_ok()).count();
        (0..frame_set.len()).any(|camera| {
            may_be_new(camera, &of(camera).placements)
                || of(camera)
                    .shared
                    .as_ref()
                    .is_some_and(|shared| seen > 1 && may_be_new(camera, shared))
        })
    }

    /// Takes the frame set that the session will observe next.
    pub fn take(&mut self, frame_set: &[Option<CameraFrame>]) {
        for (before, frame) in self.before.iter_mut().zip(frame_set) {
            let Some(seen) = frame else { continue };
            let frame = &seen.frame;
            *before = seen.board().map(|detection| PreviousBoard {
                time_ns: frame.time_ns(),
                detection: detection.clone(),
            });
        }
    }

    /// The camera of this index stopped giving frames: its next frame is not compared with the
    /// previous one.
    pub fn lost(&mut self, camera: usize) {
        if let Some(before) = self.before.get_mut(camera) {
            *before = None;
        }
    }
}
