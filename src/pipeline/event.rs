//! Numbered events that any number of listeners follow as they happen, from any event on that is
//! still stored in memory.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::watch;

use crate::calibration::admission::Rejection;
use crate::calibration::drift::Drift;
use crate::calibration::result::{Calibration, Grade, ProjectionUncertainty};
use crate::calibration::session_record::SessionRecord;
use crate::detection::board_detection::GridIndex;
use crate::geometry::pixel::Pixel;
use crate::locks::lock;
use crate::pipeline::camera_status::CameraStatus;
use crate::pipeline::seen::SeenFrame;

/// Something that happened to a camera.
#[derive(Debug, Clone)]
pub struct Event {
    /// Grows with every event, also across restarts.
    pub id: u64,
    /// The camera's name.
    pub camera: String,
    /// What happened.
    pub kind: EventKind,
}

/// What happened.
#[derive(Debug, Clone)]
pub enum EventKind {
    /// A frame set was taken.
    Frame(FrameEvent),
    /// A frame was searched for the board.
    Detection(DetectionEvent),
    /// A session began, kept a view, or changed its state or its advice.
    Session(Box<SessionRecord>),
    /// A calibration was made or became current.
    Calibration(CalibrationEvent),
    /// A camera changed its state.
    Camera(Box<CameraStatus>),
    /// The current calibration may no longer be valid: the lens was moved, or new views have larger
    /// residuals than expected.
    Drift(Drift),
}

impl EventKind {
    /// A session in its present state, without the maps of its estimates: an event does not contain
    /// them, and in the two thousand events in memory they would take 40 MB.
    pub(super) fn session(record: &SessionRecord) -> Self {
        let mut record = record.clone();
        let of_members = record.members.iter_mut().map(|member| &mut member.estimate);
        for estimate in of_members.chain([&mut record.estimate]).flatten() {
            estimate.uncertainty_map = None;
        }
        Self::Session(Box::new(record))
    }

    /// Its name on the wire.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Frame(_) => "frame",
            Self::Detection(_) => "detection",
            Self::Session(_) => "session",
            Self::Calibration(_) => "calibration",
            Self::Camera(_) => "camera",
            Self::Drift(_) => "drift",
        }
    }

    /// Whether it comes with every frame, and is therefore forgotten sooner.
    fn is_frequent(&self) -> bool {
        matches!(self, Self::Frame(_) | Self::Detection(_))
    }
}

/// A frame set that was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameEvent {
    /// The frame set's number.
    pub sequence: u64,
    /// When the host received it, nanoseconds since the Unix epoch.
    pub host_time_ns: i64,
    /// When the device took it, nanoseconds of its own clock.
    pub device_time_ns: Option<i64>,
    /// Frame sets lost so far.
    pub dropped_frames: u64,
}

/// What a session made of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectionEvent {
    /// The frame set's number.
    pub sequence: u64,
    /// The session that searched.
    pub session: String,
    /// Whether the board was found, or features of a scene.
    pub found: bool,
    /// The corners in row-major order; empty if not found.
    pub corners_px: Vec<Pixel>,
    /// Which of the board's corners they are.
    pub indices: Vec<GridIndex>,
    /// The corners' numbers on a board with markers; `None` for another board, or if not found.
    pub ids: Option<Vec<u32>>,
    /// The number of the view it became; `None` if it was not kept.
    pub kept_view: Option<u32>,
    /// The kind of rejection ([`crate::calibration::admission::Rejection::kind`]); `None` if it was
    /// kept.
    pub rejection: Option<&'static str>,
    /// The rejection in words.
    pub reason: Option<String>,
    /// The time that decoding and detection took, in milliseconds.
    pub elapsed_ms: f64,
}

impl DetectionEvent {
    /// The session's decision on a frame that was searched.
    pub(super) fn of(
        seen: &SeenFrame,
        session: &SessionRecord,
        admission: &Result<u32, Rejection>,
    ) -> Self {
        let found = &seen.detection.outcome;
        let board = seen.detection.board();
        let corners = || board.into_iter().flat_map(|board| board.corners.iter());
        let target = session.request.target.board();
        let rejection = admission.as_ref().err();
        Self {
            sequence: seen.frame_set.sequence,
            session: session.id.clone(),
            found: found.is_ok(),
            corners_px: corners().map(|corner| corner.pixel).collect(),
            indices: corners().map(|corner| corner.index).collect(),
            ids: board.zip(target).and_then(|(board, target)| board.corner_ids(&target)),
            kept_view: admission.as_ref().ok().copied(),
            rejection: rejection.map(Rejection::kind),
            reason: rejection.map(ToString::to_string),
            elapsed_ms: seen.detection.elapsed_ms,
        }
    }
}

/// A calibration that was made or became current.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationEvent {
    /// Its id.
    pub id: String,
    /// The session it came from.
    pub session: Option<String>,
    /// Whether it is the camera's current one now.
    pub current: bool,
    /// How far it can be trusted.
    pub grade: Grade,
    /// Its reprojection error, in pixels.
    pub rms_px: f64,
    /// Its uncertainty over the image.
    pub uncertainty_px: ProjectionUncertainty,
}

impl CalibrationEvent {
    /// The event for `calibration`; for a rig, with the figures of its least certain camera. `None`
    /// if it has no image sensor.
    pub(super) fn of(calibration: &Calibration, current: bool) -> Option<Self> {
        let all = calibration.image_sensors().map(|(_, sensor)| sensor);
        let worst = all.max_by(|a, b| a.uncertainty_px.median.total_cmp(&b.uncertainty_px.median));
        let sensor = calibration.guide().or(worst)?;
        Some(Self {
            id: calibration.id.clone(),
            session: calibration.session.clone(),
            current,
            grade: calibration.verdict.grade,
            rms_px: sensor.rms_px,
            uncertainty_px: sensor.uncertainty_px,
        })
    }
}

/// How many of the events that come with every frame are kept in memory.
const FREQUENT_EVENTS_KEPT: usize = 512;
/// How many of all other events are kept in memory.
const LASTING_EVENTS_KEPT: usize = 2048;

/// Numbers events, keeps the last of them, and wakes the listeners. A listener that falls behind
/// what is kept misses events, and blocks nobody.
#[derive(Debug)]
pub struct EventLog {
    rings: Mutex<Rings>,
    newest: watch::Sender<u64>,
}

#[derive(Debug)]
struct Rings {
    last_id: u64,
    frequent: VecDeque<Arc<Event>>,
    lasting: VecDeque<Arc<Event>>,
}

impl EventLog {
    /// An empty log whose first event has the number `first_id` + 1. With a clock's microseconds,
    /// ids grow across restarts.
    pub fn new(first_id: u64) -> Self {
        let rings =
            Rings { last_id: first_id, frequent: VecDeque::new(), lasting: VecDeque::new() };
        Self { rings: Mutex::new(rings), newest: watch::Sender::new(first_id) }
    }

    /// Numbers and announces an event.
    pub fn publish(&self, camera: &str, kind: EventKind) {
        let mut rings = self.lock();
        rings.last_id += 1;
        let id = rings.last_id;
        let frequent = kind.is_frequent();
        let event = Arc::new(Event { id, camera: camera.to_owned(), kind });
        let (ring, limit) = if frequent {
            (&mut rings.frequent, FREQUENT_EVENTS_KEPT)
        } else {
            (&mut rings.lasting, LASTING_EVENTS_KEPT)
        };
        if ring.len() == limit {
            ring.pop_front();
        }
        ring.push_back(event);
        self.newest.send_replace(id);
    }

    /// Follows the events after `last_seen`, or from now on for `None`. An id from the future,
    /// after a clock was set back, counts as now.
    pub fn follow(self: &Arc<Self>, last_seen: Option<u64>) -> EventStream {
        let newest = self.lock().last_id;
        EventStream {
            log: Arc::clone(self),
            last_id: last_seen.unwrap_or(newest).min(newest),
            newest: self.newest.subscribe(),
        }
    }

    /// The first event after `id` that is still in memory.
    fn first_after(&self, id: u64) -> Option<Arc<Event>> {
        let rings = self.lock();
        let first = |ring: &VecDeque<Arc<Event>>| {
            ring.get(ring.partition_point(|event| event.id <= id)).cloned()
        };
        match (first(&rings.frequent), first(&rings.lasting)) {
            (Some(a), Some(b)) => Some(if a.id < b.id { a } else { b }),
            (a, b) => a.or(b),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Rings> {
        lock(&self.rings)
    }
}

/// One listener's position in the log.
#[derive(Debug)]
pub struct EventStream {
    log: Arc<EventLog>,
    last_id: u64,
    newest: watch::Receiver<u64>,
}

impl EventStream {
    /// Waits for the next event. Dropping the future loses no event.
    pub async fn next(&mut self) -> Arc<Event> {
        loop {
            if let Some(event) = self.next_remembered() {
                return event;
            }
            // The sender lives in the log, which this stream holds: waiting cannot fail.
            if self.newest.changed().await.is_err() {
                std::future::pending::<()>().await;
            }
        }
    }

    /// The next event, if it has already happened.
    pub fn next_remembered(&mut self) -> Option<Arc<Event>> {
        self.newest.mark_unchanged();
        let event = self.log.first_after(self.last_id)?;
        self.last_id = event.id;
        Some(event)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::session_record::{RunningEstimate, SessionMember};
    use crate::estimation::uncertainty::{PixelGrid, UncertaintyMap};
    use crate::geometry::lens::{Lens, LensModel};
    use crate::geometry::pixel::ImageSize;
    use crate::pipeline::scripted::request;

    fn frame(sequence: u64) -> EventKind {
        EventKind::Frame(FrameEvent {
            sequence,
            host_time_ns: 0,
            device_time_ns: None,
            dropped_frames: 0,
        })
    }

    fn camera() -> EventKind {
        EventKind::Camera(Box::new(CameraStatus::starting("front", "recording")))
    }

    fn ids(stream: &mut EventStream) -> Vec<u64> {
        std::iter::from_fn(|| stream.next_remembered()).map(|event| event.id).collect()
    }

    #[test]
    fn a_session_is_remembered_without_maps() {
        let lens = Lens::from_parameters(LensModel::Pinhole, &[500.0, 500.0, 320.0, 240.0, 0.0]);
        let grid = PixelGrid { size: ImageSize::new(640, 480), cols: 2, rows: 2 };
        let map = UncertaintyMap {
            grid,
            std_px: vec![None; 4],
            square_px2: vec![None; 4],
            covariance_px2: vec![None; 4],
            weights: vec![0.0; 4],
        };
        let estimate = RunningEstimate {
            lens: lens.unwrap(),
            rms_px: 0.1,
            uncertainty_px: ProjectionUncertainty { center: 0.1, median: 0.2, worst: 0.3 },
            uncertainty_map: Some(Arc::new(map)),
            views: 5,
        };
        let mut record = SessionRecord::begin("1", "rig", request(), 0);
        let member = SessionMember::begin("left");
        record.members = vec![SessionMember { estimate: Some(estimate.clone()), ..member }];
        record.estimate = Some(estimate);
        let EventKind::Session(said) = EventKind::session(&record) else { panic!("a session") };
        record.members[0].estimate.as_mut().unwrap().uncertainty_map = None;
        record.estimate.as_mut().unwrap().uncertainty_map = None;
        assert_eq!(*said, record);
    }

    #[test]
    fn a_listener_resumes_where_it_left() {
        let log = Arc::new(EventLog::new(100));
        (0..5).for_each(|sequence| log.publish("front", frame(sequence)));
        assert_eq!(ids(&mut log.follow(Some(102))), [103, 104, 105]);
        assert_eq!(ids(&mut log.follow(None)), [0_u64; 0]);
        assert_eq!(ids(&mut log.follow(Some(0))), [101, 102, 103, 104, 105]);
    }

    #[test]
    fn an_id_from_the_future_counts_as_now() {
        let log = Arc::new(EventLog::new(100));
        let mut stream = log.follow(Some(u64::MAX));
        log.publish("front", camera());
        assert_eq!(ids(&mut stream), [101]);
    }

    #[test]
    fn many_frames_do_not_push_out_what_lasts() {
        let log = Arc::new(EventLog::new(0));
        log.publish("front", camera());
        (0..10_000).for_each(|sequence| log.publish("front", frame(sequence)));
        let remembered = ids(&mut log.follow(Some(0)));
        assert_eq!(remembered.len(), 1 + FREQUENT_EVENTS_KEPT);
        assert_eq!(remembered[0], 1);
        assert!(remembered.is_sorted());
    }

    #[tokio::test]
    async fn a_waiting_listener_is_woken() {
        let log = Arc::new(EventLog::new(0));
        let mut stream = log.follow(None);
        let waiting = tokio::spawn(async move { stream.next().await.id });
        tokio::task::yield_now().await;
        log.publish("front", camera());
        assert_eq!(waiting.await.unwrap(), 1);
    }
}
