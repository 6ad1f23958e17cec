//! The task that speaks to the graph: what happens goes out, what is asked is done.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::task::{Wake, Waker};
use std::time::Duration;

use tokio::sync::{Notify, mpsc};

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::dds::{DdsError, Domain, Durability, Participant, Request, TopicWriter};
use crate::graph::camera::GraphTopics;
use crate::graph::diagnosis;
use crate::graph::results::Results;
use crate::pipeline::camera_status::CameraStatus;
use crate::pipeline::event::{Event, EventKind};
use crate::pipeline::fleet::Fleet;
use crate::recording::ros2_results::{FrameTransform, diagnostics, reply, static_transforms};
use crate::store::Store;

/// As often as ROS's own nodes say how they do.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
/// Sessions that are being ended at once.
const ENDING: usize = 64;
const NO_BOARD: &str = "no board is configured: write [ros2] session = { target = { kind = \"chessboard\", cols = …, rows = …, square_m = … } }";

/// What is published, and where.
#[derive(Debug, Clone, PartialEq)]
pub struct GraphPlan {
    /// The graph.
    pub domain: Domain,
    /// What the service `start` begins; `None` refuses it.
    pub session: Option<SessionRequest>,
    /// The cameras.
    pub cameras: Vec<CameraOnGraph>,
}

/// A camera on the graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraOnGraph {
    /// Its name.
    pub name: String,
    /// The service of its driver that keeps a calibration, if ROS 2 has a driver of it.
    pub set_camera_info: Option<String>,
}

/// Wakes the task.
#[derive(Debug, Default)]
struct Woken(Notify);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.notify_one();
    }
}

/// The answer to who asked to stop a session.
struct Ended {
    camera: String,
    request: Request,
    reply: Vec<u8>,
}

/// Publishes what the cameras of `fleet` do until the daemon ends.
///
/// # Errors
/// [`DdsError`] when the graph cannot be joined.
pub async fn publish(
    fleet: Arc<Fleet>,
    store: Arc<Store>,
    plan: GraphPlan,
) -> Result<(), DdsError> {
    let mut events = fleet.events(None);
    let mut graph = GraphTask::join(fleet, store, plan)?;
    graph.publish_current().await;
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(Arc::clone(&woken));
    let (ended, mut endings) = mpsc::channel(ENDING);
    let mut seconds = tokio::time::interval(DIAGNOSTICS);
    loop {
        graph.cameras.values().for_each(|camera| camera.wake(&waker));
        graph.serve(&ended).await;
        tokio::select! {
            event = events.next() => graph.take(&event).await,
            () = woken.0.notified() => graph.drivers(0),
            Some(ended) = endings.recv() => graph.answer(&ended),
            _ = seconds.tick() => {
                graph.drivers(1);
                graph.diagnose();
            }
        }
    }
}

struct GraphTask {
    fleet: Arc<Fleet>,
    store: Arc<Store>,
    session: Option<SessionRequest>,
    participant: Arc<Participant>,
    cameras: BTreeMap<String, GraphTopics>,
    transforms: TopicWriter,
    diagnostics: TopicWriter,
}

impl GraphTask {
    fn join(fleet: Arc<Fleet>, store: Arc<Store>, plan: GraphPlan) -> Result<Self, DdsError> {
        let participant = Participant::join(plan.domain)?;
        let transforms =
            participant.advertise("/tf_static", "tf2_msgs/msg/TFMessage", Durability::Latched)?;
        let diagnostics = participant.advertise(
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            Durability::Volatile,
        )?;
        let mut cameras = BTreeMap::new();
        for CameraOnGraph { name, set_camera_info } in plan.cameras {
            let topics = GraphTopics::new(&participant, &name, set_camera_info.as_deref())?;
            cameras.insert(name, topics);
        }
        let session = plan.session;
        Ok(Self { fleet, store, session, participant, cameras, transforms, diagnostics })
    }

    /// What is current already when the daemon starts.
    async fn publish_current(&mut self) {
        for status in self.fleet.cameras() {
            let sessions = self.fleet.live_sessions();
            let session = sessions.iter().find(|session| session.camera == status.name);
            if let Some(camera) = self.cameras.get_mut(&status.name) {
                warn(camera.say(session.map_or("idle", |session| session.state.name())));
            }
            if let Some(id) = status.calibration {
                self.publish_calibration(&status.name, id, false).await;
            }
        }
    }

    async fn take(&mut self, event: &Event) {
        let Some(camera) = self.cameras.get_mut(&event.camera) else { return };
        match &event.kind {
            EventKind::Session(record) => warn(camera.say(record.state.name())),
            EventKind::Calibration(made) if made.current => {
                self.publish_calibration(&event.camera, made.id.clone(), true).await;
                self.drivers(0);
                self.diagnose();
            }
            EventKind::Drift(drift) => {
                camera.drift = Some(drift.reason.clone());
                self.diagnose();
            }
            EventKind::Camera(_) => self.diagnose(),
            EventKind::Calibration(_) | EventKind::Frame(_) | EventKind::Detection(_) => {}
        }
    }

    async fn publish_calibration(&mut self, name: &str, id: String, new: bool) {
        let store = Arc::clone(&self.store);
        let read = tokio::task::spawn_blocking(move || store.calibration(&id)).await;
        let calibration = match read {
            Ok(Ok(Some(calibration))) => calibration,
            Ok(Err(error)) => return tracing::warn!("{error}"),
            Ok(Ok(None)) | Err(_) => return,
        };
        let results = Results::of(name, &calibration);
        if let Some(camera) = self.cameras.get_mut(name) {
            warn(camera.publish(results, new));
        }
        let known = self.cameras.values().filter_map(|camera| camera.results.as_ref());
        let transforms: Vec<FrameTransform> =
            known.flat_map(|results| results.transforms.iter().cloned()).collect();
        if !transforms.is_empty() {
            warn(self.transforms.send(static_transforms(&transforms, utc_now_ns())));
        }
    }

    fn drivers(&mut self, seconds: u32) {
        for driver in self.cameras.values_mut().filter_map(|camera| camera.driver.as_mut()) {
            driver.advance(&self.participant, seconds);
        }
    }

    fn diagnose(&self) {
        let now_ns = utc_now_ns();
        let of = |status: CameraStatus| {
            let camera = self.cameras.get(&status.name);
            diagnosis::of(&status, camera, now_ns)
        };
        let cameras: Vec<_> = self.fleet.cameras().into_iter().map(of).collect();
        warn(self.diagnostics.send(diagnostics(&cameras, now_ns)));
    }

    /// Does what has been asked.
    async fn serve(&mut self, ended: &mpsc::Sender<Ended>) {
        let names: Vec<String> = self.cameras.keys().cloned().collect();
        for name in names {
            while let Some(request) = self.cameras[&name].start.take() {
                let (started, words) = self.start(&name).await;
                warn(self.cameras[&name].start.reply(&request, reply(started, &words)));
            }
            while let Some(request) = self.cameras[&name].stop.take() {
                self.stop(&name, request, ended).await;
            }
        }
    }

    async fn start(&self, camera: &str) -> (bool, String) {
        let Some(session) = self.session.clone() else { return (false, NO_BOARD.to_owned()) };
        match self.fleet.start_session(camera, session).await {
            Ok(record) => (true, format!("session {} collects", record.id)),
            Err(error) => (false, error.to_string()),
        }
    }

    /// Ends the camera's session; the answer comes with its result.
    async fn stop(&self, camera: &str, request: Request, ended: &mpsc::Sender<Ended>) {
        let sessions = self.fleet.live_sessions();
        let runs =
            |session: &&Arc<SessionRecord>| session.camera == camera && !session.state.is_over();
        let refuse = |words: &str| {
            warn(self.cameras[camera].stop.reply(&request, reply(false, words)));
        };
        let Some(session) = sessions.iter().find(runs) else {
            return refuse("no session runs; start one first");
        };
        if let Err(error) = self.fleet.stop_session(&session.id).await {
            return refuse(&error.to_string());
        }
        let (fleet, id) = (Arc::clone(&self.fleet), session.id.clone());
        let (camera, ended) = (camera.to_owned(), ended.clone());
        tokio::spawn(async move {
            let reply = match fleet.session_over(&id).await {
                Ok(record) => outcome(&record),
                Err(error) => reply(false, &error.to_string()),
            };
            // Nobody takes it when the daemon goes down.
            let _ = ended.send(Ended { camera, request, reply }).await;
        });
    }

    fn answer(&self, ended: &Ended) {
        if let Some(camera) = self.cameras.get(&ended.camera) {
            warn(camera.stop.reply(&ended.request, ended.reply.clone()));
        }
    }
}

fn outcome(record: &SessionRecord) -> Vec<u8> {
    match (&record.calibration, &record.reason) {
        (Some(calibration), _) => reply(true, &format!("calibration {calibration}")),
        (None, reason) => reply(false, reason.as_deref().unwrap_or(record.state.name())),
    }
}

fn warn(outcome: Result<(), DdsError>) {
    if let Err(error) = outcome {
        tracing::warn!("{error}");
    }
}

fn utc_now_ns() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
