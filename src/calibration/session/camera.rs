//! What one camera of an instrument has gathered in a session: its views, what it needs next, and
//! how far its lens is known.

use crate::calibration::admission::{AdmissionOptions, Rejection, SeenBefore, admit};
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::advise;
use crate::calibration::placement::Placement;
use crate::calibration::running_estimate::{EstimateSoFar, GoingOn};
use crate::calibration::session::action::CameraFrame;
use crate::calibration::session_record::{Finish, SessionMember};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;

/// Fewer views leave the lens undetermined (Zhang, "A flexible new technique for camera
/// calibration", 2000, section 3.3).
pub const LEAST_VIEWS: usize = 3;
/// An uncertainty estimated from fewer views is not worth stopping for, unless the request says so.
const LEAST_VIEWS_FOR_GOAL: u32 = 8;
/// So many frames in a row with the same obstacle, and the operator is told.
const OBSTACLE_FRAMES: u32 = 4;

/// One camera's part of a session.
#[derive(Debug, Clone)]
pub struct CameraPart {
    target: Target,
    summary: SessionMember,
    views: Vec<View>,
    placements: Vec<Placement>,
    before: Option<SeenBefore>,
    last_time_ns: Option<i64>,
    collecting_s: f64,
    obstacle: Option<(Rejection, u32)>,
    going_on: Option<GoingOn>,
    estimating: bool,
    /// A view was kept while an estimate was being made.
    estimate_outdated: bool,
    options: AdmissionOptions,
}

impl CameraPart {
    /// A part without views; `summary` says what came before them.
    pub(super) fn new(target: Target, summary: SessionMember, options: &AdmissionOptions) -> Self {
        let summary = SessionMember {
            views_kept: 0,
            views_shared: 0,
            coverage: Coverage::default(),
            ..summary
        };
        Self {
            target,
            summary,
            views: Vec::new(),
            placements: Vec::new(),
            before: None,
            last_time_ns: None,
            collecting_s: 0.0,
            obstacle: None,
            going_on: None,
            estimating: false,
            estimate_outdated: false,
            options: *options,
        }
    }

    /// What it contributes, as seen from outside; how many views are shared is not its to know.
    pub fn summary(&self) -> &SessionMember {
        &self.summary
    }

    /// The kept views, in order.
    pub fn views(&self) -> &[View] {
        &self.views
    }

    /// The size of its images; `None` before the first view.
    pub fn image_size(&self) -> Option<ImageSize> {
        self.views.first().map(|view| view.frame.image_size)
    }

    /// How the board was held in each view.
    pub(super) fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// What the newest estimate left for the next one to go on from.
    pub fn going_on(&self) -> Option<&GoingOn> {
        self.going_on.as_ref()
    }

    /// Whether an estimate is being made.
    pub fn is_estimating(&self) -> bool {
        self.estimating
    }

    /// Whether it has the views that a lens needs.
    pub(super) fn has_enough(&self) -> bool {
        self.views.len() >= LEAST_VIEWS
    }

    /// Frame time spent collecting, in seconds.
    pub(super) fn collecting_s(&self) -> f64 {
        self.collecting_s
    }

    /// Takes one frame: which view it became, or why it became none.
    pub(super) fn observe(&mut self, seen: &CameraFrame) -> Result<u32, Rejection> {
        self.summary.frames_seen += 1;
        self.count_time(seen.frame.time_ns());
        let admission = self.admit(seen);
        match &admission {
            Ok(_) => self.obstacle = None,
            Err(rejection) => {
                self.summary.rejected.count(rejection);
                self.note_obstacle(rejection);
            }
        }
        self.advise(seen.frame.image_size);
        admission
    }

    /// Whether it would keep `frame` for what was detected in it, if it were observed now.
    pub(super) fn would_keep(&self, frame: &FrameFacts, detection: &Detection) -> bool {
        self.image_size().is_none_or(|expected| expected == frame.image_size)
            && admit(detection, frame, self.before.as_ref(), &self.placements, &self.options)
                .is_ok()
    }

    /// Keeps a detection that teaches this camera nothing new, for what it teaches of the
    /// instrument: another camera saw the board in the same frame set. `None` where it cannot be a
    /// view at all.
    pub(super) fn keep_shared(&mut self, frame: &FrameFacts, detection: &Detection) -> Option<u32> {
        let room = self.views.len() < self.options.view_limit as usize;
        let fits = self.image_size().is_none_or(|expected| expected == frame.image_size);
        let placement = Placement::of(detection, frame.image_size).filter(|_| room && fits)?;
        Some(self.add(frame, detection, placement))
    }

    /// Takes back a view as it was stored. What was admitted once has a placement; one without
    /// would shift the numbers that rejections name.
    pub(super) fn restore(&mut self, view: &View) -> Option<u32> {
        let placement = Placement::of(&view.detection, view.frame.image_size)?;
        Some(self.add(&view.frame, &view.detection, placement))
    }

    /// Whether the views reach the goals of `finish` but for its time.
    pub(super) fn reaches(&self, finish: &Finish) -> bool {
        let kept = self.summary.views_kept;
        match (finish.uncertainty_px, finish.min_views) {
            (None, None) => false,
            (None, Some(least)) => kept >= least.max(LEAST_VIEWS as u32),
            (Some(goal_px), least) => self.summary.estimate.is_some_and(|estimate| {
                estimate.views >= least.unwrap_or(LEAST_VIEWS_FOR_GOAL)
                    && estimate.uncertainty_px.median <= goal_px
            }),
        }
    }

    /// Asks for an estimate: whether one is to be made now. While one is being made the next one
    /// waits for it.
    pub(super) fn request_estimate(&mut self) -> bool {
        if !self.has_enough() {
            return false;
        }
        self.estimate_outdated = self.estimating;
        !std::mem::replace(&mut self.estimating, true)
    }

    /// Takes the estimate that was asked for; one that could not be made leaves the one before.
    /// Whether another one is to be made now, if frames still come.
    pub(super) fn estimated(&mut self, estimate: Option<EstimateSoFar>) {
        self.estimating = false;
        if let Some(EstimateSoFar { running, going_on }) = estimate {
            self.summary.estimate = Some(running);
            self.going_on = going_on;
        }
    }

    /// Whether views were kept since the newest estimate was begun.
    pub(super) fn is_estimate_outdated(&self) -> bool {
        self.estimate_outdated
    }

    /// The camera gives no frames: what comes next is not compared with what came before.
    pub(super) fn lost(&mut self) {
        self.before = None;
        self.last_time_ns = None;
    }

    fn admit(&mut self, seen: &CameraFrame) -> Result<u32, Rejection> {
        let CameraFrame { frame, seen } = seen;
        let detection = seen.as_ref().inspect_err(|_| self.before = None).map_err(Clone::clone)?;
        self.summary.boards_seen += 1;
        let now = SeenBefore { time_ns: frame.time_ns(), detection: detection.clone() };
        let before = self.before.replace(now);
        match self.image_size() {
            Some(expected) if expected != frame.image_size => {
                return Err(Rejection::OtherImageSize { got: frame.image_size, expected });
            }
            _ => {}
        }
        let placement = admit(detection, frame, before.as_ref(), &self.placements, &self.options)?;
        Ok(self.add(frame, detection, placement))
    }

    fn add(&mut self, frame: &FrameFacts, detection: &Detection, placement: Placement) -> u32 {
        let number = self.views.len() as u32;
        if self.views.is_empty() {
            self.summary.coverage = Coverage::empty(frame.image_size);
        }
        self.summary.coverage.add(detection, frame.image_size);
        self.views.push(View { number, frame: frame.clone(), detection: detection.clone() });
        self.placements.push(placement);
        self.summary.views_kept = self.views.len() as u32;
        number
    }

    /// Frame time goes on counting as long as it rises in plausible steps.
    fn count_time(&mut self, time_ns: i64) {
        let last_ns = self.last_time_ns.replace(time_ns);
        let elapsed_s =
            last_ns.map_or(0.0, |last_ns| time_ns.saturating_sub(last_ns) as f64 * 1e-9);
        if (0.0..60.0).contains(&elapsed_s) {
            self.collecting_s += elapsed_s;
        }
    }

    fn note_obstacle(&mut self, rejection: &Rejection) {
        let frames = match &self.obstacle {
            Some((before, frames)) if before.kind() == rejection.kind() => frames + 1,
            _ => 1,
        };
        self.obstacle = Some((rejection.clone(), frames));
    }

    fn advise(&mut self, size: ImageSize) {
        let obstacle = self.obstacle.as_ref();
        let lasting =
            obstacle.filter(|(_, frames)| *frames >= OBSTACLE_FRAMES).map(|(what, _)| what);
        self.summary.guidance =
            advise(&self.target.spanned_chessboard(), size, &self.placements, lasting);
    }
}
