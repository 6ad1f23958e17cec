//! What one camera of an instrument has collected about a board in a session: its views, the next
//! view that it needs, and the uncertainty of its lens.

mod worth;

use crate::calibration::admission::{AdmissionOptions, Rejection, SeenBefore, admit};
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::obstacle;
use crate::calibration::information::board_in_depth::BoardInDepth;
use crate::calibration::information::next_view::SuggestedView;
use crate::calibration::information::projection_goal::GoalFigure;
use crate::calibration::information::teaching::{TaughtView, Teaching};
use crate::calibration::placement::Placement;
use crate::calibration::running_estimate::{EstimateSoFar, GoingOn};
use crate::calibration::session::action::CameraFrame;
use crate::calibration::session::advice::{Advice, Now};
use crate::calibration::session::approach::Approach;
use crate::calibration::session::depth_part::{DepthFrame, DepthPart};
use crate::calibration::session::ending::LEAST_VIEWS;
use crate::calibration::session::last_rejections::LastRejections;
use crate::calibration::session::progress::{FrameTime, Obstacle};
use crate::calibration::session_record::{Finish, SessionMember, SessionRequest};
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::{Detection, NoBoard};
use crate::estimation::problem::LensChoice;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// An uncertainty estimated from fewer views is not worth stopping for, unless the request says so.
const LEAST_VIEWS_FOR_GOAL: u32 = 8;

/// A board within this effort of the suggested view counts as there: a tenth of its distance, or
/// twelve degrees.
const ARRIVED: f64 = 0.2;

/// The information in a view: about color (`None` where no pose explains it), and about depth.
type Taught = (Option<TaughtView>, BoardInDepth);

/// One camera's part of a session with a board.
#[derive(Debug, Clone)]
pub struct BoardPart {
    target: Target,
    lens: LensChoice,
    goal_px: Option<f64>,
    /// Views to collect at least, whatever uncertainty is reached.
    least_views: u32,
    summary: SessionMember,
    views: Vec<View>,
    placements: Vec<Placement>,
    /// The information in the views; `None` before the first frame gives the image's size.
    teaching: Option<Teaching>,
    /// The board in the newest frame, if it shows one.
    newest: Option<TaughtView>,
    /// When that frame was taken.
    newest_ns: i64,
    /// The most informative view for this camera; it is requested unless the rig needs another.
    own: Option<SuggestedView>,
    /// That view, or the most informative one for depth if depth is less certain.
    requested: Option<SuggestedView>,
    /// The suggested view is one that another camera should share.
    asked_to_share: bool,
    /// What was gathered of its depth, if it has a depth sensor.
    depth: DepthPart,
    advice: Advice,
    before: Option<SeenBefore>,
    approach: Approach,
    time: FrameTime,
    obstacle: Obstacle,
    last_rejections: LastRejections,
    going_on: Option<GoingOn>,
    /// The uncertainty predicted from the views that the newest estimate is made of.
    expected_px: Option<f64>,
    /// How many times greater than predicted the estimated uncertainty is, at least 1.
    harder: f64,
    /// Whether the newest estimate's halves agree.
    model_holds: bool,
    /// A view was exchanged while an estimate was being made: that estimate has a view that is
    /// gone.
    exchanged: bool,
    estimating: bool,
    /// A view was kept while an estimate was being made.
    estimate_outdated: bool,
    options: AdmissionOptions,
}

impl BoardPart {
    /// A part without views; `summary` says what came before them.
    pub(super) fn new(
        target: Target,
        request: &SessionRequest,
        summary: SessionMember,
        options: &AdmissionOptions,
    ) -> Self {
        let summary = SessionMember {
            views_kept: 0,
            views_shared: 0,
            coverage: Coverage::default(),
            ..summary
        };
        Self {
            target,
            lens: request.lens,
            goal_px: request.finish.and_then(|finish| finish.uncertainty_px),
            least_views: (request.finish.and_then(|finish| finish.min_views))
                .unwrap_or(LEAST_VIEWS_FOR_GOAL),
            summary,
            views: Vec::new(),
            placements: Vec::new(),
            teaching: None,
            newest: None,
            newest_ns: 0,
            own: None,
            requested: None,
            asked_to_share: false,
            depth: DepthPart::default(),
            advice: Advice::default(),
            before: None,
            approach: Approach::default(),
            time: FrameTime::default(),
            obstacle: Obstacle::default(),
            last_rejections: LastRejections::default(),
            going_on: None,
            expected_px: None,
            harder: 1.0,
            model_holds: true,
            exchanged: false,
            estimating: false,
            estimate_outdated: false,
            options: *options,
        }
    }

    /// Its part of the session's record. How many of its views are shared is not included.
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

    /// The information in its views; `None` before the first frame.
    pub(super) fn teaching(&self) -> Option<&Teaching> {
        self.teaching.as_ref()
    }

    /// Why most frames became no view, unless the reason is that they added no new information.
    pub(super) fn why_rejected(&self) -> Option<String> {
        self.last_rejections.why_most(&self.summary.rejected, self.summary.frames_seen)
    }

    /// The information that the newest frame would add, or added; `None` if it does not show the
    /// board.
    pub(super) fn newest(&self) -> Option<&TaughtView> {
        self.newest.as_ref()
    }

    /// The information that a view must add to be kept, as [`AdmissionOptions::worth`].
    pub(super) fn worth(&self) -> f64 {
        self.options.worth
    }

    /// The most informative view for this camera.
    pub(super) fn own_suggestion(&self) -> Option<&SuggestedView> {
        self.own.as_ref()
    }

    /// Requests this view instead of its own suggestion; `None` requests its own again.
    pub(super) fn ask_for(&mut self, shared: Option<SuggestedView>) {
        if shared.is_some() || self.asked_to_share {
            self.asked_to_share = shared.is_some();
            let own = || self.requested.clone();
            self.advice.renew(shared.or_else(own));
            let camera_from_board = self.newest.as_ref().map(|newest| newest.camera_from_board);
            self.advise(self.newest_ns, camera_from_board.as_ref());
        }
    }

    /// How many times greater the solve finds the uncertainty than its views predict, at least 1:
    /// the solve may include what widens it, such as the board's shape or the shutter.
    pub(super) fn harder(&self) -> f64 {
        self.harder
    }

    /// Whether it has the views that a lens needs.
    pub(super) fn has_enough(&self) -> bool {
        self.views.len() >= LEAST_VIEWS
    }

    /// Frame time spent collecting, in seconds.
    pub(super) fn collecting_s(&self) -> f64 {
        self.time.elapsed_s()
    }

    /// Takes one frame: which view it became, or why it became none.
    pub(super) fn observe(&mut self, seen: &CameraFrame) -> Result<u32, Rejection> {
        self.summary.frames_seen += 1;
        self.time.count(seen.frame.time_ns());
        self.prepare(seen.frame.image_size);
        let taught = seen.board().and_then(|found| self.taught(&seen.frame, found));
        let camera_from_board = taught.as_ref().map(|taught| taught.camera_from_board);
        self.newest.clone_from(&taught);
        self.newest_ns = seen.frame.time_ns();
        let admission = self.admit(seen, taught);
        let is_known = admission.as_ref().is_err_and(Rejection::is_known_already);
        if let (true, Some(camera_from_board)) = (is_known, &camera_from_board) {
            self.refuse(&seen.frame, camera_from_board);
        }
        self.obstacle.note(&admission);
        self.last_rejections.note(&admission);
        if let Err(rejection) = &admission {
            self.summary.rejected.count(rejection);
        }
        self.advise(seen.frame.time_ns(), camera_from_board.as_ref());
        admission
    }

    /// A frame was rejected because it adds too little information. If the board rests about where
    /// it was requested, showing it there again would not help: another view is requested.
    fn refuse(&mut self, frame: &FrameFacts, camera_from_board: &Pose) {
        let Some(teaching) = self.teaching.as_ref().filter(|_| !self.asked_to_share) else {
            return;
        };
        let asked = self.requested.as_ref().map(|asked| asked.camera_from_board);
        let asked = asked.filter(|asked| teaching.effort(camera_from_board, asked) < ARRIVED);
        let Some(asked) = asked.filter(|_| self.awaited(frame, camera_from_board).is_none()) else {
            return;
        };
        self.teaching.iter_mut().for_each(|teaching| teaching.refuse(asked));
        self.suggest();
    }

    /// Whether it would keep `frame` for what was detected in it, if it were observed now.
    pub(super) fn would_keep(&self, frame: &FrameFacts, detection: &Detection) -> bool {
        self.image_size().is_none_or(|expected| expected == frame.image_size)
            && admit(detection, frame, self.before.as_ref(), &self.placements, &self.options)
                .and_then(|placement| {
                    let taught = (self.taught(frame, detection), BoardInDepth::default());
                    self.room_for(frame, &placement, &taught)
                })
                .is_ok()
    }

    /// Whether it has room for a detection that is unlike each of `placements`.
    pub(super) fn is_new_among(
        &self,
        placements: &[Placement],
        frame: &FrameFacts,
        detection: &Detection,
    ) -> bool {
        self.views.len() < self.options.view_limit as usize
            && admit(detection, frame, self.before.as_ref(), placements, &self.options).is_ok()
    }

    /// Keeps a detection that adds no new information about this camera, for its information about
    /// the instrument: another camera saw the board in the same frame set. `None` where it cannot
    /// be a view at all.
    pub(super) fn keep_shared(&mut self, seen: &CameraFrame, rejection: &Rejection) -> Option<u32> {
        let (frame, detection) = (&seen.frame, seen.board()?);
        let room = self.views.len() < self.options.view_limit as usize;
        let fits = self.image_size().is_none_or(|expected| expected == frame.image_size);
        let placement = Placement::of(detection, frame.image_size).filter(|_| room && fits)?;
        let taught = self.taught_by(frame, detection, seen.depth.as_ref());
        self.summary.rejected.take_back(rejection);
        Some(self.add(frame, detection, placement, taught))
    }

    /// Restores a stored view. A view that was admitted has a placement; one without is skipped, as
    /// it would change the numbers that rejections name.
    pub(super) fn restore(&mut self, view: &View, depth: Option<&DepthFrame>) -> Option<u32> {
        let (frame, detection) = (&view.frame, &view.detection);
        let placement = Placement::of(detection, frame.image_size)?;
        self.prepare(frame.image_size);
        let taught = self.taught_by(frame, detection, depth);
        if self.views.len() < self.options.view_limit as usize {
            return Some(self.add(frame, detection, placement, taught));
        }
        // Exchanged views are stored too.
        let replaced = self.room_for(frame, &placement, &taught).ok().flatten()?;
        Some(self.exchange(replaced, frame, detection, placement, taught))
    }

    /// Whether the views reach the goals of `finish`, its time limit aside.
    pub(super) fn reaches(&self, finish: &Finish) -> bool {
        let kept = self.summary.views_kept;
        match (finish.uncertainty_px, finish.min_views) {
            (None, None) => false,
            (None, Some(least)) => kept >= least.max(LEAST_VIEWS as u32),
            (Some(goal_px), _) => self.summary.estimate.as_ref().is_some_and(|estimate| {
                estimate.views >= self.least_views
                    && estimate.uncertainty_px.median <= goal_px
                    && self.model_holds
                    && self.depth.reaches(goal_px / self.harder())
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
        let is_begun = !std::mem::replace(&mut self.estimating, true);
        if is_begun {
            self.expected_px = self.teaching.as_ref().and_then(Teaching::uncertainty_px);
        }
        is_begun
    }

    /// Takes the requested estimate; `None`, if it could not be made, keeps the previous one.
    pub(super) fn estimated(&mut self, estimate: Option<EstimateSoFar>) {
        self.estimating = false;
        let outdated = std::mem::take(&mut self.exchanged);
        if let Some(EstimateSoFar { running, going_on, model_holds }) = estimate {
            // Compared with what the same views predict: one view more may halve either.
            self.harder = self
                .expected_px
                .map_or(1.0, |expected_px| (running.uncertainty_px.median / expected_px).max(1.0));
            self.summary.estimate = Some(running);
            self.going_on = going_on.filter(|_| !outdated);
            self.model_holds = model_holds;
        }
    }

    /// Whether views were kept since the newest estimate was begun.
    pub(super) fn is_estimate_outdated(&self) -> bool {
        self.estimate_outdated
    }

    /// The camera stopped giving frames: the next frame is not compared with the previous one.
    pub(super) fn lost(&mut self) {
        self.before = None;
        self.time.lost();
    }

    /// Sets up what depends on the image size, once a frame has one.
    fn prepare(&mut self, size: ImageSize) {
        if self.teaching.is_none() && size.width > 0 && size.height > 0 {
            let figure =
                if self.goal_px.is_some() { GoalFigure::Median } else { GoalFigure::Worst };
            let teaching = Teaching::new(&self.target, size, self.lens, figure);
            self.teaching = Some(teaching);
            self.suggest();
        }
    }

    fn admit(&mut self, seen: &CameraFrame, taught: Option<TaughtView>) -> Result<u32, Rejection> {
        let CameraFrame { frame, seen, depth } = seen;
        let content = seen.as_ref().inspect_err(|_| self.before = None).map_err(Clone::clone)?;
        // A session with a board has boards searched for, and nothing else.
        let detection = content.board().ok_or(Rejection::NoBoard(NoBoard::NoCorners))?;
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
        let depth = (frame, depth.as_ref(), taught.as_ref());
        let depth = self.depth.seen(&self.target, self.teaching.as_ref(), depth);
        let taught = (taught, depth);
        Ok(match self.room_for(frame, &placement, &taught)? {
            None => self.add(frame, detection, placement, taught),
            Some(replaced) => self.exchange(replaced, frame, detection, placement, taught),
        })
    }

    /// Replaces a view that adds less information.
    fn exchange(
        &mut self,
        number: u32,
        frame: &FrameFacts,
        detection: &Detection,
        placement: Placement,
        (taught, depth): Taught,
    ) -> u32 {
        let at = number as usize;
        self.summary.coverage.add(detection, frame.image_size);
        self.views[at] = View { number, frame: frame.clone(), detection: detection.clone() };
        self.placements[at] = placement;
        // An estimate starts from the previous one only if it has the same views.
        (self.going_on, self.exchanged) = (None, self.estimating);
        if let Some(teaching) = &mut self.teaching {
            teaching.remove(number);
        }
        self.depth.remove(number);
        self.teach(number, taught.map(|taught| taught.numbered(number)), depth);
        number
    }

    /// Adds the information in a view, and suggests the next view.
    fn teach(&mut self, number: u32, taught: Option<TaughtView>, depth: BoardInDepth) {
        let Some(teaching) = &mut self.teaching else { return };
        if let Some(taught) = taught {
            teaching.add(taught);
            self.depth.add(number, depth, teaching);
        }
        self.suggest();
    }

    /// Finds the most informative view for this camera, and suggests one.
    fn suggest(&mut self) {
        let goal_px = self.harder_goal_px();
        self.own = self.teaching.as_ref().and_then(|teaching| teaching.suggest(goal_px));
        self.request();
    }

    /// Requests the most informative view.
    fn request(&mut self) {
        let goal_px = self.harder_goal_px();
        let Some(teaching) = &self.teaching else { return };
        let requested = self.depth.request(teaching, self.own.as_ref(), goal_px);
        // Even if little is missing, fewer views are not worth stopping for.
        let least = self.least_views.saturating_sub(self.views.len() as u32);
        self.requested = requested.map(|view| SuggestedView {
            views_to_go: view.views_to_go.map(|to_go| to_go.map(|views| views.max(least))),
            ..view
        });
        self.asked_to_share = false;
        self.advice.renew(self.requested.clone());
    }

    fn harder_goal_px(&self) -> Option<f64> {
        self.goal_px.map(|goal_px| goal_px / self.harder())
    }

    fn add(
        &mut self,
        frame: &FrameFacts,
        detection: &Detection,
        placement: Placement,
        (taught, depth): Taught,
    ) -> u32 {
        let number = self.views.len() as u32;
        if self.views.is_empty() {
            self.summary.coverage = Coverage::empty(frame.image_size);
        }
        self.summary.coverage.add(detection, frame.image_size);
        self.views.push(View { number, frame: frame.clone(), detection: detection.clone() });
        self.placements.push(placement);
        self.summary.views_kept = self.views.len() as u32;
        self.teach(number, taught, depth);
        number
    }

    fn advise(&mut self, time_ns: i64, camera_from_board: Option<&Pose>) {
        let estimate = self.summary.estimate.as_ref();
        let reached = self
            .goal_px
            .zip(estimate)
            .is_some_and(|(goal_px, estimate)| estimate.uncertainty_px.median <= goal_px);
        let now = Now {
            time_ns,
            camera_from_board,
            obstacle: self.obstacle.lasting(),
            room: self.options.view_limit.saturating_sub(self.summary.views_kept),
            goal_px: self.goal_px,
            in_doubt: reached && !self.model_holds,
        };
        if let Some(teaching) = &self.teaching {
            self.summary.guidance = self.advice.guidance(teaching, &now);
            let suggested = self.advice.suggested.as_ref();
            let poses = camera_from_board.zip(suggested.map(|it| &it.camera_from_board));
            self.approach.follow(time_ns, poses.map(Into::into), teaching);
        } else if let Some(message) = now.obstacle.and_then(obstacle) {
            // Without an image there is no other message.
            self.summary.guidance.message = message;
        }
    }
}
