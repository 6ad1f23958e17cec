//! Starts and ends a camera or a rig: its threads and the links between them.

use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};

use crate::calibration::admission::AdmissionOptions;
use crate::calibration::session_record::SessionRecord;
use crate::capture::SourceOpener;
use crate::pipeline::camera_status::CameraStatus;
use crate::pipeline::capture_thread::Capture;
use crate::pipeline::current_calibration::CurrentCalibration;
use crate::pipeline::detect_thread::Detect;
use crate::pipeline::event::EventLog;
use crate::pipeline::fleet_error::FleetError;
use crate::pipeline::frame_slot::FrameSlot;
use crate::pipeline::instrument::{Instrument, RigPlan};
use crate::pipeline::jobs::Jobs;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::message::Message;
use crate::pipeline::metrics::Metrics;
use crate::pipeline::preview::Preview;
use crate::pipeline::preview::maps::CalibrationMaps;
use crate::pipeline::preview_thread;
use crate::pipeline::recording::recorder::RecorderLink;
use crate::pipeline::search::CurrentSearch;
use crate::pipeline::session_thread::SessionThread;
use crate::pipeline::solve_thread;
use crate::pipeline::stop_signal::StopSignal;
use crate::pipeline::store_health::StoreHealth;
use crate::pipeline::supervision::Supervision;
use crate::store::Store;

/// A camera to start.
pub struct CameraPlan {
    /// Its name in the configuration.
    pub name: String,
    /// The kind of its source, as in the configuration.
    pub kind: String,
    /// What determines the geometry of its images, in words: a session is resumed with this source
    /// only.
    pub image_source: String,
    /// Opens the source.
    pub open: Box<dyn SourceOpener>,
    /// Whether silence means that the device is lost; false for frames on disk.
    pub may_stall: bool,
}

/// Which cameras and rigs of a fleet to stop, by name, and which to start.
#[derive(Default)]
pub struct Exchange {
    /// Rigs to stop; their cameras are released.
    pub stopped_rigs: Vec<String>,
    /// Cameras to stop.
    pub stopped_cameras: Vec<String>,
    /// Cameras to start.
    pub cameras: Vec<CameraPlan>,
    /// Rigs to start; their cameras are running by then.
    pub rigs: Vec<RigPlan>,
}

/// How the cameras run.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetOptions {
    /// Whether a `good` calibration becomes current by itself. Default: true.
    pub auto_approve: bool,
    /// How sources are supervised.
    pub supervision: Supervision,
    /// The criteria for a detection to become a view.
    pub admission: AdmissionOptions,
}

impl Default for FleetOptions {
    fn default() -> Self {
        Self {
            auto_approve: true,
            supervision: Supervision::default(),
            admission: AdmissionOptions::default(),
        }
    }
}

/// Frame sets on their way to the session thread; a longer queue would only add delay.
const QUEUED_FRAME_SETS: usize = 4;
/// How long threads may take to end.
const STOP_TIMEOUT: Duration = Duration::from_millis(700);
/// How often it is checked whether they have.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// What all cameras and rigs share.
#[derive(Debug)]
pub(super) struct SharedParts {
    pub(super) events: Arc<EventLog>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) store: Arc<Store>,
    pub(super) health: Arc<StoreHealth>,
    pub(super) maps: Arc<CalibrationMaps>,
}

/// A camera or rig with the thread that owns its session.
#[derive(Debug)]
pub(super) struct RunningInstrument {
    pub(super) instrument: Arc<Instrument>,
    thread: JoinHandle<()>,
}

impl RunningInstrument {
    fn wait_for_end(self) {
        if self.thread.join().is_err() {
            let name = &self.instrument.name;
            tracing::error!(instrument = name, "its thread had panicked");
        }
    }
}

/// A camera with the threads that work for it.
#[derive(Debug)]
pub(super) struct RunningCamera {
    pub(super) camera: Arc<LiveCamera>,
    /// The camera by itself.
    pub(super) own: RunningInstrument,
    threads: Vec<JoinHandle<()>>,
}

/// Starts a camera's threads, with the session that an earlier run left unfinished.
pub(super) fn start_camera(
    plan: CameraPlan,
    unfinished: Option<SessionRecord>,
    shared: &SharedParts,
    options: &FleetOptions,
) -> Result<RunningCamera, FleetError> {
    let CameraPlan { name, kind, image_source, open, may_stall } = plan;
    let (messages, received) = mpsc::channel(QUEUED_FRAME_SETS);
    let camera = Arc::new(live_camera(&name, &kind, image_source, messages.clone(), shared)?);
    let instrument = Instrument {
        calibration: watch::Sender::new(camera.status.borrow().calibration.clone()),
        approving: Mutex::default(),
        cameras: vec![Arc::clone(&camera)],
        is_rig: false,
        session: watch::Sender::new(None),
        messages,
        jobs: Jobs::default(),
        events: Arc::clone(&shared.events),
        metrics: Arc::clone(&shared.metrics),
        stop: camera.stop.clone(),
        name,
    };
    // Before the first frame, so that a replay is searched from its beginning.
    let own = start_instrument(instrument, received, unfinished, shared, options)?;
    let capture = Capture::new(Arc::clone(&camera), open, may_stall, options.supervision);
    let detect = Detect::new(Arc::clone(&camera));
    let shown = Arc::clone(&camera);
    let threads = vec![
        spawn("preview", &camera.name, move || preview_thread::run(&shown))?,
        spawn("detect", &camera.name, move || detect.run())?,
        spawn("capture", &camera.name, move || capture.run())?,
    ];
    Ok(RunningCamera { camera, own, threads })
}

/// A camera whose threads do not run yet, with its current calibration.
fn live_camera(
    name: &str,
    kind: &str,
    image_source: String,
    messages: mpsc::Sender<Message>,
    shared: &SharedParts,
) -> Result<LiveCamera, FleetError> {
    let mut status = CameraStatus::starting(name, kind);
    status.calibration = shared.store.current_calibration_id(name)?;
    let current = status.calibration.as_ref();
    let current = current.and_then(|id| CurrentCalibration::read(&shared.store, id, name, name));
    shared.metrics.introduce(name);
    Ok(LiveCamera {
        status: watch::Sender::new(status),
        frames: watch::Sender::new(None),
        search: CurrentSearch::default(),
        slot: FrameSlot::new(),
        messages,
        events: Arc::clone(&shared.events),
        metrics: Arc::clone(&shared.metrics),
        recorder: RecorderLink::default(),
        stop: StopSignal::default(),
        factory: Arc::default(),
        preview: Preview::new(Arc::clone(&shared.maps)),
        guidance: Mutex::default(),
        key_frame: Mutex::default(),
        images: Mutex::default(),
        calibrated: Mutex::new(current),
        rigs: Mutex::default(),
        image_source,
        name: name.to_owned(),
    })
}

/// Starts a rig's threads, with the session that an earlier run left unfinished.
pub(super) fn start_rig(
    name: String,
    cameras: Vec<Arc<LiveCamera>>,
    unfinished: Option<SessionRecord>,
    shared: &SharedParts,
    options: &FleetOptions,
) -> Result<RunningInstrument, FleetError> {
    let (messages, received) = mpsc::channel(QUEUED_FRAME_SETS);
    let instrument = Instrument {
        calibration: watch::Sender::new(shared.store.current_calibration_id(&name)?),
        approving: Mutex::default(),
        cameras,
        is_rig: true,
        session: watch::Sender::new(None),
        messages,
        jobs: Jobs::default(),
        events: Arc::clone(&shared.events),
        metrics: Arc::clone(&shared.metrics),
        stop: StopSignal::default(),
        name,
    };
    let current = instrument.calibration.borrow().clone();
    if let Some(id) = current {
        instrument.share_calibration(&id, &shared.store);
    }
    start_instrument(instrument, received, unfinished, shared, options)
}

fn start_instrument(
    instrument: Instrument,
    received: mpsc::Receiver<Message>,
    unfinished: Option<SessionRecord>,
    shared: &SharedParts,
    options: &FleetOptions,
) -> Result<RunningInstrument, FleetError> {
    let instrument = Arc::new(instrument);
    let mut session = SessionThread::new(
        Arc::clone(&instrument),
        Arc::clone(&shared.store),
        Arc::clone(&shared.health),
        options.auto_approve,
        options.admission,
    );
    if let Some(record) = unfinished {
        session.resume(record);
    }
    let solver = Arc::clone(&instrument);
    // The solve thread is not waited for: a solve that is cut short is started again with the
    // daemon.
    spawn("solve", &instrument.name, move || solve_thread::run(&solver))?;
    let thread = spawn("session", &instrument.name, move || session.run(received))?;
    Ok(RunningInstrument { instrument, thread })
}

fn spawn(
    work: &str,
    name: &str,
    run: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, FleetError> {
    let thread = thread::Builder::new().name(format!("{work}-{name}")).spawn(run);
    thread.map_err(|error| FleetError::Thread { name: name.to_owned(), detail: error.to_string() })
}

/// Ends the threads of `rigs` and `cameras`, all at once; a thread that a driver blocks is left
/// behind.
pub(super) fn stop(rigs: &[RunningInstrument], cameras: &[RunningCamera]) {
    for rig in rigs {
        rig.instrument.ask_to_stop();
    }
    for RunningCamera { camera, own, .. } in cameras {
        own.instrument.ask_to_stop();
        camera.slot.close();
        camera.preview.slot.close();
    }
    let until = Instant::now() + STOP_TIMEOUT;
    let of_cameras =
        cameras.iter().flat_map(|running| running.threads.iter().chain([&running.own.thread]));
    let mut threads = rigs.iter().map(|rig| &rig.thread).chain(of_cameras);
    while threads.clone().any(|thread| !thread.is_finished()) && Instant::now() < until {
        thread::sleep(POLL_INTERVAL);
    }
    for RunningCamera { camera, .. } in cameras {
        camera.recorder.finish();
    }
    if let Some(stuck) = threads.find(|thread| !thread.is_finished()) {
        tracing::warn!(
            "thread {} does not stop and is abandoned",
            stuck.thread().name().unwrap_or("without a name")
        );
    }
}

/// Ends the threads of `cameras` while others run. Blocks until the session threads have ended, so
/// that their last state is stored before another thread resumes a session.
pub(super) fn stop_cameras(cameras: Vec<RunningCamera>) {
    stop(&[], &cameras);
    cameras.into_iter().for_each(|running| running.own.wait_for_end());
}

/// Ends the threads of `rigs`, whose sessions stay as they are; blocks until they have.
pub(super) fn stop_rigs(rigs: Vec<RunningInstrument>) {
    for RunningInstrument { instrument, .. } in &rigs {
        instrument.ask_to_stop();
        instrument.cameras.iter().for_each(|camera| camera.forget_rig(&instrument.name));
    }
    rigs.into_iter().for_each(RunningInstrument::wait_for_end);
}
