//! What a camera has gathered of a scene in a session without a target: its key frames, what to do
//! next, and how far its lens is known.

use crate::calibration::admission::{AdmissionOptions, Rejection};
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::{Guidance, obstacle};
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::key_frames::{KeyFrame, MOST_KEY_FRAMES, admit_key_frame};
use crate::calibration::scene::so_far::SceneSoFar;
use crate::calibration::session::action::{CameraFrame, FrameContent};
use crate::calibration::session::not_enough::{LEAST_VIEWS, NotEnough};
use crate::calibration::session::progress::{FrameTime, Obstacle};
use crate::calibration::session::scene_steps::{FewKeyFrames, SceneSteps};
use crate::calibration::session_record::{Finish, SessionMember};
use crate::calibration::view::FrameFacts;
use crate::geometry::pixel::ImageSize;

/// An uncertainty estimated from fewer key frames is not worth stopping for, unless the request
/// says so.
const LEAST_KEY_FRAMES_FOR_GOAL: u32 = 6;
/// What to do before the first estimate.
const FIRST_STEP: &str =
    "step sideways, keeping the scene in view, and turn the camera by 90 degrees now and then";

/// One camera's part of a session without a target.
#[derive(Debug, Clone)]
pub struct ScenePart {
    summary: SessionMember,
    key_frames: Vec<KeyFrame>,
    limit: usize,
    time: FrameTime,
    obstacle: Obstacle,
    next_step: String,
    is_trusted: bool,
    steps: SceneSteps,
    estimating: bool,
    /// A key frame was kept while an estimate was being made.
    estimate_outdated: bool,
}

impl ScenePart {
    /// A part without key frames; `summary` says what came before them.
    pub(super) fn new(summary: SessionMember, options: &AdmissionOptions) -> Self {
        let summary = SessionMember {
            views_kept: 0,
            views_shared: 0,
            coverage: Coverage::default(),
            ..summary
        };
        Self {
            summary,
            key_frames: Vec::new(),
            limit: MOST_KEY_FRAMES.min(options.view_limit as usize),
            time: FrameTime::default(),
            obstacle: Obstacle::default(),
            next_step: FIRST_STEP.to_owned(),
            is_trusted: false,
            steps: SceneSteps::default(),
            estimating: false,
            estimate_outdated: false,
        }
    }

    pub(super) fn summary(&self) -> &SessionMember {
        &self.summary
    }

    pub(super) fn key_frames(&self) -> &[KeyFrame] {
        &self.key_frames
    }

    pub(super) fn image_size(&self) -> Option<ImageSize> {
        self.key_frames.first().map(|key| key.image.size)
    }

    pub(super) fn is_estimating(&self) -> bool {
        self.estimating
    }

    pub(super) fn is_estimate_outdated(&self) -> bool {
        self.estimate_outdated
    }

    pub(super) fn collecting_s(&self) -> f64 {
        self.time.elapsed_s()
    }

    /// Takes one frame: which key frame it became, or why it became none.
    pub(super) fn observe(&mut self, seen: &CameraFrame) -> Result<u32, Rejection> {
        self.summary.frames_seen += 1;
        self.time.count(seen.frame.time_ns());
        let admission = self.admit(seen);
        self.obstacle.note(&admission);
        if let Err(rejection) = &admission {
            self.summary.rejected.count(rejection);
        }
        self.advise();
        admission
    }

    fn admit(&mut self, seen: &CameraFrame) -> Result<u32, Rejection> {
        let image = match &seen.seen {
            Ok(FrameContent::Scene(image)) => image,
            // Frames of a session without a board are searched for features only.
            Ok(FrameContent::Board(_)) => return Err(Rejection::NoTexture { features: 0 }),
            Err(rejection) => return Err(rejection.clone()),
        };
        let is_full = self.key_frames.len() >= self.limit;
        let admission = admit_key_frame(image, self.steps.before(), &self.key_frames);
        self.steps.note(image, &admission);
        if let Err(rejection) = admission
            && !self.starts_anew(&rejection)
        {
            // It shows the scene of the key frames.
            self.summary.boards_seen += u64::from(rejection.is_known_already());
            return Err(rejection);
        }
        self.summary.boards_seen += 1;
        if is_full {
            return Err(Rejection::Full { limit: self.limit as u32 });
        }
        Ok(self.add(&seen.frame, image))
    }

    /// Whether a frame that shows nothing of the key frames becomes one nevertheless: there are too
    /// few key frames to solve, most frames show another scene, the operator was asked to go back
    /// and did not, and the frame matches the previous one.
    fn starts_anew(&self, rejection: &Rejection) -> bool {
        let Rejection::UnknownScene { matches } = *rejection else { return false };
        let is_lasting = self.obstacle.lasting().is_some_and(|it| it.kind() == rejection.kind());
        let (unknown, shared) = (self.unknown(), self.summary.boards_seen);
        matches > 0 && is_lasting && unknown > shared && self.key_frames.len() < LEAST_VIEWS
    }

    /// How many frames showed nothing of the key frames.
    fn unknown(&self) -> u64 {
        self.summary.rejected.of("unknown_scene")
    }

    /// Restores a stored key frame.
    pub(super) fn restore(&mut self, frame: &FrameFacts, image: &SceneImage) -> Option<u32> {
        let fits = self.image_size().is_none_or(|size| size == image.size);
        (fits && self.key_frames.len() < self.limit).then(|| self.add(frame, image))
    }

    fn add(&mut self, frame: &FrameFacts, image: &SceneImage) -> u32 {
        let number = self.key_frames.len() as u32;
        if self.key_frames.is_empty() {
            self.summary.coverage = Coverage::empty(image.size);
        }
        self.summary.coverage.add_pixels(image.pixels(), image.size);
        self.key_frames.push(KeyFrame { number, frame: frame.clone(), image: image.clone() });
        self.summary.views_kept = self.key_frames.len() as u32;
        number
    }

    /// Whether the key frames can be solved, or what to do.
    pub(super) fn enough(&self) -> Result<(), NotEnough> {
        let kept = self.key_frames.len();
        if kept >= LEAST_VIEWS {
            return self.check_connected();
        }
        let rejected = |kind: &&str| self.summary.rejected.of(kind);
        let kinds = ["too_similar", "unknown_scene", "no_texture", "other_image_size"];
        let most = kinds.into_iter().max_by_key(rejected);
        let why = match most.filter(|kind| rejected(kind) > 0) {
            Some("too_similar" | "unknown_scene") => {
                self.steps.why_few(rejected(&"too_similar"), self.unknown())
            }
            Some("other_image_size") => FewKeyFrames::SizeChanged,
            Some(_) => FewKeyFrames::NoTexture,
            None => FewKeyFrames::FewImages,
        };
        Err(NotEnough::KeyFrames { kept, why })
    }

    /// Refuses if the key frames are few and most images share nothing with them, as a solve of all
    /// images does: the key frames alone do not show that. With more key frames that share
    /// something, whatever else the camera saw does not matter.
    fn check_connected(&self) -> Result<(), NotEnough> {
        let (unknown, shared) = (self.unknown(), self.summary.boards_seen);
        if unknown <= shared || self.key_frames.len() >= LEAST_KEY_FRAMES_FOR_GOAL as usize {
            return Ok(());
        }
        let (images, why) = (unknown + shared, self.steps.why_unknown());
        Err(NotEnough::UnknownImages { unknown, images, why })
    }

    /// Whether the key frames reach the goals of `finish`, its time limit aside.
    pub(super) fn reaches(&self, finish: &Finish) -> bool {
        if self.check_connected().is_err() {
            return false;
        }
        match (finish.uncertainty_px, finish.min_views) {
            (None, None) => false,
            (None, Some(least)) => self.summary.views_kept >= least.max(LEAST_VIEWS as u32),
            (Some(goal_px), least) => self.summary.estimate.as_ref().is_some_and(|estimate| {
                estimate.views >= least.unwrap_or(LEAST_KEY_FRAMES_FOR_GOAL)
                    && estimate.uncertainty_px.median <= goal_px
                    && self.is_trusted
            }),
        }
    }

    /// Asks for an estimate: whether one is to be made now.
    pub(super) fn request_estimate(&mut self) -> bool {
        if self.key_frames.len() < LEAST_VIEWS {
            return false;
        }
        self.estimate_outdated = self.estimating;
        !std::mem::replace(&mut self.estimating, true)
    }

    /// Takes the estimate that was asked for; `None`, if it was not or could not be made, keeps the
    /// previous one.
    pub(super) fn estimated(&mut self, so_far: Option<SceneSoFar>) {
        self.estimating = false;
        let Some(SceneSoFar { running, is_trusted, next_step }) = so_far else { return };
        if running.is_some() {
            self.summary.estimate = running;
        }
        (self.is_trusted, self.next_step) = (is_trusted, next_step);
        self.advise();
    }

    pub(super) fn lost(&mut self) {
        self.time.lost();
    }

    fn advise(&mut self) {
        let message = self.obstacle.lasting().and_then(obstacle);
        let message = message.unwrap_or_else(|| self.next_step.clone());
        self.summary.guidance = Guidance { message, ..Guidance::default() };
    }
}
