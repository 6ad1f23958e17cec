//! The input and the output of a session.

use std::sync::Arc;

use crate::calibration::admission::Rejection;
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::view::FrameFacts;
use crate::detection::board_detection::Detection;

/// What one camera gave in a frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFrame {
    /// The frame that was searched.
    pub frame: FrameFacts,
    /// What of the session's target is in it, or why nothing is.
    pub seen: Result<FrameContent, Rejection>,
    /// The depth image that was taken with it, where there is one and the frame may be kept.
    pub depth: Option<DepthFrame>,
}

/// What a frame shows of a session's target.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameContent {
    /// The board.
    Board(Arc<Detection>),
    /// Features of a scene.
    Scene(SceneImage),
}

impl FrameContent {
    /// The board, where one was searched for.
    pub fn board(&self) -> Option<&Detection> {
        match self {
            Self::Board(detection) => Some(detection),
            Self::Scene(_) => None,
        }
    }

    /// The features, where they were searched for.
    pub fn scene(&self) -> Option<&SceneImage> {
        match self {
            Self::Board(_) => None,
            Self::Scene(image) => Some(image),
        }
    }
}

impl From<Detection> for FrameContent {
    fn from(detection: Detection) -> Self {
        Self::Board(Arc::new(detection))
    }
}

impl CameraFrame {
    /// The board in it, if it was found.
    pub fn board(&self) -> Option<&Detection> {
        self.seen.as_ref().ok().and_then(FrameContent::board)
    }
}

/// A view that a session kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeptView {
    /// Counts the views of all cameras, from 0.
    pub number: u32,
    /// The camera, as its index in the instrument.
    pub camera: usize,
    /// The frame set; views of the same one were taken together.
    pub frame_set: u32,
    /// Which of the camera's own views it is.
    pub view: u32,
}

/// The actions that the owner of the session has to perform, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Estimate the lens of the camera of this index from its views, and answer with
    /// `Session::estimated`.
    Estimate(usize),
    /// Announce that the record changed in a way the operator should see.
    Announce,
    /// Take no more frames, solve what was gathered, and answer with `Session::solved`.
    Solve,
    /// Store the record for good: the session is over.
    Close,
}

/// What became of a frame set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Observed {
    /// Camera by camera: which of the camera's own views it became, or why it became none; `None`
    /// for a camera that gave no frame.
    pub admissions: Vec<Option<Result<u32, Rejection>>>,
    /// Views to store with the images that were just observed, before anything else is done and
    /// before the next frame set is taken. Only observing a frame set yields any.
    pub kept: Vec<KeptView>,
    /// What to do then.
    pub actions: Vec<Action>,
}
