//! Sets one camera going: its threads and what links them.

use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};

use tokio::sync::{mpsc, watch};

use crate::calibration::admission::AdmissionOptions;
use crate::calibration::session_record::SessionRecord;
use crate::calibration::view::View;
use crate::capture::SourceOpener;
use crate::pipeline::board_look::BoardLook;
use crate::pipeline::camera_status::CameraStatus;
use crate::pipeline::capture_thread::{Capture, Supervision};
use crate::pipeline::detect_thread::Detect;
use crate::pipeline::event::EventLog;
use crate::pipeline::fleet::FleetError;
use crate::pipeline::frame_rate::FrameRate;
use crate::pipeline::frame_slot::FrameSlot;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::metrics::Metrics;
use crate::pipeline::preview::Preview;
use crate::pipeline::preview::maps::CalibrationMaps;
use crate::pipeline::preview_thread;
use crate::pipeline::recorder::RecorderLink;
use crate::pipeline::search::CurrentSearch;
use crate::pipeline::session_thread::SessionThread;
use crate::pipeline::solve_thread;
use crate::pipeline::stop_signal::StopSignal;
use crate::store::Store;

/// A camera to set going.
pub struct CameraPlan {
    /// Its name in the configuration.
    pub name: String,
    /// The kind of its source, as in the configuration.
    pub kind: String,
    /// Opens the source.
    pub open: Box<dyn SourceOpener>,
    /// Whether silence means that the device is lost; not so for frames on disk.
    pub may_stall: bool,
}

/// How the cameras run.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetOptions {
    /// Whether a `good` calibration becomes current by itself. Default: true.
    pub auto_approve: bool,
    /// How sources are watched over.
    pub supervision: Supervision,
    /// What a detection must be to become a view.
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

/// Frames on their way to the session thread; more would only be old ones.
const QUEUE: usize = 4;

/// Starts a camera's threads, with the session that an earlier run left unfinished.
pub(super) fn start_camera(
    plan: CameraPlan,
    unfinished: Option<(SessionRecord, Vec<View>)>,
    shared: &SharedParts,
    options: &FleetOptions,
) -> Result<(Arc<LiveCamera>, Vec<JoinHandle<()>>), FleetError> {
    let CameraPlan { name, kind, open, may_stall } = plan;
    let (messages, received) = mpsc::channel(QUEUE);
    let mut status = CameraStatus::starting(&name, &kind);
    status.calibration = shared.store.current_calibration_id(&name)?;
    shared.metrics.introduce(&name);
    let camera = Arc::new(LiveCamera {
        status: watch::Sender::new(status),
        frames: watch::Sender::new(None),
        session: watch::Sender::new(None),
        search: CurrentSearch::default(),
        slot: FrameSlot::new(),
        messages,
        events: Arc::clone(&shared.events),
        metrics: Arc::clone(&shared.metrics),
        recorder: RecorderLink::default(),
        stop: StopSignal::default(),
        factory: Mutex::default(),
        preview: Preview::new(Arc::clone(&shared.maps)),
        outline_px: Mutex::default(),
        name,
    });
    let (jobs, asked) = std::sync::mpsc::channel();
    let mut session = SessionThread {
        camera: Arc::clone(&camera),
        store: Arc::clone(&shared.store),
        jobs,
        auto_approve: options.auto_approve,
        admission: options.admission,
        session: None,
        board_look: BoardLook::default(),
        lent_to: None,
        drift: None,
    };
    // Before the first frame, so that a replay begins with what is to be looked for.
    if let Some((record, views)) = unfinished {
        session.resume(record, views);
    }
    let capture = Capture {
        camera: Arc::clone(&camera),
        open,
        supervision: options.supervision,
        may_stall,
        rate: FrameRate::default(),
        retry: options.supervision.first_retry,
    };
    let detect = Detect::new(Arc::clone(&camera));
    let solver = Arc::clone(&camera);
    // Nobody waits for the solve thread: a solve that is cut short is begun again with the next
    // start.
    spawn("solve", &camera.name, move || solve_thread::run(&solver, &asked))?;
    let shown = Arc::clone(&camera);
    let threads = vec![
        spawn("preview", &camera.name, move || preview_thread::run(&shown))?,
        spawn("session", &camera.name, move || session.run(received))?,
        spawn("detect", &camera.name, move || detect.run())?,
        spawn("capture", &camera.name, move || capture.run())?,
    ];
    Ok((camera, threads))
}

/// What all cameras share.
#[derive(Debug)]
pub(super) struct SharedParts {
    pub(super) events: Arc<EventLog>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) store: Arc<Store>,
    pub(super) maps: Arc<CalibrationMaps>,
}

fn spawn(
    work: &str,
    camera: &str,
    run: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, FleetError> {
    let thread = thread::Builder::new().name(format!("{work}-{camera}")).spawn(run);
    thread.map_err(|error| FleetError::Thread {
        camera: camera.to_owned(),
        detail: error.to_string(),
    })
}
