//! All cameras of the daemon as one live object: the only thing that the layers above talk to.

use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::pipeline::camera_threads::{CameraPlan, FleetOptions, SharedParts, start_camera};
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::event::{CalibrationEvent, EventKind, EventLog, EventStream};
use crate::pipeline::fleet_rigs::RunningRig;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::LiveFrame;
use crate::pipeline::live_rig::LiveRig;
use crate::pipeline::message::Message;
use crate::pipeline::metrics::Metrics;
use crate::pipeline::preview::PreviewReceiver;
use crate::pipeline::preview::drawing::{Drawing, EncodedFrame};
use crate::pipeline::preview::error::PreviewError;
use crate::pipeline::preview::maps::CalibrationMaps;
use crate::pipeline::recorder::{RecordError, RecordingLimits, RecordingState, RecordingStatus};
use crate::pipeline::rig_inbox::RigMessage;
use crate::pipeline::session_request::{EndError, StartError};
use crate::pipeline::unknown::UnknownCamera;
use crate::store::{Store, StoreError};

/// Why the cameras were not set going.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// What an earlier run left could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The system gives no more threads.
    #[error("a thread for camera `{camera}` could not be started: {detail}")]
    Thread {
        /// The camera's name.
        camera: String,
        /// What the system said.
        detail: String,
    },
    /// The counters could not be set up.
    #[error("the metrics could not be set up: {detail}")]
    Metrics {
        /// What was wrong.
        detail: String,
    },
}

/// Why a calibration did not become current.
#[derive(Debug, thiserror::Error)]
pub enum ApproveError {
    /// No such calibration.
    #[error(
        "there is no calibration `{id}`; see GET /v1/cameras/{{camera}}/calibrations for those there are"
    )]
    UnknownCalibration {
        /// The id that was asked for.
        id: String,
    },
    /// It is of no camera.
    #[error("calibration {id} belongs to no camera")]
    NoCamera {
        /// The id that was asked for.
        id: String,
    },
    /// It could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// How long threads have to end.
const LAST_WAIT: Duration = Duration::from_millis(700);
const GLANCE: Duration = Duration::from_millis(2);

/// All cameras, live. Reading never waits on a camera or a solve.
#[derive(Debug)]
pub struct Fleet {
    cameras: RwLock<Vec<RunningCamera>>,
    pub(super) rigs: RwLock<Vec<RunningRig>>,
    pub(super) shared: SharedParts,
    pub(super) options: FleetOptions,
}

/// A camera with the threads that work for it.
#[derive(Debug)]
struct RunningCamera {
    camera: Arc<LiveCamera>,
    threads: Vec<JoinHandle<()>>,
}

/// Whose a session is.
enum Owner {
    Camera(Arc<LiveCamera>),
    Rig(Arc<LiveRig>),
}

impl Owner {
    fn session(&self) -> &watch::Sender<Option<Arc<SessionRecord>>> {
        match self {
            Self::Camera(camera) => &camera.session,
            Self::Rig(rig) => &rig.session,
        }
    }
}

type EndReply = oneshot::Sender<Result<SessionRecord, EndError>>;

impl Fleet {
    /// Sets every camera going, and goes on with the sessions that an earlier run left unfinished.
    ///
    /// # Errors
    /// [`FleetError`].
    pub fn start(
        plans: Vec<CameraPlan>,
        store: Arc<Store>,
        options: &FleetOptions,
    ) -> Result<Self, FleetError> {
        let metrics =
            Metrics::new().map_err(|error| FleetError::Metrics { detail: error.to_string() })?;
        // Microseconds: more than events ever come in, so that ids grow over restarts, and exact in
        // JavaScript.
        let events = Arc::new(EventLog::new((utc_now_ns() / 1000).max(0).unsigned_abs()));
        let maps = Arc::new(CalibrationMaps::new(Arc::clone(&store)));
        let shared = SharedParts { events, metrics: Arc::new(metrics), store, maps };
        let fleet = Self {
            cameras: RwLock::default(),
            rigs: RwLock::default(),
            shared,
            options: options.clone(),
        };
        // A fleet that is dropped half started ends the threads that it has.
        fleet.replace_cameras(&[], plans)?;
        for (record, _) in fleet.shared.store.unfinished_sessions()? {
            if record.members.is_empty() && fleet.link(&record.camera).is_err() {
                let SessionRecord { id, camera, .. } = record;
                tracing::warn!(
                    session = id,
                    camera,
                    "unfinished session of a camera that is not configured"
                );
            }
        }
        Ok(fleet)
    }

    /// Stops the cameras named `stopped` and sets those of `plans` going, with the sessions that
    /// were left unfinished. The others do not notice. Blocks for less than a second.
    ///
    /// # Errors
    /// [`FleetError`]; cameras before the one that failed are running then.
    pub fn replace_cameras(
        &self,
        stopped: &[String],
        plans: Vec<CameraPlan>,
    ) -> Result<(), FleetError> {
        let mut cameras = self.cameras.write().unwrap_or_else(PoisonError::into_inner);
        let (leaving, staying): (Vec<_>, Vec<_>) =
            cameras.drain(..).partition(|running| stopped.contains(&running.camera.name));
        *cameras = staying;
        stop(&leaving);
        let mut unfinished = self.shared.store.unfinished_sessions()?;
        for plan in plans {
            let left = unfinished.iter().rposition(|(record, _)| record.camera == plan.name);
            let left = left.map(|at| unfinished.remove(at));
            let (camera, threads) = start_camera(plan, left, &self.shared, &self.options)?;
            cameras.push(RunningCamera { camera, threads });
        }
        Ok(())
    }

    /// Ends every thread; sessions stay as they are and go on with the next start. Blocks for less
    /// than a second: a thread that a driver does not let go is left behind.
    pub fn shutdown(&self) {
        // Rigs first: a replay may wait for one.
        let rigs = std::mem::take(&mut *self.rigs.write().unwrap_or_else(PoisonError::into_inner));
        rigs.iter().for_each(|running| running.rig.inbox.close());
        let leaving =
            std::mem::take(&mut *self.cameras.write().unwrap_or_else(PoisonError::into_inner));
        stop(&leaving);
        let until = Instant::now() + LAST_WAIT;
        while rigs.iter().any(|running| !running.thread.is_finished()) && Instant::now() < until {
            std::thread::sleep(GLANCE);
        }
    }

    /// Makes a calibration its camera's current one.
    ///
    /// # Errors
    /// [`ApproveError`].
    pub fn approve(&self, id: &str) -> Result<(), ApproveError> {
        let unknown = || ApproveError::UnknownCalibration { id: id.to_owned() };
        let calibration = self.shared.store.calibration(id)?.ok_or_else(unknown)?;
        let name = calibration
            .camera
            .as_ref()
            .ok_or_else(|| ApproveError::NoCamera { id: id.to_owned() })?;
        self.shared.store.set_current(name, id)?;
        if let Ok(camera) = self.link(name) {
            camera.status.send_modify(|status| status.calibration = Some(id.to_owned()));
        } else if let Ok(rig) = self.rig_link(name) {
            rig.calibration.send_replace(Some(id.to_owned()));
        }
        if let Some(event) = CalibrationEvent::of(&calibration, true) {
            self.shared.events.publish(name, EventKind::Calibration(event));
        }
        Ok(())
    }

    /// Records the camera `name` into the store's folder until stopped or a limit is reached.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn start_recording(
        &self,
        name: &str,
        limits: RecordingLimits,
    ) -> Result<RecordingStatus, RecordError> {
        let link = self
            .link(name)
            .map_err(|UnknownCamera { camera }| RecordError::UnknownCamera { camera })?;
        link.recorder.start(name, &self.shared.store.folder().join("recordings"), limits)
    }

    /// Ends recording `id`; its file is whole when this returns.
    ///
    /// # Errors
    /// [`RecordError::UnknownRecording`], [`RecordError::Over`].
    pub fn stop_recording(&self, id: &str) -> Result<RecordingStatus, RecordError> {
        let of = |running: &&RunningCamera| {
            running.camera.recorder.status().is_some_and(|status| status.id == id)
        };
        let found = self.running().iter().find(of).map(|running| Arc::clone(&running.camera));
        let camera = found.ok_or_else(|| RecordError::UnknownRecording { id: id.to_owned() })?;
        let over = || RecordError::Over { id: id.to_owned() };
        camera
            .recorder
            .status()
            .filter(|status| status.state == RecordingState::Recording)
            .ok_or_else(over)?;
        camera.recorder.finish().ok_or_else(over)
    }

    /// The newest recording of each camera since the daemon started.
    pub fn recordings(&self) -> Vec<RecordingStatus> {
        self.running().iter().filter_map(|running| running.camera.recorder.status()).collect()
    }

    /// The counters in Prometheus's text format, version 0.0.4.
    pub fn metrics_text(&self) -> String {
        self.shared.metrics.text()
    }

    /// Every camera, in the order of the configuration.
    pub fn cameras(&self) -> Vec<CameraStatus> {
        self.running().iter().map(|running| running.camera.status.borrow().clone()).collect()
    }

    /// One camera.
    ///
    /// # Errors
    /// [`UnknownCamera`].
    pub fn camera(&self, name: &str) -> Result<CameraStatus, UnknownCamera> {
        let camera = self.link(name)?;
        let status = camera.status.borrow().clone();
        Ok(status)
    }

    /// Whether any camera delivers.
    pub fn is_ready(&self) -> bool {
        self.running()
            .iter()
            .any(|running| running.camera.status.borrow().state == CameraState::Streaming)
    }

    /// A camera's newest frame with what was seen in it, now and as it changes; `None` before the
    /// first.
    ///
    /// # Errors
    /// [`UnknownCamera`].
    pub fn frames(
        &self,
        name: &str,
    ) -> Result<watch::Receiver<Option<Arc<LiveFrame>>>, UnknownCamera> {
        Ok(self.link(name)?.frames.subscribe())
    }

    /// What a camera sees from now on, drawn and encoded once for all who ask for the same drawing.
    ///
    /// # Errors
    /// [`UnknownCamera`].
    pub fn preview(&self, name: &str, drawing: Drawing) -> Result<PreviewReceiver, UnknownCamera> {
        let camera = self.link(name)?;
        let newest = camera.frames.borrow().clone();
        Ok(camera.preview.watch(drawing, newest))
    }

    /// A camera's newest frame, drawn and encoded; blocks meanwhile.
    ///
    /// # Errors
    /// [`PreviewError`].
    pub fn newest_frame(&self, name: &str, drawing: Drawing) -> Result<EncodedFrame, PreviewError> {
        let camera = self.link(name)?;
        let newest = camera.frames.borrow().clone();
        let live = newest.ok_or_else(|| {
            let status = camera.status.borrow();
            let (camera, reason) = (name.to_owned(), status.reason.clone());
            PreviewError::NoFrame { camera, state: status.state, reason }
        })?;
        Ok(camera.preview.encoded(&live, drawing, &camera.preview_state())?.0)
    }

    /// The newest session of each camera and each rig since the daemon started, running or over.
    /// Older ones are in the store.
    pub fn live_sessions(&self) -> Vec<Arc<SessionRecord>> {
        let of_rigs: Vec<_> = self
            .running_rigs()
            .iter()
            .filter_map(|running| running.rig.session.borrow().clone())
            .collect();
        let of_cameras = self
            .running()
            .iter()
            .filter_map(|running| running.camera.session.borrow().clone())
            .collect();
        [of_cameras, of_rigs].concat()
    }

    /// The session `id`, if it is the newest of its camera or rig since the daemon started. Older
    /// ones are in the store.
    pub fn live_session(&self, id: &str) -> Option<Arc<SessionRecord>> {
        self.owner(id).and_then(|owner| owner.session().borrow().clone())
    }

    /// Starts a session on the camera `name`; it is stored when this returns.
    ///
    /// # Errors
    /// [`StartError`].
    pub async fn start_session(
        &self,
        name: &str,
        request: SessionRequest,
    ) -> Result<SessionRecord, StartError> {
        let link = self
            .link(name)
            .map_err(|UnknownCamera { camera }| StartError::UnknownCamera { camera })?;
        let (reply, answer) = oneshot::channel();
        link.messages
            .send(Message::Start(request, reply))
            .await
            .map_err(|_| StartError::Stopping)?;
        answer.await.map_err(|_| StartError::Stopping)?
    }

    /// Ends the collecting of session `id` and begins to solve; returns without waiting for the
    /// solve, see [`Self::session_over`]. A session that solves already is left to it.
    ///
    /// # Errors
    /// [`EndError`]; a session that is not the newest of its camera counts as unknown here.
    pub async fn stop_session(&self, id: &str) -> Result<SessionRecord, EndError> {
        self.end_session(id, Message::Stop, RigMessage::Stop).await
    }

    /// Gives session `id` up; its views stay stored.
    ///
    /// # Errors
    /// [`EndError`]; a session that is not the newest of its camera counts as unknown here.
    pub async fn abort_session(&self, id: &str) -> Result<SessionRecord, EndError> {
        self.end_session(id, Message::Abort, RigMessage::Abort).await
    }

    /// Waits until session `id` has ended.
    ///
    /// # Errors
    /// [`EndError::UnknownSession`] if it is not, or stops being, the newest of its camera;
    /// [`EndError::Stopping`].
    pub async fn session_over(&self, id: &str) -> Result<Arc<SessionRecord>, EndError> {
        let unknown = || EndError::UnknownSession { id: id.to_owned() };
        let mut session = self.owner(id).ok_or_else(unknown)?.session().subscribe();
        let ended = |record: &Option<Arc<SessionRecord>>| {
            record.as_ref().is_none_or(|record| record.id != id || record.state.is_over())
        };
        let record = session.wait_for(ended).await.map_err(|_| EndError::Stopping)?.clone();
        record.filter(|record| record.id == id).ok_or_else(unknown)
    }

    /// The events after `last_seen`; from now on, when `None`.
    pub fn events(&self, last_seen: Option<u64>) -> EventStream {
        self.shared.events.follow(last_seen)
    }

    async fn end_session(
        &self,
        id: &str,
        of_camera: fn(String, EndReply) -> Message,
        of_rig: fn(String, EndReply) -> RigMessage,
    ) -> Result<SessionRecord, EndError> {
        let (reply, answer) = oneshot::channel();
        match self.owner(id).ok_or_else(|| EndError::UnknownSession { id: id.to_owned() })? {
            Owner::Camera(camera) => {
                camera
                    .messages
                    .send(of_camera(id.to_owned(), reply))
                    .await
                    .map_err(|_| EndError::Stopping)?;
            }
            // One that takes no more messages drops the reply, and so answers.
            Owner::Rig(rig) => drop(rig.inbox.ask(of_rig(id.to_owned(), reply))),
        }
        answer.await.map_err(|_| EndError::Stopping)?
    }

    pub(super) fn link(&self, name: &str) -> Result<Arc<LiveCamera>, UnknownCamera> {
        let found = self
            .running()
            .iter()
            .map(|running| &running.camera)
            .find(|camera| camera.name == name)
            .cloned();
        found.ok_or_else(|| UnknownCamera { camera: name.to_owned() })
    }

    /// Whose newest session `id` is.
    fn owner(&self, id: &str) -> Option<Owner> {
        let has = |session: &watch::Sender<Option<Arc<SessionRecord>>>| {
            session.borrow().as_ref().is_some_and(|record| record.id == id)
        };
        let camera = self
            .running()
            .iter()
            .map(|running| &running.camera)
            .find(|camera| has(&camera.session))
            .cloned();
        let rig = || {
            self.running_rigs()
                .iter()
                .map(|running| &running.rig)
                .find(|rig| has(&rig.session))
                .cloned()
        };
        camera.map(Owner::Camera).or_else(|| rig().map(Owner::Rig))
    }

    fn running(&self) -> RwLockReadGuard<'_, Vec<RunningCamera>> {
        self.cameras.read().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Ends the threads of `cameras`, all at once.
fn stop(cameras: &[RunningCamera]) {
    for RunningCamera { camera, .. } in cameras {
        camera.stop.set();
        camera.slot.close();
        camera.preview.slot.close();
        // A full queue wakes its thread anyway.
        let _ = camera.messages.try_send(Message::Wake);
    }
    let until = Instant::now() + LAST_WAIT;
    let mut threads = cameras.iter().flat_map(|running| &running.threads);
    while threads.clone().any(|thread| !thread.is_finished()) && Instant::now() < until {
        std::thread::sleep(GLANCE);
    }
    for RunningCamera { camera, .. } in cameras {
        camera.recorder.finish();
    }
    if let Some(stuck) = threads.find(|thread| !thread.is_finished()) {
        tracing::warn!(
            "thread {} is stuck and left behind",
            stuck.thread().name().unwrap_or("without a name")
        );
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.shutdown();
    }
}

#[cfg(test)]
#[path = "fleet_tests.rs"]
mod tests;
