//! The fleet on sources that do what the test says: deliver, fall silent, vanish, break, panic,
//! end.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use super::*;
use crate::calibration::result::{
    CalibratedSensor, Calibration, Checks, Grade, ImageCalibration, ProjectionUncertainty, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::session_record::SessionRequest;
use crate::calibration::session_record::SessionState;
use crate::capture::{
    CaptureError, FrameSource, Pace, Simulated, SimulatedClock, SourceDescription,
};
use crate::estimation::problem::LensChoice;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::timestamp::HostTime;
use crate::pipeline::Supervision;
use crate::pipeline::event::Event;
use crate::pipeline::session_request::{EndError, StartError};
use crate::simulation::WorldOptions;

/// A test that hangs has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a scripted device does next.
enum Step {
    Frame,
    /// A frame that was taken so many milliseconds after the epoch.
    At(i64),
    Fail(CaptureError),
    Panic,
    /// Somebody turned its focus ring.
    Move,
}

fn lost(reason: &str) -> CaptureError {
    CaptureError::Lost { device: "camera 7".to_owned(), reason: reason.to_owned() }
}

/// A device that does what it is sent, and is silent otherwise.
struct Scripted {
    steps: Receiver<Step>,
    sequence: u64,
    waits: bool,
    moved: bool,
}

fn gray_frame(sequence: u64) -> FrameSet {
    let size = ImageSize::new(64, 48);
    let frame = Frame {
        sensor: SensorKind::Color,
        size,
        format: PixelFormat::Mono8,
        stride: 64,
        bytes: vec![9; 64 * 48].into(),
    };
    let host_time = HostTime { utc_ns: sequence as i64 * 1_000_000 };
    FrameSet { sequence, host_time, device_time: None, name: None, frames: vec![frame] }
}

impl FrameSource for Scripted {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        match self.steps.recv_timeout(timeout) {
            Ok(Step::Frame) => {
                self.sequence += 1;
                Ok(gray_frame(self.sequence - 1))
            }
            Ok(Step::At(ms)) => {
                self.sequence += 1;
                let host_time = HostTime { utc_ns: ms * 1_000_000 };
                Ok(FrameSet { host_time, ..gray_frame(self.sequence - 1) })
            }
            Ok(Step::Fail(error)) => Err(error),
            Ok(Step::Panic) => panic!("the driver's binding broke"),
            Ok(Step::Move) => {
                self.moved = true;
                Err(CaptureError::TimedOut { waited: Duration::ZERO })
            }
            Err(RecvTimeoutError::Timeout) => Err(CaptureError::TimedOut { waited: timeout }),
            Err(RecvTimeoutError::Disconnected) => Err(CaptureError::Ended),
        }
    }

    fn description(&self) -> SourceDescription {
        SourceDescription {
            identity: "camera 7".to_owned(),
            waits: self.waits,
            ..SourceDescription::default()
        }
    }

    fn moved_since_calibrating(&self) -> Option<String> {
        self.moved.then(|| "focus is 30, was 10".to_owned())
    }
}

/// The test's end of a camera: what each opening gives.
struct Script {
    openings: Sender<Result<Receiver<Step>, CaptureError>>,
}

impl Script {
    /// The next opening succeeds; the sender feeds it.
    fn plug_in(&self) -> Sender<Step> {
        let (feed, steps) = channel();
        self.openings.send(Ok(steps)).unwrap();
        feed
    }
}

fn scripted(name: &str) -> (CameraPlan, Script) {
    let (openings, next) = channel::<Result<Receiver<Step>, CaptureError>>();
    let open = move || {
        let steps = next.try_recv().unwrap_or_else(|_| Err(lost("not plugged in")))?;
        Ok(Box::new(Scripted { steps, sequence: 0, waits: false, moved: false })
            as Box<dyn FrameSource>)
    };
    let plan = CameraPlan {
        name: name.to_owned(),
        kind: "v4l2".to_owned(),
        open: Box::new(open),
        may_stall: true,
    };
    (plan, Script { openings })
}

/// A fleet that retries at once and has patience with silence, `stall` says how much.
fn fleet_of(plans: Vec<CameraPlan>, folder: &tempfile::TempDir, stall: Duration) -> Fleet {
    let soon = Duration::from_millis(1);
    let supervision = Supervision {
        first_retry: soon,
        longest_retry: soon,
        moved_check: Duration::ZERO,
        failed_retry: soon,
        stall,
        first_frame: stall,
    };
    let options = FleetOptions { supervision, ..FleetOptions::default() };
    Fleet::start(plans, Arc::new(Store::open(folder.path()).unwrap()), &options).unwrap()
}

fn request() -> SessionRequest {
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    SessionRequest {
        target: target.into(),
        lens: LensChoice::Auto,
        finish: None,
        given: Vec::new(),
    }
}

async fn until<T>(events: &mut EventStream, mut wanted: impl FnMut(&Event) -> Option<T>) -> T {
    let found = async {
        loop {
            if let Some(found) = wanted(&*events.next().await) {
                return found;
            }
        }
    };
    tokio::time::timeout(PATIENCE, found).await.unwrap()
}

async fn until_state(events: &mut EventStream, camera: &str, state: CameraState) -> CameraStatus {
    until(events, |event| match &event.kind {
        EventKind::Camera(status) if event.camera == camera && status.state == state => {
            Some((**status).clone())
        }
        _ => None,
    })
    .await
}

async fn until_session(
    events: &mut EventStream,
    wanted: impl Fn(&SessionRecord) -> bool,
) -> SessionRecord {
    until(events, |event| match &event.kind {
        EventKind::Session(record) if wanted(record) => Some((**record).clone()),
        _ => None,
    })
    .await
}

async fn until_frame(events: &mut EventStream, camera: &str) {
    until(events, |event| (event.camera == camera && event.kind.name() == "frame").then_some(()))
        .await;
}

#[tokio::test]
async fn a_session_lives_through_a_loss_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    feed.send(Step::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let id = fleet.start_session("front", request()).await.unwrap().id;

    feed.send(Step::Fail(lost("unplugged"))).unwrap();
    let status = until_state(&mut events, "front", CameraState::Lost).await;
    assert_eq!(status.reason.as_deref(), Some("camera 7 was lost: unplugged"));
    until_session(&mut events, |record| {
        record.reason.as_deref() == Some("waits for the camera: camera 7 was lost: unplugged")
    })
    .await;

    let feed = script.plug_in();
    feed.send(Step::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let record = until_session(&mut events, |record| record.reason.is_none()).await;
    assert_eq!((record.id, record.state), (id.clone(), SessionState::Collecting));
    let busy = fleet.start_session("front", request()).await.unwrap_err();
    assert_eq!(busy, StartError::Busy { camera: "front".to_owned(), session: id.clone() });
    assert_eq!(fleet.abort_session(&id).await.unwrap().state, SessionState::Aborted);
    assert_eq!(fleet.session_over(&id).await.unwrap().state, SessionState::Aborted);
}

#[tokio::test]
async fn silence_is_a_loss_and_a_panic_too() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![plan], &folder, Duration::from_millis(1));
    let mut events = fleet.events(Some(0));
    feed.send(Step::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let status = until_state(&mut events, "front", CameraState::Lost).await;
    assert_eq!(status.reason.as_deref(), Some("no frame for 0.2 s"));

    let feed = script.plug_in();
    feed.send(Step::Frame).unwrap();
    feed.send(Step::Panic).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    until(&mut events, |event| match &event.kind {
        EventKind::Camera(status) => {
            status.reason.as_ref().filter(|reason| reason.contains("binding broke")).cloned()
        }
        _ => None,
    })
    .await;
    let feed = script.plug_in();
    feed.send(Step::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    assert!(fleet.metrics_text().contains("plumb_camera_opened_total{camera=\"front\"} 3"));
}

#[tokio::test]
async fn what_needs_a_person_is_said_and_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, script) = scripted("front");
    let reason = "no permission; join the group `video`";
    script.openings.send(Err(CaptureError::Failed { reason: reason.to_owned() })).unwrap();
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let status = until_state(&mut events, "front", CameraState::Failed).await;
    assert_eq!(status.reason.as_deref(), Some(reason));
    assert!(!fleet.is_ready());
    let feed = script.plug_in();
    feed.send(Step::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    assert!(fleet.is_ready());
}

#[tokio::test]
async fn two_cameras_never_hold_each_other_up() {
    let folder = tempfile::tempdir().unwrap();
    let (release, blocked) = channel::<()>();
    let stuck = move || {
        // A driver that does not come back.
        let _ = blocked.recv();
        Err(lost("gone"))
    };
    let stuck = CameraPlan {
        name: "stuck".to_owned(),
        kind: "v4l2".to_owned(),
        open: Box::new(stuck),
        may_stall: true,
    };
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![stuck, plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    for _ in 0..100 {
        feed.send(Step::Frame).unwrap();
        until_frame(&mut events, "front").await;
    }
    assert_eq!(fleet.camera("stuck").unwrap().state, CameraState::Starting);
    assert_eq!(fleet.camera("front").unwrap().frames, 100);
    let id = fleet.start_session("stuck", request()).await.unwrap().id;
    let failed = fleet.stop_session(&id).await.unwrap();
    assert_eq!(
        failed.state,
        SessionState::Failed,
        "a session can be stopped while its camera hangs"
    );
    drop(release);
}

/// A replay of `frames` frames that waits for each to be searched.
fn replay(frames: u64) -> CameraPlan {
    let open = move || {
        let (feed, steps) = channel();
        (0..frames).for_each(|_| feed.send(Step::Frame).unwrap());
        Ok(Box::new(Scripted { steps, sequence: 0, waits: true, moved: false })
            as Box<dyn FrameSource>)
    };
    CameraPlan {
        name: "front".to_owned(),
        kind: "recording".to_owned(),
        open: Box::new(open),
        may_stall: false,
    }
}

#[tokio::test]
async fn every_session_sees_the_whole_of_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![replay(500)], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    for _ in 0..3 {
        let id = fleet.start_session("front", request()).await.unwrap().id;
        let record = until_session(&mut events, |record| {
            record.id == id
                && record.reason.as_ref().is_some_and(|reason| reason.contains("has ended"))
        })
        .await;
        assert_eq!((record.frames_seen, record.state), (500, SessionState::Collecting));
        fleet.abort_session(&id).await.unwrap();
    }
}

#[tokio::test]
async fn an_unfinished_session_goes_on_under_its_id() {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_of(vec![replay(10)], &folder, PATIENCE);
    let id = fleet.start_session("front", request()).await.unwrap().id;
    drop(fleet);
    let fleet = fleet_of(vec![replay(10)], &folder, PATIENCE);
    assert_eq!(fleet.live_session(&id).unwrap().state, SessionState::Collecting);
    let mut events = fleet.events(Some(0));
    until_session(&mut events, |record| record.id == id && record.frames_seen >= 10).await;
    let unknown = fleet.stop_session("other").await.unwrap_err();
    assert_eq!(
        unknown.to_string(),
        "there is no session `other`; see GET /v1/sessions for those there are"
    );
}

/// A fleet of scripted cameras that are one rig, `head`, with the script of each.
fn rig_of(names: &[&str], folder: &tempfile::TempDir) -> (Fleet, Vec<Script>) {
    let (plans, scripts): (Vec<_>, Vec<_>) = names.iter().map(|name| scripted(name)).unzip();
    let fleet = fleet_of(plans, folder, PATIENCE);
    let cameras = names.iter().map(|name| (*name).to_owned()).collect();
    fleet.start_rigs(vec![RigPlan { name: "head".to_owned(), cameras }]).unwrap();
    (fleet, scripts)
}

/// Waits until each of these cameras has shown its frame of this sequence number.
async fn until_frames(events: &mut EventStream, wanted: &[(&str, u64)]) {
    let mut open = wanted.to_vec();
    until(events, |event| {
        if let EventKind::Frame(frame) = &event.kind {
            open.retain(|wanted| *wanted != (event.camera.as_str(), frame.sequence));
        }
        open.is_empty().then_some(())
    })
    .await;
}

fn count(fleet: &Fleet, metric: &str) -> u64 {
    let text = fleet.metrics_text();
    let line = text.lines().find_map(|line| line.strip_prefix(metric));
    line.map_or(0, |value| value.trim().parse().unwrap())
}

/// A rig of which one camera gives every third frame, then none, then is unplugged: the session
/// goes on with what the others give, says what it waits for, and ends when it is asked to.
#[tokio::test]
async fn a_rig_goes_on_without_the_camera_that_does_not() {
    const COMPLETE: &str = "plumb_rig_frame_sets_total{complete=\"true\",rig=\"head\"}";
    const INCOMPLETE: &str = "plumb_rig_frame_sets_total{complete=\"false\",rig=\"head\"}";
    let folder = tempfile::tempdir().unwrap();
    let (fleet, scripts) = rig_of(&["left", "right"], &folder);
    let feeds: Vec<Sender<Step>> = scripts.iter().map(Script::plug_in).collect();
    let mut events = fleet.events(Some(0));
    for (feed, name) in feeds.iter().zip(["left", "right"]) {
        feed.send(Step::At(0)).unwrap();
        until_state(&mut events, name, CameraState::Streaming).await;
    }
    let id = fleet.start_rig_session("head", request()).await.unwrap().id;
    let busy = fleet.start_session("right", request()).await.unwrap_err();
    assert_eq!(busy, StartError::Busy { camera: "right".to_owned(), session: id.clone() });
    // A frame that was asked for before the session began is nobody's.
    feeds.iter().for_each(|feed| feed.send(Step::At(1)).unwrap());
    until_frames(&mut events, &[("left", 1), ("right", 1)]).await;
    let seen = |record: &SessionRecord, place: usize| record.members[place].frames_seen;
    for k in 1..=30 {
        feeds[0].send(Step::At(100 * k)).unwrap();
        let mut sent = vec![("left", 1 + k as u64)];
        if k % 3 == 0 {
            feeds[1].send(Step::At(100 * k)).unwrap();
            sent.push(("right", 1 + k as u64 / 3));
        }
        until_frames(&mut events, &sent).await;
    }
    until(&mut events, |_| (count(&fleet, COMPLETE) >= 10).then_some(())).await;
    // Stalled: half a second later the other one is gone on with, and nothing piles up.
    for k in 31..=80 {
        feeds[0].send(Step::At(100 * k)).unwrap();
        until_frames(&mut events, &[("left", 1 + k as u64)]).await;
    }
    let before = count(&fleet, INCOMPLETE);
    assert!((20 + 50 - 17..=20 + 50).contains(&before), "{before}");
    // Unplugged: it is not waited for at all.
    feeds[1].send(Step::Fail(lost("unplugged"))).unwrap();
    until_session(&mut events, |record| {
        record.id == id
            && record.reason.as_deref()
                == Some("waits for camera `right`: camera 7 was lost: unplugged")
    })
    .await;
    feeds[0].send(Step::At(100 * 81)).unwrap();
    until(&mut events, |event| {
        matches!(&event.kind, EventKind::Detection(found) if found.session == id
            && event.camera == "left" && seen(&fleet.live_session(&id).unwrap(), 0) >= 81)
        .then_some(())
    })
    .await;
    let record = fleet.live_session(&id).unwrap();
    assert!((10..=11).contains(&seen(&record, 1)), "{}", seen(&record, 1));
    let ended = fleet.stop_session(&id).await.unwrap();
    assert_eq!(ended.state, SessionState::Failed, "{ended:?}");
    assert!(ended.reason.unwrap().starts_with("views kept: left 0, right 0; two cameras need"));
    assert!(fleet.camera("left").unwrap().session.is_none());
    let own = fleet.start_session("left", request()).await.unwrap();
    fleet.abort_session(&own.id).await.unwrap();
}

/// A simulated camera that gives each frame as soon as it is taken.
fn walking() -> CameraPlan {
    let open = || {
        let options = WorldOptions::new(3, ImageSize::new(320, 240));
        let source = Simulated::new(&options, Pace::Fastest, SimulatedClock::Own);
        Ok(Box::new(source) as Box<dyn FrameSource>)
    };
    CameraPlan {
        name: "front".to_owned(),
        kind: "simulator".to_owned(),
        open: Box::new(open),
        may_stall: false,
    }
}

/// SQLite says that the disk is full: the session pauses, says so everywhere, and nothing that was
/// announced is missing; with room again it goes on by itself.
#[tokio::test]
async fn a_session_pauses_while_it_cannot_be_stored_and_goes_on_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(Store::open(folder.path()).unwrap());
    let fleet =
        Fleet::start(vec![walking()], Arc::clone(&store), &FleetOptions::default()).unwrap();
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("front", request()).await.unwrap().id;
    until_session(&mut events, |record| record.views_kept >= 1).await;
    store.limit_growth(Some(2));
    let paused = until_session(&mut events, |record| record.reason.is_some()).await;
    let reason = paused.reason.clone().unwrap();
    assert!(reason.starts_with("paused: store ") && reason.contains("full"), "{reason}");
    assert_eq!(paused.state, SessionState::Collecting);
    let stored = store.sensor_views(&id).unwrap().len();
    assert_eq!(paused.views_kept as usize, stored, "what was announced is stored");
    assert_eq!(fleet.live_session(&id).unwrap().views_kept, paused.views_kept);
    assert!(!fleet.is_ready() && fleet.paused()[0].starts_with("front is paused: "));
    assert_eq!(count(&fleet, "plumb_sessions_paused"), 1);
    let refused = fleet.stop_session(&id).await.unwrap_err();
    assert!(matches!(refused, EndError::Store { .. }), "{refused}");

    store.limit_growth(None);
    let views = paused.views_kept + 2;
    let record = until_session(&mut events, |record| record.views_kept >= views).await;
    assert_eq!((record.reason, count(&fleet, "plumb_sessions_paused")), (None, 0));
    assert!(fleet.paused().is_empty());
    fleet.abort_session(&id).await.unwrap();
    let kept = fleet.live_session(&id).unwrap().views_kept as usize;
    let numbers: Vec<u32> =
        store.sensor_views(&id).unwrap().iter().filter_map(|view| view.number).collect();
    assert_eq!(numbers, (0..kept as u32).collect::<Vec<_>>(), "none is lost, none twice");
}

/// A calibration of camera `front` that is current.
fn calibrated(folder: &tempfile::TempDir) {
    let lens = Lens::from_parameters(LensModel::Pinhole, &[60.0, 60.0, 32.0, 24.0, 0.0]).unwrap();
    let sensor = ImageCalibration {
        image_size: ImageSize::new(64, 48),
        lens,
        lens_std: vec![0.1; 5],
        lens_covariance: Vec::new(),
        rms_px: 0.1,
        uncertainty_px: ProjectionUncertainty::default(),
        views: Vec::new(),
        compared: Vec::new(),
        board_warp_m: None,
        board_shape: None,
        rolling_shutter: None,
        scene: None,
    };
    let calibration = Calibration {
        id: "c1".to_owned(),
        camera: Some("front".to_owned()),
        created_at_ns: 1,
        ..Calibration::unnamed(
            None::<crate::geometry::target::Target>,
            vec![CalibratedSensor::image(SensorId::own(SensorKind::Color), sensor)],
            (Checks::default(), Verdict { grade: Grade::Good, reasons: Vec::new() }),
        )
    };
    let store = Store::open(folder.path()).unwrap();
    store.append_calibration(&calibration).unwrap();
    store.set_current("front", "c1").unwrap();
}

#[tokio::test]
async fn a_focus_that_moves_after_a_session_is_a_drift() {
    let folder = tempfile::tempdir().unwrap();
    calibrated(&folder);
    let (plan, script) = scripted("front");
    let feed = script.plug_in();
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    feed.send(Step::Frame).unwrap();
    until_state(&mut events, "front", CameraState::Streaming).await;
    let id = fleet.start_session("front", request()).await.unwrap().id;
    // The first may have been on its way when the session began; the second is the session's.
    (0..2).for_each(|_| feed.send(Step::Frame).unwrap());
    until(&mut events, |event| (event.kind.name() == "detection").then_some(())).await;
    fleet.abort_session(&id).await.unwrap();
    feed.send(Step::Move).unwrap();
    (0..3).for_each(|_| feed.send(Step::Frame).unwrap());
    let drift = until(&mut events, |event| match &event.kind {
        EventKind::Drift(drift) => Some(drift.clone()),
        _ => None,
    })
    .await;
    assert_eq!((drift.calibration.as_str(), drift.reason.as_str()), ("c1", "focus is 30, was 10"));
    assert_eq!(fleet.camera("front").unwrap().reason.as_deref(), Some("focus is 30, was 10"));
}

/// A device that gives a large, noisy image at every sign, as fast as it is asked.
struct Flood {
    signs: Receiver<()>,
    next: u64,
    bytes: Arc<[u8]>,
}

const FLOOD_SIZE: ImageSize = ImageSize::new(2000, 1500);

impl FrameSource for Flood {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        self.signs.recv_timeout(timeout).map_err(|_| CaptureError::TimedOut { waited: timeout })?;
        let bytes = Arc::clone(&self.bytes);
        let format = PixelFormat::Mono8;
        let frame =
            Frame { sensor: SensorKind::Color, size: FLOOD_SIZE, format, stride: 2000, bytes };
        self.next += 1;
        Ok(FrameSet { frames: vec![frame], ..gray_frame(self.next - 1) })
    }

    fn description(&self) -> SourceDescription {
        SourceDescription::default()
    }
}

/// A search takes far longer than the next image: what is not searched is counted, the last one
/// always is searched.
#[tokio::test]
async fn when_detection_cannot_keep_up_the_newest_frame_wins() {
    const FRAMES: u64 = 200;
    let folder = tempfile::tempdir().unwrap();
    let (flood, signs) = channel();
    let mut source = Some(Flood {
        signs,
        next: 0,
        bytes: (0..2000 * 1500_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect(),
    });
    let open = move || {
        source.take().map(|s| Box::new(s) as Box<dyn FrameSource>).ok_or_else(|| lost("gone"))
    };
    let plan = CameraPlan {
        name: "front".to_owned(),
        kind: "v4l2".to_owned(),
        open: Box::new(open),
        may_stall: false,
    };
    let fleet = fleet_of(vec![plan], &folder, PATIENCE);
    let mut events = fleet.events(Some(0));
    let id = fleet.start_session("front", request()).await.unwrap().id;
    (0..FRAMES).for_each(|_| flood.send(()).unwrap());
    let (mut taken, mut searched_frames) = (0, Vec::new());
    until(&mut events, |event| {
        taken += u64::from(matches!(event.kind, EventKind::Frame(_)));
        let EventKind::Detection(detection) = &event.kind else { return None };
        searched_frames.push(detection.sequence);
        (detection.sequence == FRAMES - 1).then_some(())
    })
    .await;
    let searched = searched_frames.len() as u64;
    assert!(searched_frames.is_sorted() && searched < FRAMES / 4, "{searched_frames:?}");
    // The first image may have been asked for before the session began: it is taken, but no board
    // is searched for.
    assert!((searched..=searched + 1).contains(&taken), "{taken} taken, {searched} searched");
    // A frame that takes another's place is counted once it has; the detector may be done with it
    // by then.
    let dropped = || fleet.camera("front").unwrap().dropped_frames;
    let began = Instant::now();
    while taken + dropped() < FRAMES && began.elapsed() < PATIENCE {
        tokio::task::yield_now().await;
    }
    let dropped = dropped();
    assert_eq!(taken + dropped, FRAMES);
    assert_eq!(fleet.abort_session(&id).await.unwrap().frames_seen, searched);
    let metrics = fleet.metrics_text();
    let counted =
        format!("plumb_frames_dropped_total{{camera=\"front\",why=\"overload\"}} {dropped}");
    assert!(metrics.contains(&counted), "{metrics}");
    assert!(
        metrics
            .contains(&format!("plumb_frame_latency_seconds_count{{camera=\"front\"}} {searched}")),
        "{metrics}"
    );
}
