//! What one camera of an instrument has collected about a board in a session: its views, the next
//! view that it needs, and the uncertainty of its lens.

mod information_gain;

use crate::calibration::admission::{AdmissionOptions, PreviousBoard, Rejection, admit};
use crate::calibration::coverage::Coverage;
use crate::calibration::guidance::obstacle;
use crate::calibration::information::camera_information::{CameraInformation, ViewInformation};
use crate::calibration::information::next_view::SuggestedView;
use crate::calibration::information::projection_goal::GoalFigure;
use crate::calibration::placement::Placement;
use crate::calibration::running_estimate::{Continuation, EstimateSoFar};
use crate::calibration::session::action::CameraFrame;
use crate::calibration::session::advice::{Advice, Now};
use crate::calibration::session::approach::Approach;
use crate::calibration::session::depth_frame::DepthFrame;
use crate::calibration::session::depth_part::{DepthPart, SeenDepth};
use crate::calibration::session::last_rejections::{FrequentRejection, LastRejections};
use crate::calibration::session::not_enough::LEAST_VIEWS;
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
const ARRIVED_EFFORT: f64 = 0.2;

/// The information in a view: about color (`None` where no pose explains it), and about depth.
type AddedInformation = (Option<ViewInformation>, SeenDepth);

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
    information: Option<CameraInformation>,
    /// The board in the newest frame, if it shows one.
    newest: Option<ViewInformation>,
    /// When that frame was taken.
    newest_ns: i64,
    /// The most informative view for this camera; it is requested unless the rig needs another.
    own: Option<SuggestedView>,
    /// That view, or the most informative one for depth if depth is less certain.
    requested: Option<SuggestedView>,
    /// The suggested view is one that another camera should share.
    requests_shared: bool,
    /// What was gathered of its depth, if it has a depth sensor.
    depth: DepthPart,
    advice: Advice,
    before: Option<PreviousBoard>,
    approach: Approach,
    time: FrameTime,
    obstacle: Obstacle,
    last_rejections: LastRejections,
    continuation: Option<Continuation>,
    /// The uncertainty predicted from the views that the newest estimate is made of.
    expected_px: Option<f64>,
    /// How many times greater than predicted the estimated uncertainty is, at least 1.
    uncertainty_ratio: f64,
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
            information: None,
            newest: None,
            newest_ns: 0,
            own: None,
            requested: None,
            requests_shared: false,
            depth: DepthPart::default(),
            advice: Advice::default(),
            before: None,
            approach: Approach::default(),
            time: FrameTime::default(),
            obstacle: Obstacle::default(),
            last_rejections: LastRejections::default(),
            continuation: None,
            expected_px: None,
            uncertainty_ratio: 1.0,
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
    pub fn continuation(&self) -> Option<&Continuation> {
        self.continuation.as_ref()
    }

    /// Whether an estimate is being made.
    pub fn is_estimating(&self) -> bool {
        self.estimating
    }

    /// The information in its views; `None` before the first frame.
    pub(super) fn information(&self) -> Option<&CameraInformation> {
        self.information.as_ref()
    }

    /// Why most frames became no view, unless the reason is that they added no new information.
    pub(super) fn why_rejected(&self) -> Option<FrequentRejection> {
        self.last_rejections.why_most(&self.summary.rejected, self.summary.frames_seen)
    }

    /// The information that the newest frame would add, or added; `None` if it does not show the
    /// board.
    pub(super) fn newest(&self) -> Option<&ViewInformation> {
        self.newest.as_ref()
    }

    /// What a view must add to be kept, relative to the others: [`AdmissionOptions::worth`].
    pub(super) fn worth(&self) -> f64 {
        self.options.worth
    }

    /// The most informative view for this camera.
    pub(super) fn own_suggestion(&self) -> Option<&SuggestedView> {
        self.own.as_ref()
    }

    /// Requests this view instead of its own suggestion; `None` requests its own again.
    pub(super) fn request_shared(&mut self, shared: Option<SuggestedView>) {
        if shared.is_some() || self.requests_shared {
            self.requests_shared = shared.is_some();
            let own = || self.requested.clone();
            self.advice.renew(shared.or_else(own));
            let camera_from_board = self.newest.as_ref().map(|newest| newest.camera_from_board);
            self.advise(self.newest_ns, camera_from_board.as_ref());
        }
    }

    /// How many times greater the solve finds the uncertainty than its views predict, at least 1:
    /// the solve may include what widens it, such as the board's shape or the shutter.
    pub(super) fn uncertainty_ratio(&self) -> f64 {
        self.uncertainty_ratio
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
        let added = seen.board().and_then(|found| self.view_information(&seen.frame, found));
        let camera_from_board = added.as_ref().map(|added| added.camera_from_board);
        self.newest.clone_from(&added);
        self.newest_ns = seen.frame.time_ns();
        let admission = self.admit(seen, added);
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
        let Some(information) = self.information.as_ref().filter(|_| !self.requests_shared) else {
            return;
        };
        let is_there = |there: &_| information.effort(camera_from_board, there) < ARRIVED_EFFORT;
        let there = self.requested.as_ref().map(|there| there.camera_from_board).filter(is_there);
        let Some(there) = there.filter(|_| self.awaited(frame, camera_from_board).is_none()) else {
            return;
        };
        self.information.iter_mut().for_each(|information| information.refuse(there));
        self.suggest();
    }

    /// Whether it would keep `frame` for what was detected in it, if it were observed now.
    pub(super) fn would_keep(&self, frame: &FrameFacts, detection: &Detection) -> bool {
        self.image_size().is_none_or(|expected| expected == frame.image_size)
            && admit(detection, frame, self.before.as_ref(), &self.placements, &self.options)
                .and_then(|placement| {
                    let added = (self.view_information(frame, detection), SeenDepth::default());
                    self.room_for(frame, &placement, &added)
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
        let added = self.view_information_with_depth(frame, detection, seen.depth.as_ref());
        self.summary.rejected.take_back(rejection);
        Some(self.add(frame, detection, placement, added))
    }

    /// Restores a stored view. A view that was admitted has a placement; one without is skipped, as
    /// it would change the numbers that rejections name.
    pub(super) fn restore(&mut self, view: &View, depth: Option<&DepthFrame>) -> Option<u32> {
        let (frame, detection) = (&view.frame, &view.detection);
        let placement = Placement::of(detection, frame.image_size)?;
        self.prepare(frame.image_size);
        let added = self.view_information_with_depth(frame, detection, depth);
        if self.views.len() < self.options.view_limit as usize {
            return Some(self.add(frame, detection, placement, added));
        }
        // Exchanged views are stored too.
        let replaced = self.room_for(frame, &placement, &added).ok().flatten()?;
        Some(self.exchange(replaced, frame, detection, placement, added))
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
                    && self.depth.reaches(goal_px / self.uncertainty_ratio())
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
            self.expected_px = self.information().and_then(CameraInformation::uncertainty_px);
        }
        is_begun
    }

    /// Takes the requested estimate; `None`, if it could not be made, keeps the previous one.
    pub(super) fn estimated(&mut self, estimate: Option<EstimateSoFar>) {
        self.estimating = false;
        let outdated = std::mem::take(&mut self.exchanged);
        if let Some(EstimateSoFar { running, continuation, model_holds }) = estimate {
            // Compared with what the same views predict: one view more may halve either.
            self.uncertainty_ratio = self
                .expected_px
                .map_or(1.0, |expected_px| (running.uncertainty_px.median / expected_px).max(1.0));
            self.summary.estimate = Some(running);
            self.continuation = continuation.filter(|_| !outdated);
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
        if self.information.is_none() && size.width > 0 && size.height > 0 {
            let figure =
                if self.goal_px.is_some() { GoalFigure::Median } else { GoalFigure::Worst };
            self.information = Some(CameraInformation::new(&self.target, size, self.lens, figure));
            self.suggest();
        }
    }

    fn admit(
        &mut self,
        seen: &CameraFrame,
        added: Option<ViewInformation>,
    ) -> Result<u32, Rejection> {
        let CameraFrame { frame, seen, depth } = seen;
        let content = seen.as_ref().inspect_err(|_| self.before = None).map_err(Clone::clone)?;
        // A session with a board has boards searched for, and nothing else.
        let detection = content.board().ok_or(Rejection::NoBoard(NoBoard::NoCorners))?;
        self.summary.boards_seen += 1;
        let now = PreviousBoard { time_ns: frame.time_ns(), detection: detection.clone() };
        let before = self.before.replace(now);
        match self.image_size() {
            Some(expected) if expected != frame.image_size => {
                return Err(Rejection::OtherImageSize { got: frame.image_size, expected });
            }
            _ => {}
        }
        let placement = admit(detection, frame, before.as_ref(), &self.placements, &self.options)?;
        let (color, depth) = (self.information.as_ref(), depth.as_ref());
        let depth = self.depth.seen(&self.target, color, frame, depth, added.as_ref());
        let added = (added, depth);
        Ok(match self.room_for(frame, &placement, &added)? {
            None => self.add(frame, detection, placement, added),
            Some(replaced) => self.exchange(replaced, frame, detection, placement, added),
        })
    }

    /// Replaces a view that adds less information.
    fn exchange(
        &mut self,
        number: u32,
        frame: &FrameFacts,
        detection: &Detection,
        placement: Placement,
        (added, depth): AddedInformation,
    ) -> u32 {
        let at = number as usize;
        self.summary.coverage.add(detection, frame.image_size);
        self.views[at] = View { number, frame: frame.clone(), detection: detection.clone() };
        self.placements[at] = placement;
        // An estimate continues the previous one only if it has all views of that, in order.
        (self.continuation, self.exchanged) = (None, self.estimating);
        if let Some(information) = &mut self.information {
            information.remove(number);
        }
        self.depth.remove(number);
        self.add_view(number, added.map(|added| added.numbered(number)), depth);
        number
    }

    /// Adds the information in a view, and suggests the next view.
    fn add_view(&mut self, number: u32, added: Option<ViewInformation>, depth: SeenDepth) {
        let Some(information) = &mut self.information else { return };
        if let Some(added) = added {
            information.add(added);
            self.depth.add(&self.target, (number, depth), information);
        }
        self.suggest();
    }

    /// Finds the most informative view for this camera, and suggests one.
    fn suggest(&mut self) {
        let goal_px = self.predicted_goal_px();
        self.own = self.information.as_ref().and_then(|information| information.suggest(goal_px));
        self.request();
    }

    /// Requests the most informative view.
    fn request(&mut self) {
        let goal_px = self.predicted_goal_px();
        let Some(information) = &self.information else { return };
        let requested = self.depth.request(information, self.own.as_ref(), goal_px);
        // Even if little is missing, fewer views are not worth stopping for.
        let least = self.least_views.saturating_sub(self.views.len() as u32);
        self.requested = requested.map(|view| SuggestedView {
            views_to_go: view.views_to_go.map(|to_go| to_go.map(|views| views.max(least))),
            ..view
        });
        self.requests_shared = false;
        self.advice.renew(self.requested.clone());
    }

    fn predicted_goal_px(&self) -> Option<f64> {
        self.goal_px.map(|goal_px| goal_px / self.uncertainty_ratio())
    }

    fn add(
        &mut self,
        frame: &FrameFacts,
        detection: &Detection,
        placement: Placement,
        (added, depth): AddedInformation,
    ) -> u32 {
        let number = self.views.len() as u32;
        if self.views.is_empty() {
            self.summary.coverage = Coverage::empty(frame.image_size);
        }
        self.summary.coverage.add(detection, frame.image_size);
        self.views.push(View { number, frame: frame.clone(), detection: detection.clone() });
        self.placements.push(placement);
        self.summary.views_kept = self.views.len() as u32;
        self.add_view(number, added, depth);
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
            halves_disagree: reached && !self.model_holds,
        };
        if let Some(information) = &self.information {
            self.summary.guidance = self.advice.guidance(information, &now);
            let suggested = self.advice.suggested.as_ref();
            let poses = camera_from_board.zip(suggested.map(|it| &it.camera_from_board));
            self.approach.follow(time_ns, poses.map(Into::into), information);
        } else if let Some(message) = now.obstacle.and_then(obstacle) {
            // Without an image there is no other message.
            self.summary.guidance.message = message;
        }
    }
}
