//! Sources that follow a test's script: they deliver, stall, disappear, fail, panic or end.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::capture::{
    CaptureError, FrameSource, Pace, Simulated, SimulatedClock, SourceDescription,
};
use crate::estimation::problem::LensChoice;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::timestamp::HostTime;
use crate::pipeline::Supervision;
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::pipeline::event::{Event, EventKind, EventStream};
use crate::pipeline::fleet::Fleet;
use crate::pipeline::running::{CameraPlan, FleetOptions};
use crate::simulation::WorldOptions;
use crate::store::Store;
use crate::store::error::StoreError;

/// A test that waits longer than this has failed.
pub(super) const PATIENCE: Duration = Duration::from_secs(60);

/// What a scripted device does next.
pub(super) enum ScriptStep {
    Frame,
    /// A frame taken this many milliseconds after the epoch.
    At(i64),
    /// A frame of this size.
    Sized(ImageSize),
    Fail(CaptureError),
    Panic,
    /// The focus ring is moved by hand.
    Move,
    /// From now on, its driver does not return from closing until the other end is dropped.
    Hold(Receiver<()>),
}

pub(super) fn lost(reason: &str) -> CaptureError {
    CaptureError::Lost { device: "camera 7".to_owned(), reason: reason.to_owned() }
}

/// A device that follows the steps it is sent, and delivers nothing otherwise.
pub(super) struct Scripted {
    pub(super) steps: Receiver<ScriptStep>,
    pub(super) sequence: u64,
    pub(super) waits: bool,
    pub(super) moved: bool,
    pub(super) held: Option<Receiver<()>>,
    pub(super) serial: Option<String>,
}

impl Drop for Scripted {
    fn drop(&mut self) {
        if let Some(held) = &self.held {
            let _ = held.recv();
        }
    }
}

pub(super) fn gray_frame(sequence: u64) -> FrameSet {
    frame_of(sequence, ImageSize::new(64, 48))
}

fn frame_of(sequence: u64, size: ImageSize) -> FrameSet {
    let stride = size.width as usize;
    let frame = Frame {
        sensor: SensorKind::Color,
        size,
        format: PixelFormat::Mono8,
        stride,
        bytes: vec![9; stride * size.height as usize].into(),
    };
    let host_time = HostTime { utc_ns: sequence as i64 * 1_000_000 };
    FrameSet { sequence, host_time, device_time: None, name: None, frames: vec![frame] }
}

impl FrameSource for Scripted {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        match self.steps.recv_timeout(timeout) {
            Ok(ScriptStep::Frame) => {
                self.sequence += 1;
                Ok(gray_frame(self.sequence - 1))
            }
            Ok(ScriptStep::At(ms)) => {
                self.sequence += 1;
                let host_time = HostTime { utc_ns: ms * 1_000_000 };
                Ok(FrameSet { host_time, ..gray_frame(self.sequence - 1) })
            }
            Ok(ScriptStep::Sized(size)) => {
                self.sequence += 1;
                Ok(frame_of(self.sequence - 1, size))
            }
            Ok(ScriptStep::Fail(error)) => Err(error),
            Ok(ScriptStep::Panic) => panic!("the driver's binding broke"),
            Ok(ScriptStep::Move) => {
                self.moved = true;
                Err(CaptureError::TimedOut { waited: Duration::ZERO })
            }
            Ok(ScriptStep::Hold(until_dropped)) => {
                self.held = Some(until_dropped);
                Err(CaptureError::TimedOut { waited: Duration::ZERO })
            }
            Err(RecvTimeoutError::Timeout) => Err(CaptureError::TimedOut { waited: timeout }),
            Err(RecvTimeoutError::Disconnected) => Err(CaptureError::Ended),
        }
    }

    fn description(&self) -> SourceDescription {
        SourceDescription {
            identity: "camera 7".to_owned(),
            serial: self.serial.clone(),
            waits: self.waits,
            ..SourceDescription::default()
        }
    }

    fn moved_since_calibrating(&self) -> Option<String> {
        self.moved.then(|| "focus is 30, was 10".to_owned())
    }
}

/// A device that is plugged in: its serial number, and its steps.
pub(super) type PluggedIn = (Option<String>, Receiver<ScriptStep>);

/// The test's end of a camera: what each opening gives.
pub(super) struct Script {
    pub(super) openings: Sender<Result<PluggedIn, CaptureError>>,
}

impl Script {
    /// The next opening succeeds; the sender feeds it.
    pub(super) fn plug_in(&self) -> Sender<ScriptStep> {
        self.plug_in_device(None)
    }

    /// The same, of a device with this serial number.
    pub(super) fn plug_in_device(&self, serial: Option<&str>) -> Sender<ScriptStep> {
        let (feed, steps) = channel();
        self.openings.send(Ok((serial.map(str::to_owned), steps))).unwrap();
        feed
    }
}

pub(super) fn scripted(name: &str) -> (CameraPlan, Script) {
    let (openings, next) = channel::<Result<PluggedIn, CaptureError>>();
    let open = move || {
        let (serial, steps) = next.try_recv().unwrap_or_else(|_| Err(lost("not plugged in")))?;
        Ok(
            Box::new(Scripted {
                steps,
                sequence: 0,
                waits: false,
                moved: false,
                held: None,
                serial,
            }) as Box<dyn FrameSource>,
        )
    };
    let plan = CameraPlan {
        name: name.to_owned(),
        kind: "v4l2".to_owned(),
        image_source: "camera 7".to_owned(),
        open: Box::new(open),
        may_stall: true,
    };
    (plan, Script { openings })
}

/// A simulated camera that delivers each frame as soon as it is taken.
pub(super) fn walking(name: &str) -> CameraPlan {
    let open = || {
        let options = WorldOptions::new(3, ImageSize::new(320, 240));
        let source = Simulated::new(&options, Pace::Fastest, SimulatedClock::Own);
        Ok(Box::new(source) as Box<dyn FrameSource>)
    };
    CameraPlan {
        name: name.to_owned(),
        kind: "simulator".to_owned(),
        image_source: "camera 7".to_owned(),
        open: Box::new(open),
        may_stall: false,
    }
}

/// A fleet that retries at once; `stall` is the silence that it tolerates.
pub(super) fn fleet_of(
    plans: Vec<CameraPlan>,
    folder: &tempfile::TempDir,
    stall: Duration,
) -> Fleet {
    fleet_supervised(plans, folder, watched(stall))
}

/// Retries at once, tolerates silence as long as `stall`, and slow closing.
pub(super) fn watched(stall: Duration) -> Supervision {
    let soon = Duration::from_millis(1);
    Supervision {
        first_retry: soon,
        longest_retry: soon,
        moved_check: Duration::ZERO,
        failed_retry: soon,
        stall,
        first_frame: stall,
        closing: PATIENCE,
    }
}

pub(super) fn fleet_supervised(
    plans: Vec<CameraPlan>,
    folder: &tempfile::TempDir,
    supervision: Supervision,
) -> Fleet {
    let options = FleetOptions { supervision, ..FleetOptions::default() };
    Fleet::start(plans, Arc::new(released(folder)), &options).unwrap()
}

/// The store in `folder`. A dropped fleet leaves threads behind that a camera still blocks; the
/// store is released when the last of them ends.
pub(super) fn released(folder: &tempfile::TempDir) -> Store {
    let end = Instant::now() + Duration::from_secs(20);
    loop {
        match Store::open(folder.path()) {
            Err(StoreError::InUse { .. }) if Instant::now() < end => std::thread::yield_now(),
            store => return store.unwrap(),
        }
    }
}

pub(super) fn request() -> SessionRequest {
    let target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.025).unwrap();
    SessionRequest {
        target: target.into(),
        lens: LensChoice::Auto,
        finish: None,
        given: Vec::new(),
    }
}

pub(super) async fn until<T>(
    events: &mut EventStream,
    mut wanted: impl FnMut(&Event) -> Option<T>,
) -> T {
    let found = async {
        loop {
            if let Some(found) = wanted(&*events.next().await) {
                return found;
            }
        }
    };
    tokio::time::timeout(PATIENCE, found).await.unwrap()
}

pub(super) async fn until_state(
    events: &mut EventStream,
    camera: &str,
    state: CameraState,
) -> CameraStatus {
    until(events, |event| match &event.kind {
        EventKind::Camera(status) if event.camera == camera && status.state == state => {
            Some((**status).clone())
        }
        _ => None,
    })
    .await
}

pub(super) async fn until_session(
    events: &mut EventStream,
    wanted: impl Fn(&SessionRecord) -> bool,
) -> SessionRecord {
    until(events, |event| match &event.kind {
        EventKind::Session(record) if wanted(record) => Some((**record).clone()),
        _ => None,
    })
    .await
}

pub(super) async fn until_frame(events: &mut EventStream, camera: &str) {
    until(events, |event| (event.camera == camera && event.kind.name() == "frame").then_some(()))
        .await;
}

pub(super) fn count(fleet: &Fleet, metric: &str) -> u64 {
    let text = fleet.metrics_text();
    let line = text.lines().find_map(|line| line.strip_prefix(metric));
    line.map_or(0, |value| value.trim().parse().unwrap())
}
