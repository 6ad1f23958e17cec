//! What one camera of an instrument has gathered in a session, of a board or of a scene.

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::information::next_view::SuggestedView;
use crate::calibration::placement::Placement;
use crate::calibration::running_estimate::{Continuation, EstimateSoFar};
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::key_frames::KeyFrame;
use crate::calibration::scene::so_far::SceneSoFar;
use crate::calibration::session::action::CameraFrame;
use crate::calibration::session::board_part::BoardPart;
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::session::not_enough::{LEAST_VIEWS, NotEnough};
use crate::calibration::session::scene_part::ScenePart;
use crate::calibration::session_record::{Finish, SessionMember, SessionRequest};
use crate::calibration::target::CalibrationTarget;
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;

/// One camera's part of a session.
#[derive(Debug, Clone)]
pub enum CameraPart {
    /// Of a session with a board.
    Board(Box<BoardPart>),
    /// Of a session without.
    Scene(Box<ScenePart>),
}

/// The same of either kind.
macro_rules! of_either {
    ($part:expr, $name:ident => $value:expr) => {
        match $part {
            CameraPart::Board($name) => $value,
            CameraPart::Scene($name) => $value,
        }
    };
}

impl CameraPart {
    /// A part without views; `summary` says what came before them.
    pub(super) fn new(
        request: &SessionRequest,
        summary: SessionMember,
        options: &AdmissionOptions,
    ) -> Self {
        match request.target {
            CalibrationTarget::Board(target) => {
                Self::Board(Box::new(BoardPart::new(target, request, summary, options)))
            }
            CalibrationTarget::Scene => Self::Scene(Box::new(ScenePart::new(summary, options))),
        }
    }

    /// The part, of a session with a board.
    pub(super) fn board(&self) -> Option<&BoardPart> {
        match self {
            Self::Board(board) => Some(board),
            Self::Scene(_) => None,
        }
    }

    /// Requests this view instead of the most informative one for its own lens; `None` requests
    /// that one again.
    pub(super) fn request_shared(&mut self, shared: Option<SuggestedView>) {
        if let Self::Board(board) = self {
            board.request_shared(shared);
        }
    }

    /// Its part of the session's record. How many of its views are shared is not included.
    pub fn summary(&self) -> &SessionMember {
        of_either!(self, part => part.summary())
    }

    /// The kept views of a board, in order.
    pub fn views(&self) -> &[View] {
        self.board().map_or(&[], BoardPart::views)
    }

    /// The kept views of a scene, in order.
    pub fn key_frames(&self) -> &[KeyFrame] {
        match self {
            Self::Board(_) => &[],
            Self::Scene(scene) => scene.key_frames(),
        }
    }

    /// The size of its images; `None` before the first view.
    pub fn image_size(&self) -> Option<ImageSize> {
        of_either!(self, part => part.image_size())
    }

    /// How the board was held in each view.
    pub(super) fn placements(&self) -> &[Placement] {
        self.board().map_or(&[], BoardPart::placements)
    }

    /// What the newest estimate left for the next one to go on from.
    pub fn continuation(&self) -> Option<&Continuation> {
        self.board().and_then(BoardPart::continuation)
    }

    /// Whether an estimate is being made.
    pub fn is_estimating(&self) -> bool {
        of_either!(self, part => part.is_estimating())
    }

    /// How many views it has.
    pub(super) fn kept(&self) -> usize {
        self.views().len() + self.key_frames().len()
    }

    /// Whether it has the views that a lens needs.
    pub(super) fn has_enough(&self) -> bool {
        self.kept() >= LEAST_VIEWS
    }

    /// Whether its views can be solved, or what to do.
    pub(super) fn enough(&self) -> Result<(), NotEnough> {
        match self {
            Self::Scene(scene) => scene.enough(),
            Self::Board(_) if self.has_enough() => Ok(()),
            Self::Board(board) => {
                let kept = board.views().len();
                Err(match board.summary().rejected.most_frequent() {
                    Some("other_image_size") => NotEnough::SizeChanged { kept },
                    _ => NotEnough::Views { kept, rejected: board.why_rejected() },
                })
            }
        }
    }

    /// Frame time spent collecting, in seconds.
    pub(super) fn collecting_s(&self) -> f64 {
        of_either!(self, part => part.collecting_s())
    }

    /// Takes one frame: which view it became, or why it became none.
    pub(super) fn observe(&mut self, seen: &CameraFrame) -> Result<u32, Rejection> {
        of_either!(self, part => part.observe(seen))
    }

    /// Whether it would keep `frame` for the board that was detected in it, if it were observed
    /// now.
    pub(super) fn would_keep(&self, frame: &FrameFacts, detection: &Detection) -> bool {
        self.board().is_some_and(|board| board.would_keep(frame, detection))
    }

    /// Whether it has room for a detection that is unlike each of `placements`.
    pub(super) fn is_new_among(
        &self,
        placements: &[Placement],
        frame: &FrameFacts,
        detection: &Detection,
    ) -> bool {
        self.board().is_some_and(|board| board.is_new_among(placements, frame, detection))
    }

    /// Keeps a detection that adds no new information about this camera, for its information about
    /// the instrument: another camera saw the board in the same frame set. `None` where it cannot
    /// be a view at all.
    pub(super) fn keep_shared(&mut self, seen: &CameraFrame, rejection: &Rejection) -> Option<u32> {
        match self {
            Self::Board(board) => board.keep_shared(seen, rejection),
            Self::Scene(_) => None,
        }
    }

    /// Takes back a view of a board as it was stored, with the depth that was taken with it.
    pub(super) fn restore(&mut self, view: &View, depth: Option<&DepthFrame>) -> Option<u32> {
        match self {
            Self::Board(board) => board.restore(view, depth),
            Self::Scene(_) => None,
        }
    }

    /// Takes back a view of a scene as it was stored.
    pub(super) fn restore_key_frame(
        &mut self,
        frame: &FrameFacts,
        image: &SceneImage,
    ) -> Option<u32> {
        match self {
            Self::Board(_) => None,
            Self::Scene(scene) => scene.restore(frame, image),
        }
    }

    /// Whether the views reach the goals of `finish`, its time limit aside.
    pub(super) fn reaches(&self, finish: &Finish) -> bool {
        of_either!(self, part => part.reaches(finish))
    }

    /// Asks for an estimate: whether one is to be made now. While one is being made the next one
    /// waits for it.
    pub(super) fn request_estimate(&mut self) -> bool {
        of_either!(self, part => part.request_estimate())
    }

    /// Takes the requested estimate; `None`, if it could not be made, keeps the previous one.
    pub(super) fn estimated(&mut self, estimate: Option<EstimateSoFar>) {
        match self {
            Self::Board(board) => board.estimated(estimate),
            Self::Scene(scene) => scene.estimated(None),
        }
    }

    /// The same of a scene.
    pub(super) fn scene_estimated(&mut self, so_far: Option<SceneSoFar>) {
        match self {
            Self::Board(board) => board.estimated(None),
            Self::Scene(scene) => scene.estimated(so_far),
        }
    }

    /// Whether views were kept since the newest estimate was begun.
    pub(super) fn is_estimate_outdated(&self) -> bool {
        of_either!(self, part => part.is_estimate_outdated())
    }

    /// The camera stopped giving frames: the next frame is not compared with the previous one.
    pub(super) fn lost(&mut self) {
        of_either!(self, part => part.lost());
    }
}
