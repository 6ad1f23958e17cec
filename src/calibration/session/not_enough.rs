//! Why a session's views cannot be solved, and what to do: each reason is a value, put in words
//! where the session ends.

use std::fmt;

use crate::calibration::admission::SIZE_CHANGED;
use crate::calibration::session::camera_wait::CameraWait;
use crate::calibration::session::last_rejections::FrequentRejection;
use crate::calibration::session::scene_steps::{FewKeyFrames, NothingShared};

/// Fewer views leave the lens undetermined (Zhang, "A flexible new technique for camera
/// calibration", 2000, section 3.3); fewer images of a scene do too.
pub const LEAST_VIEWS: usize = 3;

/// Why the views cannot be solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum NotEnough {
    /// Too few views of a board, where most frames were rejected for their size.
    #[error("views kept: {kept}; at least {LEAST_VIEWS} are needed; {SIZE_CHANGED}")]
    SizeChanged { kept: usize },
    /// Too few views of a board.
    #[error(
        "views kept: {kept}; at least {LEAST_VIEWS} are needed; {}start again and show the board in more positions, tilted in different directions",
        clause(rejected.as_ref())
    )]
    Views {
        kept: usize,
        /// Why most frames became no view.
        rejected: Option<FrequentRejection>,
    },
    /// Fewer than two cameras of a rig have enough.
    #[error(
        "views kept: {}; at least two cameras need {LEAST_VIEWS} views each; {}start again and show the board where two cameras see all of it",
        kept.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
        clause(rejected.as_ref())
    )]
    RigViews {
        /// By camera.
        kept: Vec<CameraViews>,
        /// The first camera with too few of which most frames became no view.
        rejected: Option<CameraRejection>,
    },
    /// Too few key frames of a scene.
    #[error("key frames kept: {kept}; at least {LEAST_VIEWS} are needed: {why}")]
    KeyFrames { kept: usize, why: FewKeyFrames },
    /// Most images of a scene share nothing with its few key frames.
    #[error("{unknown} of {images} images share too little with the key frames: {why}")]
    UnknownImages { unknown: u64, images: u64, why: NothingShared },
    /// A camera delivers no frames.
    #[error("still {wait}; {cause}")]
    Waiting { wait: CameraWait, cause: Box<Self> },
    /// The session has collected as long as it may.
    #[error("the time is up: {cause}")]
    TimeUp { cause: Box<Self> },
    /// No frame will come again, for `reason`.
    #[error("{reason}; {cause}")]
    SourceEnded { reason: String, cause: Box<Self> },
}

/// How many views a camera of a rig has kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct CameraViews {
    pub(super) camera: String,
    pub(super) kept: usize,
}

impl fmt::Display for CameraViews {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.camera, self.kept)
    }
}

/// Why most frames of a rig's camera became no view.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CameraRejection {
    pub(super) camera: String,
    pub(super) rejected: FrequentRejection,
}

impl fmt::Display for CameraRejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.camera, self.rejected)
    }
}

/// A reason that goes before the advice, if there is one.
fn clause(reason: Option<&impl fmt::Display>) -> String {
    reason.map_or(String::new(), |reason| format!("{reason}; "))
}
