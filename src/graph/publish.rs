//! The task that speaks to the graph: what happens goes out, what is asked is done.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::task::{Wake, Waker};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, mpsc, watch};

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::dds::{DdsError, Domain, Durability, Participant, Request, TopicWriter};
use crate::graph::camera::{GraphTopics, KnownCalibration};
use crate::graph::diagnosis;
use crate::graph::driver::Driver;
use crate::graph::results::{Results, SensorInfo};
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::event::{Event, EventKind};
use crate::pipeline::fleet::Fleet;
use crate::recording::ros2_results::{FrameTransform, diagnostics, reply, static_transforms};
use crate::store::Store;

/// As often as ROS's own nodes say how they do.
const DIAGNOSTICS_INTERVAL: Duration = Duration::from_secs(1);
/// How soon the graph, or a camera on it, is tried again.
const RETRY_INTERVAL: Duration = Duration::from_secs(10);
/// Requests to end a session that wait for their answer at once.
const MOST_STOP_REQUESTS: usize = 64;
const TOO_MANY_STOPS: &str = "64 stop requests are already pending; try again later";
const NO_BOARD: &str = "no board is configured: write [ros2] session = { target = { kind = \"chessboard\", cols = …, rows = …, square_m = … } }";

/// What is published, and where.
#[derive(Debug, Clone)]
pub struct GraphPlan {
    /// The graph.
    pub domain: Domain,
    /// What the service `start` begins; `None` refuses it.
    pub session: Option<SessionRequest>,
    /// Whether camera_info comes with each image too, with the image's stamp.
    pub info_with_images: bool,
    /// What rectified images show, by the P of camera_info: with 0 only valid pixels, with 1 all
    /// source pixels.
    pub alpha: f64,
    /// The cameras and rigs, which change with the configuration.
    pub instruments: watch::Receiver<InstrumentsOnGraph>,
}

/// The cameras and rigs on the graph.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct InstrumentsOnGraph {
    /// The cameras.
    pub cameras: Vec<CameraOnGraph>,
    /// The names of the rigs.
    pub rigs: Vec<String>,
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
    /// The camera or rig.
    name: String,
    request: Request,
    reply: Vec<u8>,
}

/// Publishes what the cameras of `fleet` do until the daemon ends. A graph that cannot be joined,
/// as before there is a network, is tried again.
pub async fn publish(fleet: Arc<Fleet>, store: Arc<Store>, plan: GraphPlan) {
    let mut instruments = plan.instruments.clone();
    let mut graph = joined(RETRY_INTERVAL, || GraphTask::join(&fleet, &store, &plan)).await;
    let mut events = fleet.events(None);
    let known = instruments.borrow_and_update().clone();
    graph.take_instruments(known).await;
    let woken = Arc::new(Woken::default());
    let waker = Waker::from(Arc::clone(&woken));
    let (ended, mut endings) = mpsc::channel(MOST_STOP_REQUESTS);
    let mut seconds = tokio::time::interval(DIAGNOSTICS_INTERVAL);
    let mut retries = tokio::time::interval(RETRY_INTERVAL);
    loop {
        graph.topics.values().for_each(|topics| topics.wake(&waker));
        graph.serve(&ended).await;
        tokio::select! {
            event = events.next() => graph.take(&event).await,
            () = woken.0.notified() => graph.drivers(0),
            Some(ended) = endings.recv() => graph.answer(&ended),
            Ok(()) = instruments.changed() => {
                let known = instruments.borrow_and_update().clone();
                graph.take_instruments(known).await;
            }
            _ = seconds.tick() => {
                graph.drivers(1);
                graph.diagnose();
            }
            _ = retries.tick() => graph.advertise().await,
        }
    }
}

/// The graph, as soon as `join` gives it; tried again after `wait` each. A reason is said once.
async fn joined<T>(wait: Duration, mut join: impl FnMut() -> Result<T, DdsError>) -> T {
    let mut said = String::new();
    loop {
        match join() {
            Ok(graph) => return graph,
            Err(error) => {
                let reason = error.to_string();
                if reason != said {
                    tracing::error!("nothing is published on the graph, tried again: {reason}");
                    said = reason;
                }
            }
        }
        tokio::time::sleep(wait).await;
    }
}

struct GraphTask {
    fleet: Arc<Fleet>,
    store: Arc<Store>,
    session: Option<SessionRequest>,
    info_with_images: bool,
    alpha: f64,
    participant: Arc<Participant>,
    instruments: InstrumentsOnGraph,
    /// By the name of the camera or rig.
    topics: BTreeMap<String, GraphTopics>,
    /// Why those that have none have none.
    refused: BTreeMap<String, String>,
    transforms: TopicWriter,
    diagnostics: TopicWriter,
}

impl GraphTask {
    fn join(fleet: &Arc<Fleet>, store: &Arc<Store>, plan: &GraphPlan) -> Result<Self, DdsError> {
        let participant = Participant::join(plan.domain)?;
        let transforms =
            participant.advertise("/tf_static", "tf2_msgs/msg/TFMessage", Durability::Latched)?;
        let diagnostics = participant.advertise(
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            Durability::Volatile,
        )?;
        Ok(Self {
            fleet: Arc::clone(fleet),
            store: Arc::clone(store),
            session: plan.session.clone(),
            info_with_images: plan.info_with_images,
            alpha: plan.alpha,
            participant,
            instruments: InstrumentsOnGraph::default(),
            topics: BTreeMap::new(),
            refused: BTreeMap::new(),
            transforms,
            diagnostics,
        })
    }

    /// Has the graph show these cameras and rigs; those that are as they were do not notice.
    async fn take_instruments(&mut self, known: InstrumentsOnGraph) {
        let before = std::mem::replace(&mut self.instruments, known.clone());
        let stays = |name: &str| {
            let of = |all: &InstrumentsOnGraph| all.camera(name).cloned();
            let is_rig = |all: &InstrumentsOnGraph| all.rigs.iter().any(|rig| rig == name);
            of(&before) == of(&known) && is_rig(&before) == is_rig(&known)
        };
        self.topics.retain(|name, _| known.names().any(|other| other == name) && stays(name));
        self.advertise().await;
        // Who is gone is in no frame any more.
        self.publish_transforms();
    }

    /// Offers the topics of the cameras and rigs that have none yet; what is refused is tried
    /// again later, and said once.
    async fn advertise(&mut self) {
        let known = &self.instruments;
        let names = known.names().filter(|name| !self.topics.contains_key(*name));
        let new: Vec<String> = names.map(str::to_owned).collect();
        self.refused.retain(|name, _| new.contains(name));
        for name in new {
            let camera = self.instruments.camera(&name);
            let service = camera.and_then(|camera| camera.set_camera_info.as_deref());
            match GraphTopics::new(&self.participant, &name, service) {
                Ok(topics) => {
                    self.topics.insert(name.clone(), topics);
                    self.publish_current(&name).await;
                }
                Err(error) => {
                    let reason = error.to_string();
                    if self.refused.get(&name) != Some(&reason) {
                        tracing::error!("{name} is not on the graph, tried again: {reason}");
                        self.refused.insert(name, reason);
                    }
                }
            }
        }
    }

    /// What is current already of a camera or rig that comes.
    async fn publish_current(&mut self, name: &str) {
        let sessions = self.fleet.live_sessions();
        let session = sessions.iter().find(|session| session.camera == name);
        if let Some(topics) = self.topics.get_mut(name) {
            warn(topics.say(session.map_or("idle", |session| session.state.name())));
        }
        let calibration = match self.fleet.rig(name) {
            Ok(rig) => rig.calibration,
            Err(_) => self.fleet.camera(name).ok().and_then(|camera| camera.calibration),
        };
        if let Some(id) = calibration {
            self.publish_calibration(name, id, false).await;
        }
    }

    async fn take(&mut self, event: &Event) {
        if let (EventKind::Frame(frame), true) = (&event.kind, self.info_with_images) {
            // Its own topic, and those of the rigs that it is in.
            for topics in self.topics.values() {
                warn(topics.publish_with_image(&event.camera, frame.host_time_ns));
            }
        }
        let Some(topics) = self.topics.get_mut(&event.camera) else { return };
        match &event.kind {
            EventKind::Session(record) => warn(topics.say(record.state.name())),
            EventKind::Calibration(made) if made.current => {
                self.publish_calibration(&event.camera, made.id.clone(), true).await;
                self.drivers(0);
                self.diagnose();
            }
            EventKind::Drift(drift) => {
                // Without a residual it is in the state too, for as long as it is so.
                if drift.rms_px.is_some() {
                    topics.known.residual_drift = Some(drift.reason.clone());
                }
                self.diagnose();
            }
            EventKind::Camera(_) => self.diagnose(),
            EventKind::Calibration(_) | EventKind::Frame(_) | EventKind::Detection(_) => {}
        }
    }

    /// Publishes a calibration; has the drivers of its cameras keep it where it is `new`.
    async fn publish_calibration(&mut self, name: &str, id: String, new: bool) {
        let store = Arc::clone(&self.store);
        let read = tokio::task::spawn_blocking(move || store.calibration(&id)).await;
        let calibration = match read {
            Ok(Ok(Some(calibration))) => calibration,
            Ok(Err(error)) => return tracing::warn!("{error}"),
            Ok(Ok(None)) | Err(_) => return,
        };
        let results = Results::of(name, &calibration, self.alpha);
        if new {
            self.have_kept(&results);
        }
        if let Some(topics) = self.topics.get_mut(name) {
            warn(topics.publish(results));
        }
        self.publish_transforms();
    }

    /// Gives each camera's driver what is known of the camera: of several sensors the first.
    fn have_kept(&mut self, results: &Results) {
        let mut given: Vec<&str> = Vec::new();
        for SensorInfo { camera, message, .. } in &results.infos {
            let topics = self.topics.get_mut(camera);
            if let Some(driver) = topics.and_then(|topics| topics.driver.as_mut())
                && !given.contains(&camera.as_str())
            {
                driver.keep(message.clone());
                given.push(camera);
            }
        }
    }

    fn publish_transforms(&self) {
        let known = self.topics.values().filter_map(|topics| topics.known.results.as_ref());
        let transforms: Vec<FrameTransform> =
            known.flat_map(|results| results.transforms.iter().cloned()).collect();
        if !transforms.is_empty() {
            warn(self.transforms.send(static_transforms(&transforms, utc_now_ns())));
        }
    }

    fn drivers(&mut self, seconds: u32) {
        for driver in self.topics.values_mut().filter_map(|topics| topics.driver.as_mut()) {
            driver.advance(&self.participant, seconds);
        }
    }

    fn diagnose(&self) {
        let now_ns = utc_now_ns();
        let unknown = KnownCalibration::default();
        let known = |name: &str| self.topics.get(name).map_or(&unknown, |topics| &topics.known);
        let cameras = self.fleet.cameras().into_iter().map(|status| {
            let topics = self.topics.get(&status.name);
            let driver = topics.and_then(|topics| topics.driver.as_ref()).map(Driver::words);
            diagnosis::of(&status, known(&status.name), driver, now_ns)
        });
        let rigs = self.fleet.rigs().into_iter();
        let rigs = rigs.map(|status| diagnosis::of_rig(&status, known(&status.name), now_ns));
        let all: Vec<_> = cameras.chain(rigs).collect();
        warn(self.diagnostics.send(diagnostics(&all, now_ns)));
    }

    /// Does what has been asked.
    async fn serve(&mut self, ended: &mpsc::Sender<Ended>) {
        let names: Vec<String> = self.topics.keys().cloned().collect();
        for name in names {
            while let Some(request) = self.topics[&name].start.take(Instant::now()) {
                let (started, words) = self.start(&name).await;
                warn(self.topics[&name].start.reply(&request, reply(started, &words)));
            }
            while let Some(request) = self.topics[&name].stop.take(Instant::now()) {
                self.stop(&name, request, ended).await;
            }
        }
    }

    async fn start(&self, name: &str) -> (bool, String) {
        let Some(session) = self.session.clone() else { return (false, NO_BOARD.to_owned()) };
        let started = match self.fleet.rig(name) {
            Ok(_) => self.fleet.start_rig_session(name, session).await,
            Err(_) => self.fleet.start_session(name, session).await,
        };
        match started {
            Ok(record) => (true, format!("session {} started", record.id)),
            Err(error) => (false, error.to_string()),
        }
    }

    /// Ends the session of a camera or rig; the answer comes with its result.
    async fn stop(&self, name: &str, request: Request, ended: &mpsc::Sender<Ended>) {
        let sessions = self.fleet.live_sessions();
        let runs =
            |session: &&Arc<SessionRecord>| session.camera == name && !session.state.is_over();
        let refuse = |words: &str| {
            warn(self.topics[name].stop.reply(&request, reply(false, words)));
        };
        let Some(session) = sessions.iter().find(runs) else {
            return refuse("no session runs; start one first");
        };
        let Ok(place) = ended.clone().try_reserve_owned() else { return refuse(TOO_MANY_STOPS) };
        if let Err(error) = self.fleet.stop_session(&session.id).await {
            return refuse(&error.to_string());
        }
        let (fleet, id) = (Arc::clone(&self.fleet), session.id.clone());
        let name = name.to_owned();
        tokio::spawn(async move {
            let reply = match fleet.session_over(&id).await {
                Ok(record) => outcome(&record),
                Err(error) => reply(false, &error.to_string()),
            };
            place.send(Ended { name, request, reply });
        });
    }

    fn answer(&self, ended: &Ended) {
        if let Some(topics) = self.topics.get(&ended.name) {
            warn(topics.stop.reply(&ended.request, ended.reply.clone()));
        }
    }
}

impl InstrumentsOnGraph {
    fn camera(&self, name: &str) -> Option<&CameraOnGraph> {
        self.cameras.iter().find(|camera| camera.name == name)
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        let cameras = self.cameras.iter().map(|camera| camera.name.as_str());
        cameras.chain(self.rigs.iter().map(String::as_str))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_graph_that_cannot_be_joined_is_tried_again() {
        let mut left = 3;
        let join = || {
            left -= 1;
            let detail = "no network".to_owned();
            if left > 0 { Err(DdsError::Join { domain_id: 0, detail }) } else { Ok("joined") }
        };
        assert_eq!(joined(Duration::ZERO, join).await, "joined");
        assert_eq!(left, 0);
    }
}
