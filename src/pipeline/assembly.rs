//! Combines the frames of an instrument's cameras while a session collects: frames taken at about
//! the same time become one frame set. Those that may be kept are searched in full before the
//! session gets them. For an instrument of one camera, each frame is a frame set by itself.
//!
//! It has no thread of its own: the detection thread that completes a frame set also finishes it.
//! Only frames that still lack the frames of other cameras wait here, at most
//! [`MOST_WAITING_FRAMES`] of each camera. A live camera never waits: frame sets are made without a
//! lost camera, and without a late one once another camera's queue exceeds the limit. Replays that
//! must not skip frames wait for each other, so that their results are reproducible.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;

#[cfg(test)]
use super::sync::testing;
use super::sync::{Condvar, Mutex, MutexGuard, lock, unpoisoned};
use crate::calibration::admission::AdmissionOptions;
use crate::calibration::session::CameraFrame;
use crate::calibration::session::gate::{Gate, KeptViews};
use crate::calibration::target::CalibrationTarget;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::SensorKind;
use crate::pipeline::board_search::BoardSearch;
use crate::pipeline::message::{Message, SeenFrameSet};
use crate::pipeline::metrics::Metrics;
use crate::pipeline::seen::SeenFrame;

/// How many frames of one camera may wait for those of the others; with more, frame sets are made
/// without the others. Half a second at 30 frames a second.
const MOST_WAITING_FRAMES: usize = 16;
/// The largest time between images of one frame set, in nanoseconds: a little more than the
/// interval between frames at 30 a second.
const TOGETHER_NS: i64 = 40_000_000;
/// Images that are nearer in time than this belong to one frame set, whatever arrives later, in
/// nanoseconds.
const SAME_TIME_NS: i64 = 500_000;
/// How long a replay waits for another camera.
const REPLAY_TIMEOUT: Duration = Duration::from_secs(5);

/// Combines the frames of a session's cameras.
#[derive(Debug)]
pub(super) struct Assembly {
    /// The session that they are for.
    pub(super) session: String,
    /// What is searched for.
    pub(super) target: CalibrationTarget,
    instrument: String,
    messages: mpsc::Sender<Message>,
    metrics: Arc<Metrics>,
    queues: Mutex<Queues>,
    changed: Condvar,
    /// Held by the one thread that finishes frame sets, so that they stay in order.
    finishing: Mutex<Finishing>,
    kept: Mutex<Arc<KeptViews>>,
}

#[derive(Debug)]
struct Finishing {
    gate: Gate,
    search: BoardSearch,
    /// What each camera's device states about its sensors.
    factories: Vec<SharedFactory>,
}

/// What a device states about its sensors, as of the last time it was opened.
pub(super) type SharedFactory = Arc<Mutex<FactoryCalibration>>;

/// The frames that wait.
#[derive(Debug)]
struct Queues {
    cameras: Vec<CameraQueue>,
    /// Live frames are not taken for now.
    held: bool,
    closed: bool,
}

#[derive(Debug, Default)]
struct CameraQueue {
    frames: VecDeque<SeenFrame>,
    /// Why there will be no more frames.
    ended: Option<String>,
    /// Why there are no frames for now.
    lost: Option<String>,
}

/// The session that the frames are for.
#[derive(Debug)]
pub(super) struct AssemblyPlan {
    pub(super) session: String,
    pub(super) target: CalibrationTarget,
    pub(super) instrument: String,
    /// What each camera's device states about its sensors, in the instrument's order.
    pub(super) factories: Vec<SharedFactory>,
    pub(super) admission: AdmissionOptions,
}

impl Assembly {
    pub(super) fn new(
        plan: AssemblyPlan,
        messages: mpsc::Sender<Message>,
        metrics: Arc<Metrics>,
    ) -> Self {
        let AssemblyPlan { session, target, instrument, factories, admission } = plan;
        let cameras = factories.len();
        let mut queues = Vec::new();
        queues.resize_with(cameras, CameraQueue::default);
        let gate = Gate::new(cameras, &admission);
        Self {
            session,
            target,
            instrument,
            messages,
            metrics,
            queues: Mutex::new(Queues { cameras: queues, held: false, closed: false }),
            changed: Condvar::new(),
            finishing: Mutex::new(Finishing { gate, search: BoardSearch::default(), factories }),
            kept: Mutex::default(),
        }
    }

    /// Takes a frame of the camera at `place`, and passes on the frame sets that it completes. A
    /// frame whose source waits for it waits until there is room.
    ///
    /// Returns whether it was taken: live frames are not taken while the session is held.
    pub(super) fn put(&self, place: usize, frame: SeenFrame) -> bool {
        {
            let mut queues = self.lock();
            if frame.waits {
                queues = self.wait_for_room(queues, place);
            }
            if queues.held && !frame.waits {
                return false;
            }
            if let Some(queue) = queues.open_queue(place) {
                queue.frames.push_back(frame);
            }
        }
        self.pass_on();
        true
    }

    /// The camera at `place` has given its last frame.
    pub(super) fn ended(&self, place: usize, reason: &str) {
        if let Some(queue) = self.lock().open_queue(place) {
            queue.ended = Some(reason.to_owned());
        }
        self.pass_on();
    }

    /// The camera at `place` delivers no frames for now.
    pub(super) fn lost(&self, place: usize, reason: &str) {
        if let Some(queue) = self.lock().open_queue(place) {
            queue.lost = Some(reason.to_owned());
        }
        self.pass_on();
        lock(&self.finishing).gate.lost(place);
        self.send(Message::CameraLost { place, reason: reason.to_owned() });
    }

    /// The camera at `place` delivers frames again.
    pub(super) fn back(&self, place: usize) {
        let mut queues = self.lock();
        if let Some(queue) = queues.open_queue(place) {
            queue.lost = None;
        }
        let other = queues.cameras.iter().enumerate();
        let other = other.filter_map(|(place, queue)| Some((place, queue.lost.clone()?))).next();
        drop(queues);
        self.send(match other {
            Some((place, reason)) => Message::CameraLost { place, reason },
            None => Message::CamerasBack,
        });
    }

    /// The camera at `place` has delivered no frame for this many seconds. They count for the
    /// session if no camera delivers any.
    pub(super) fn waited(&self, place: usize, seconds: f64) {
        let all_lost = self.lock().cameras.iter().all(|queue| queue.lost.is_some());
        if place == 0 && all_lost {
            // If the queue is full, this time is not counted, which does no harm.
            let _ = self.messages.try_send(Message::Waited(seconds));
        }
    }

    /// What the session has kept so far.
    pub(super) fn set_kept(&self, kept: KeptViews) {
        *lock(&self.kept) = Arc::new(kept);
    }

    /// Takes no live frames, and makes replays wait, until it is called with `false`.
    pub(super) fn hold(&self, held: bool) {
        self.lock().held = held;
        self.changed.notify_all();
    }

    /// Takes no frames any more, and wakes all threads that wait.
    pub(super) fn close(&self) {
        let mut queues = self.lock();
        queues.closed = true;
        queues.cameras.iter_mut().for_each(|queue| queue.frames.clear());
        self.changed.notify_all();
    }

    fn wait_for_room<'a>(
        &self,
        mut queues: MutexGuard<'a, Queues>,
        place: usize,
    ) -> MutexGuard<'a, Queues> {
        while queues.held && !queues.closed {
            queues = unpoisoned(self.changed.wait(queues));
        }
        let full = |queues: &mut Queues| {
            queues.open_queue(place).is_some_and(|queue| queue.frames.len() >= MOST_WAITING_FRAMES)
        };
        let waited = self.changed.wait_timeout_while(queues, REPLAY_TIMEOUT, full);
        unpoisoned(waited).0
    }

    /// Finishes the complete frame sets, in order.
    fn pass_on(&self) {
        let mut finishing = lock(&self.finishing);
        loop {
            let Some(frames) = self.lock().take_frame_set() else { break };
            self.changed.notify_all();
            if frames.len() > 1 {
                let is_whole = frames.iter().all(Option::is_some).to_string();
                let labels = [self.instrument.as_str(), is_whole.as_str()];
                self.metrics.frame_sets.with_label_values(&labels).inc();
            }
            let kept = Arc::clone(&lock(&self.kept));
            let seen = finishing.finish(frames, &self.target, &kept);
            self.send(Message::Seen(Box::new(seen), self.session.clone()));
        }
        let end = self.lock().take_end();
        if let Some(reason) = end {
            self.send(Message::Ended { session: self.session.clone(), reason });
        }
    }

    fn send(&self, message: Message) {
        if self.messages.blocking_send(message).is_err() {
            self.close();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queues> {
        lock(&self.queues)
    }
}

impl Finishing {
    /// Searches every image of a frame set that the session may keep.
    fn finish(
        &mut self,
        mut frames: Vec<Option<SeenFrame>>,
        target: &CalibrationTarget,
        kept: &KeptViews,
    ) -> SeenFrameSet {
        let mut observed = observed(&frames, &self.factories);
        if let CalibrationTarget::Board(board) = target
            && self.gate.may_keep(&observed, kept)
        {
            for (seen, factory) in frames.iter_mut().zip(&self.factories) {
                let encoding = lock(factory).depth_encoding;
                if let Some(seen) = seen.as_mut().filter(|seen| seen.detection.board().is_some()) {
                    self.search.observe_all(seen, board, encoding);
                }
            }
            observed = self::observed(&frames, &self.factories);
        }
        self.gate.take(&observed);
        SeenFrameSet { frames, observed }
    }
}

fn observed(frames: &[Option<SeenFrame>], factories: &[SharedFactory]) -> Vec<Option<CameraFrame>> {
    let of_one = |(seen, factory): (&Option<SeenFrame>, &SharedFactory)| {
        let factory = lock(factory);
        Some(seen.as_ref()?.to_camera_frame(factory.sensor(SensorKind::Depth)))
    };
    frames.iter().zip(factories).map(of_one).collect()
}

impl Queues {
    fn open_queue(&mut self, place: usize) -> Option<&mut CameraQueue> {
        if self.closed { None } else { self.cameras.get_mut(place) }
    }

    /// The oldest waiting frame, with the frame of each other camera that was taken at the same
    /// time.
    fn take_frame_set(&mut self) -> Option<Vec<Option<SeenFrame>>> {
        let is_full = self.cameras.iter().any(|queue| queue.frames.len() > MOST_WAITING_FRAMES);
        if !is_full && self.cameras.iter().any(CameraQueue::is_waited_for) {
            return None;
        }
        let first_ns = |queue: &CameraQueue| queue.frames.front().map(SeenFrame::host_time_ns);
        let fronts = self.cameras.iter().enumerate();
        let fronts = fronts.filter_map(|(place, queue)| Some((place, first_ns(queue)?)));
        let (oldest, start_ns) = fronts.min_by_key(|(_, ns)| *ns)?;
        let following_ns = self.cameras[oldest].frames.get(1).map(SeenFrame::host_time_ns);
        let between = |queue: &CameraQueue| {
            first_ns(queue).is_some_and(|ns| {
                (SAME_TIME_NS + 1..=TOGETHER_NS).contains(&(ns.saturating_sub(start_ns)))
            })
        };
        let may_follow = following_ns.is_none() && self.cameras[oldest].goes_on();
        if !is_full && may_follow && self.cameras.iter().any(between) {
            // Other cameras' frames were taken after this one; whether they are nearer to this
            // camera's next frame is not known until that arrives.
            return None;
        }
        let belongs = |ns: i64| {
            let is_nearer = following_ns.is_none_or(|following_ns| {
                ns.saturating_sub(start_ns).unsigned_abs() <= following_ns.abs_diff(ns)
            });
            ns.saturating_sub(start_ns) <= TOGETHER_NS && is_nearer
        };
        let take = |queue: &mut CameraQueue| match first_ns(queue) {
            Some(ns) if belongs(ns) => queue.frames.pop_front(),
            _ => None,
        };
        Some(self.cameras.iter_mut().map(take).collect())
    }

    /// Why all cameras have ended; returned once.
    fn take_end(&mut self) -> Option<String> {
        let has_ended = |queue: &CameraQueue| queue.ended.is_some() && queue.frames.is_empty();
        if self.closed || !self.cameras.iter().all(has_ended) {
            return None;
        }
        self.closed = true;
        self.cameras.first_mut().and_then(|queue| queue.ended.take())
    }
}

impl CameraQueue {
    /// Whether more frames are expected.
    fn goes_on(&self) -> bool {
        self.ended.is_none() && self.lost.is_none()
    }

    fn is_waited_for(&self) -> bool {
        self.frames.is_empty() && self.goes_on()
    }
}

#[cfg(test)]
#[path = "assembly_tests.rs"]
mod tests;
