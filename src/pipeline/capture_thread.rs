//! Thread `capture-<camera>`: owns the source, opens it, reopens it when it is lost, and reports
//! its state.
//!
//! ```text
//! starting ──frame──▶ streaming ──gone, silent──▶ lost ──frame──▶ streaming
//!     └──needs a person──▶ failed (tried again, rarely)
//! ```
//!
//! A replay that waits for its frames to be searched starts again with each session, so that every
//! session gets all of it. While no session collects, it is shown in a loop at its recorded rate.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::capture::{CaptureError, FrameSource, Losses, SourceDescription, SourceOpener};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, FrameSet};
use crate::locks::lock;
use crate::pipeline::camera_status::{CameraIdentity, CameraState, SensorStatus};
use crate::pipeline::captured::{Captured, CapturedFrame};
use crate::pipeline::closing::Closing;
use crate::pipeline::current_calibration::ImagesNow;
use crate::pipeline::frame_rate::FrameRate;
use crate::pipeline::guarded::guarded;
use crate::pipeline::idle_pace::IdlePace;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::message::Message;
use crate::pipeline::search::CameraSearch;
use crate::pipeline::silence::{Silence, SilenceLimits};
use crate::pipeline::supervision::Supervision;

/// The longest time that a source may keep the thread from checking whether to stop.
const FRAME_TIMEOUT: Duration = Duration::from_millis(200);
/// How often a waiting thread checks whether a session began.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Reported of a lost camera whose driver does not return from closing it.
const DRIVER_HOLDS_ON: &str = "; its driver does not release it: unplug it and plug it in again";

/// Why a source is no longer read.
enum End {
    /// The daemon is stopping.
    Stopped,
    /// The source is to be reopened at once.
    Again,
    /// It delivered its last frame, for this session; `cut` is the reason if it ended early.
    Ended { search: Option<Arc<CameraSearch>>, waits: bool, cut: Option<String> },
    /// It is gone, but may come back.
    Lost(String),
    /// It needs a person.
    Failed(String),
}

/// What has become of an opened source.
struct Delivery {
    /// Whether the source waits for its frames to be searched.
    waits: bool,
    /// The rate that it states, in frames a second.
    fps: Option<f64>,
    opened: Instant,
    /// Whether the device's settings are fixed for a session.
    is_held: bool,
    /// When they were last fixed, released or checked.
    checked: Option<Instant>,
    pace: IdlePace,
    has_delivered: bool,
    /// Why its frames ended early.
    cut: Option<String>,
}

impl Delivery {
    fn begin(description: &SourceDescription) -> Self {
        Self {
            waits: description.waits,
            fps: description.fps,
            opened: Instant::now(),
            is_held: false,
            checked: None,
            pace: IdlePace::default(),
            has_delivered: false,
            cut: None,
        }
    }
}

/// The thread that owns a camera's source.
pub(super) struct Capture {
    camera: Arc<LiveCamera>,
    open: Box<dyn SourceOpener>,
    supervision: Supervision,
    /// Whether a silent source counts as lost.
    may_stall: bool,
    silence: Silence,
    rate: FrameRate,
    /// The wait before a lost source is opened again.
    retry: Duration,
    /// Whether the size of its images changed since the last comparison.
    resized: bool,
    /// The time of the last comparison for this reason.
    compared: Option<Instant>,
    /// A source that its driver has not released.
    held: Option<Closing>,
}

impl Capture {
    /// Of a source that is not opened yet; `may_stall` is whether its silence counts as a loss.
    pub(super) fn new(
        camera: Arc<LiveCamera>,
        open: Box<dyn SourceOpener>,
        may_stall: bool,
        supervision: Supervision,
    ) -> Self {
        Self {
            camera,
            open,
            supervision,
            may_stall,
            silence: Silence::default(),
            rate: FrameRate::default(),
            retry: supervision.first_retry,
            resized: false,
            compared: None,
            held: None,
        }
    }

    pub(super) fn run(mut self) {
        while !self.camera.stop.is_set() {
            let mut source = None;
            let end = guarded(|| self.open_and_deliver(&mut source))
                .unwrap_or_else(|fault| End::Lost(fault.to_string()));
            self.rate.forget();
            match end {
                End::Stopped => return self.close(source),
                End::Again => self.close(source),
                End::Ended { search, waits, cut } => {
                    self.close(source);
                    self.rest(search.as_ref(), waits, cut);
                }
                End::Lost(reason) => {
                    self.camera.metrics.lost.with_label_values(&[&self.camera.name]).inc();
                    let retry = self.retry;
                    self.retry = (retry * 2).min(self.supervision.longest_retry);
                    self.wait_out(source, CameraState::Lost, &reason, retry);
                }
                End::Failed(reason) => {
                    let retry = self.supervision.failed_retry;
                    self.wait_out(source, CameraState::Failed, &reason, retry);
                }
            }
        }
    }

    /// Opens the source, stores it in `opened`, and passes its frames on.
    fn open_and_deliver(&mut self, opened: &mut Option<Box<dyn FrameSource>>) -> End {
        let opened_for = self.camera.search.get();
        match self.open.open() {
            Ok(source) => {
                let source = opened.insert(source).as_mut();
                self.camera.metrics.opened.with_label_values(&[&self.camera.name]).inc();
                let description = source.description();
                self.introduce(&description);
                self.deliver(source, &description, opened_for.as_ref())
            }
            Err(CaptureError::Failed { reason }) => End::Failed(reason),
            Err(error) => End::Lost(error.to_string()),
        }
    }

    fn close(&mut self, source: Option<Box<dyn FrameSource>>) {
        let Some(source) = source else { return };
        let closing = Closing::begin(source, &self.camera.name);
        if !closing.is_over(self.supervision.closing) {
            self.held = Some(closing);
        }
    }

    fn introduce(&self, description: &SourceDescription) {
        let SourceDescription { model, serial, bus, identity, mode, factory, .. } =
            description.clone();
        *lock(&self.camera.factory) = factory.clone();
        if let Some(mode) = mode {
            tracing::info!(camera = self.camera.name, "{mode}");
        }
        let bus = bus.or_else(|| (!identity.is_empty()).then_some(identity));
        self.camera.status.send_modify(|status| {
            (status.identity, status.factory) = (CameraIdentity { model, serial, bus }, factory);
        });
    }

    /// Passes frames on until the source has no more.
    fn deliver(
        &mut self,
        source: &mut dyn FrameSource,
        description: &SourceDescription,
        opened_for: Option<&Arc<CameraSearch>>,
    ) -> End {
        let mut delivery = Delivery::begin(description);
        let mut counted = Losses::default();
        self.silence.opened();
        loop {
            if self.camera.stop.is_set() {
                return End::Stopped;
            }
            let search = self.camera.search.get();
            if delivery.is_held != search.is_some() {
                delivery.is_held = search.is_some();
                self.hold_still(source, delivery.is_held);
                delivery.checked = Some(Instant::now());
            }
            if description.waits && search.is_some() && search.as_ref() != opened_for {
                return End::Again;
            }
            source.suggested(self.camera.suggested_pose().as_ref());
            let next = source.next_frame(FRAME_TIMEOUT);
            self.count_losses(source.losses(), &mut counted);
            let flow = match next {
                Ok(frame_set) => self.on_frame(source, &mut delivery, frame_set, search),
                Err(error) => self.on_error(&mut delivery, error, search),
            };
            if let ControlFlow::Break(end) = flow {
                return end;
            }
        }
    }

    fn on_frame(
        &mut self,
        source: &dyn FrameSource,
        delivery: &mut Delivery,
        frame_set: FrameSet,
        search: Option<Arc<CameraSearch>>,
    ) -> ControlFlow<End> {
        self.silence.ended();
        delivery.has_delivered = true;
        if delivery.opened.elapsed() > self.supervision.longest_retry {
            self.retry = self.supervision.first_retry;
        }
        if search.is_none() {
            let is_due = |checked: Instant| checked.elapsed() >= self.supervision.moved_check;
            if delivery.checked.is_some_and(is_due) {
                self.report_moved(source);
                delivery.checked = Some(Instant::now());
            }
            if delivery.waits && self.keep_pace(&mut delivery.pace, &frame_set) {
                return ControlFlow::Continue(());
            }
        }
        if self.pass_on(frame_set, search, delivery.waits) {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(End::Stopped)
        }
    }

    fn on_error(
        &mut self,
        delivery: &mut Delivery,
        error: CaptureError,
        search: Option<Arc<CameraSearch>>,
    ) -> ControlFlow<End> {
        ControlFlow::Break(match error {
            CaptureError::TimedOut { waited } => {
                self.silence.went_on(waited);
                let Supervision { stall, first_frame, .. } = self.supervision;
                let limits = SilenceLimits { stall, first_frame };
                let too_long = self.silence.too_long(limits, delivery.fps);
                let Some(silence) = too_long.filter(|_| self.may_stall) else {
                    return ControlFlow::Continue(());
                };
                End::Lost(format!("no frame for {:.1} s", silence.as_secs_f64()))
            }
            CaptureError::Ended if !delivery.has_delivered => {
                End::Failed("the recording holds no frames".into())
            }
            CaptureError::Ended if delivery.waits && search.is_none() => End::Again,
            CaptureError::Ended => {
                End::Ended { search, waits: delivery.waits, cut: delivery.cut.take() }
            }
            // A recording that was cut short ends at its last readable frame.
            CaptureError::Failed { reason }
                if delivery.has_delivered && !self.may_stall && delivery.cut.is_none() =>
            {
                delivery.cut = Some(reason);
                return ControlFlow::Continue(());
            }
            CaptureError::Failed { reason } => End::Failed(reason),
            error @ CaptureError::Lost { .. } => End::Lost(error.to_string()),
        })
    }

    fn hold_still(&self, source: &mut dyn FrameSource, on: bool) {
        if let Err(error) = source.calibrating(on) {
            let what = if on { "locked for" } else { "released after" };
            tracing::warn!(
                camera = self.camera.name,
                "focus, exposure, gain and white balance could not be {what} a session: {error}"
            );
        }
    }

    /// Reports what has changed since the last session: the calibration may no longer be valid.
    fn report_moved(&self, source: &dyn FrameSource) {
        let moved = source.moved_since_calibrating();
        let before = std::mem::replace(&mut self.camera.images().moved, moved.clone());
        if before == moved {
            return;
        }
        self.camera.compare_calibrations();
        if let Some(moved) = moved {
            let _ = self.camera.messages.blocking_send(Message::Moved(moved));
        }
    }

    fn count_losses(&self, losses: Losses, counted: &mut Losses) {
        self.camera.count_dropped("device", losses.missed.saturating_sub(counted.missed));
        self.camera.count_dropped("damaged", losses.damaged.saturating_sub(counted.damaged));
        *counted = losses;
    }

    /// Waits until a frame that no session waits for is due. Returns whether a session began
    /// meanwhile.
    fn keep_pace(&self, pace: &mut IdlePace, frame_set: &FrameSet) -> bool {
        let mut left = pace.until_due(frame_set);
        while !left.is_zero() {
            if self.camera.search.get().is_some() || self.camera.stop.is_set() {
                return true;
            }
            let step = left.min(POLL_INTERVAL);
            self.camera.stop.wait(step);
            left -= step;
        }
        false
    }

    /// Passes a frame set to the detector. Returns whether the detector still takes frames.
    fn pass_on(
        &mut self,
        frame_set: FrameSet,
        search: Option<Arc<CameraSearch>>,
        waits: bool,
    ) -> bool {
        let arrived = Instant::now();
        self.note(&frame_set, arrived);
        let frame_set = Arc::new(frame_set);
        self.camera.recorder.offer(&frame_set, waits);
        let captured = Captured::Frame(CapturedFrame { frame_set, search, arrived, waits });
        if waits {
            return self.camera.slot.put_waiting(captured).is_ok();
        }
        match self.camera.slot.put_newest(captured) {
            Ok(replaced) => {
                self.camera.count_dropped("overload", u64::from(replaced.is_some()));
                true
            }
            Err(_) => false,
        }
    }

    fn note(&mut self, frame_set: &FrameSet, arrived: Instant) {
        let fps = self.rate.count(arrived);
        self.camera.metrics.frames.with_label_values(&[&self.camera.name]).inc();
        self.camera.status.send_modify(|status| {
            status.frames += 1;
            status.fps = fps;
            // A file that could not be read has no size; this does not make it another sensor.
            let known = |size: ImageSize| size.width > 0 && size.height > 0;
            if frame_set.frames.iter().all(|frame| known(frame.size)) {
                let sensors = frame_set.frames.iter();
                status.sensors = sensors
                    .map(|frame| SensorStatus {
                        kind: frame.sensor,
                        size: frame.size,
                        format: frame.format,
                    })
                    .collect();
            }
        });
        if self.camera.status.borrow().state == CameraState::Streaming {
            self.compare_sizes(&frame_set.frames, arrived);
            return;
        }
        // It may be another device now.
        let mut images = self.camera.images();
        *images = ImagesNow::default();
        images.take_sizes(&frame_set.frames);
        drop(images);
        (self.resized, self.compared) = (false, None);
        self.camera.gives_frames();
        if let Some(search) = self.camera.search.get() {
            search.assembly.back(search.place);
        }
    }

    /// The images of a stream may change their size at any time, those of a folder with every
    /// image. The calibrations are compared again, but not with every frame.
    fn compare_sizes(&mut self, frames: &[Frame], arrived: Instant) {
        self.resized |= self.camera.images().take_sizes(frames);
        let wait = self.supervision.moved_check;
        let is_due = self.compared.is_none_or(|at| arrived.duration_since(at) >= wait);
        if self.resized && is_due {
            (self.resized, self.compared) = (false, Some(arrived));
            self.camera.compare_calibrations();
        }
    }

    /// Reports what is wrong, closes the source, and waits before the next attempt. The time of the
    /// session goes on meanwhile.
    fn wait_out(
        &mut self,
        source: Option<Box<dyn FrameSource>>,
        state: CameraState,
        reason: &str,
        wait: Duration,
    ) {
        let began = Instant::now();
        let was_held = self.is_held();
        // Reported before the source is closed, because the driver may not return from that.
        self.say(state, reason, was_held);
        self.close(source);
        if self.is_held() && !was_held {
            self.say(state, reason, true);
        }
        self.camera.stop.wait(wait);
        if let Some(search) = self.camera.search.get() {
            search.assembly.waited(search.place, began.elapsed().as_secs_f64());
        }
    }

    fn is_held(&self) -> bool {
        self.held.as_ref().is_some_and(|closing| !closing.is_over(Duration::ZERO))
    }

    fn say(&self, state: CameraState, reason: &str, is_held: bool) {
        let reason = &format!("{reason}{}", if is_held { DRIVER_HOLDS_ON } else { "" });
        self.camera.status.send_modify(|status| status.fps = None);
        // A client that is notified of the lost camera already finds its session waiting.
        if let Some(search) = self.camera.search.get() {
            search.assembly.lost(search.place, reason);
        }
        self.camera.set_state(state, Some(reason));
    }

    /// After the last frame: waits for another session to begin. A replay that waits for its frames
    /// is also shown again when the session is over.
    fn rest(&self, ended_for: Option<&Arc<CameraSearch>>, waits: bool, cut: Option<String>) {
        let cut = cut.map(|cut| format!(": {cut}")).unwrap_or_default();
        let reason = format!("the recording has ended{cut}");
        let end = Captured::End { search: ended_for.cloned(), reason: reason.clone() };
        if self.camera.slot.put_waiting(end).is_err() {
            return;
        }
        self.camera.status.send_modify(|status| status.fps = None);
        let until = format!("{reason}; it starts again with the next session");
        self.camera.set_state(CameraState::Failed, Some(&until));
        while !self.camera.stop.wait(POLL_INTERVAL) {
            let search = self.camera.search.get();
            if search.as_ref() != ended_for && (waits || search.is_some()) {
                return;
            }
        }
    }
}
