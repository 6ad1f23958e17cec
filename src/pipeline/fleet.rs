//! All cameras and rigs of the daemon as one live object, the only one that the layers above use.
//! Sessions are in `fleet_sessions`, the exchange of cameras in `fleet_exchange`.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, RwLock, RwLockReadGuard};

use tokio::sync::watch;

use crate::calibration::session_record::SessionRecord;
use crate::detection::target_in_view::{TargetInView, target_in_view};
use crate::imaging::decode;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;
use crate::locks::{read, write};
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::pipeline::clock::utc_now_ns;
use crate::pipeline::event::{EventLog, EventStream};
use crate::pipeline::fleet_error::{ApproveError, FleetError};
use crate::pipeline::instrument::{Instrument, RigStatus};
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_frame::LiveFrame;
use crate::pipeline::metrics::Metrics;
use crate::pipeline::preview::PreviewReceiver;
use crate::pipeline::preview::drawing::{Drawing, EncodedFrame};
use crate::pipeline::preview::error::PreviewError;
use crate::pipeline::preview::maps::CalibrationMaps;
use crate::pipeline::recording::recorder::{
    RecordError, RecordedCamera, RecordingLimits, RecordingState, RecordingStatus, UNWRITTEN_BYTES,
};
use crate::pipeline::recording::recording_notes;
use crate::pipeline::recording::recording_retention::{RecordingRetention, recordings_folder};
use crate::pipeline::running::{
    CameraPlan, Exchange, FleetOptions, RunningCamera, RunningInstrument, SharedParts, stop,
};
use crate::pipeline::store_health::StoreHealth;
use crate::pipeline::unknown::{UnknownCamera, UnknownRig};
use crate::store::Store;

/// All cameras and rigs, live. Reading never waits for a camera or a solve.
#[derive(Debug)]
pub struct Fleet {
    pub(super) cameras: RwLock<Vec<RunningCamera>>,
    pub(super) rigs: RwLock<Vec<RunningInstrument>>,
    /// Held while cameras and rigs are exchanged: meanwhile they are not listed, but their threads
    /// still own their sessions.
    pub(super) exchange: Mutex<()>,
    pub(super) shared: SharedParts,
    pub(super) options: FleetOptions,
}

impl Fleet {
    /// Starts every camera, and resumes the sessions that an earlier run left unfinished.
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
        let metrics = Arc::new(metrics);
        // The clock in microseconds grows faster than events arrive, so that ids also grow across
        // restarts; and JavaScript represents it exactly.
        let events = Arc::new(EventLog::new((utc_now_ns() / 1000).max(0).unsigned_abs()));
        let maps = Arc::new(CalibrationMaps::new(Arc::clone(&store)));
        let health = Arc::new(StoreHealth::new(Arc::clone(&metrics)));
        let shared = SharedParts { events, metrics, store, health, maps };
        let fleet = Self {
            cameras: RwLock::default(),
            rigs: RwLock::default(),
            exchange: Mutex::default(),
            shared,
            options: options.clone(),
        };
        // If a step fails, the fleet is dropped, which ends the threads that were started.
        fleet.exchange(Exchange { cameras: plans, ..Exchange::default() })?;
        let unfinished = fleet.shared.store.unfinished_sessions()?;
        for row in fleet.shared.store.unreadable() {
            tracing::error!("the store cannot read {row}; see `plumb store check`");
        }
        for record in unfinished {
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

    /// Ends every thread; sessions are left as they are and resumed at the next start. Blocks for
    /// less than a second: a thread that a driver blocks is left behind.
    pub fn shutdown(&self) {
        let rigs = std::mem::take(&mut *write(&self.rigs));
        let cameras = std::mem::take(&mut *write(&self.cameras));
        stop(&rigs, &cameras);
    }

    pub(super) fn store(&self) -> &Store {
        &self.shared.store
    }

    /// Whether a camera or a rig has this name.
    pub fn has_instrument(&self, name: &str) -> bool {
        self.instruments().iter().any(|known| known.name == *name)
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
        let known = self.instruments().into_iter().find(|known| known.name == *name);
        let missing = || ApproveError::NotConfigured { id: id.to_owned(), name: name.clone() };
        let instrument = known.ok_or_else(missing)?;
        let store = self.store();
        Ok(instrument.make_current(&calibration, store, || store.set_current(name, id))?)
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
        let store = Arc::clone(&self.shared.store);
        let camera = RecordedCamera { name, factory: &link.factory };
        let room = move || store.has_room(UNWRITTEN_BYTES);
        link.recorder.start(&camera, &self.recordings_folder(), limits, room)
    }

    /// Ends recording `id`; its file is complete when this returns.
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

    /// The recordings on disk: the newest of each camera since the daemon started, then the others,
    /// newest first.
    pub fn recordings(&self) -> Vec<RecordingStatus> {
        let newest = |running: &RunningCamera| running.camera.recorder.status();
        let mut found: Vec<_> = self.running().iter().filter_map(newest).collect();
        found.retain(|status| status.path.exists());
        let older = recording_notes::read_all(&self.recordings_folder(), |id| {
            found.iter().any(|status| status.id == id)
        });
        found.extend(older);
        found
    }

    /// Deletes recording `id`, which has ended.
    ///
    /// # Errors
    /// [`RecordError::UnknownRecording`], [`RecordError::GoesOn`], [`RecordError::File`].
    pub fn delete_recording(&self, id: &str) -> Result<(), RecordError> {
        let found = self.recordings().into_iter().find(|status| status.id == id);
        let status = found.ok_or_else(|| RecordError::UnknownRecording { id: id.to_owned() })?;
        if status.state == RecordingState::Recording {
            return Err(RecordError::GoesOn { id: status.id });
        }
        let refused = |e: std::io::Error| RecordError::File { detail: e.to_string() };
        recording_notes::delete(&status).map_err(refused)
    }

    /// Deletes the recordings that have ended and that `retention` does not keep. Returns their
    /// names, oldest first.
    ///
    /// # Errors
    /// [`RecordError::File`].
    pub fn prune_recordings(
        &self,
        retention: &RecordingRetention,
        now_ns: i64,
    ) -> Result<Vec<String>, RecordError> {
        let not_kept = retention.not_kept(&self.recordings(), now_ns);
        let refused = |e: std::io::Error| RecordError::File { detail: e.to_string() };
        not_kept.iter().try_for_each(recording_notes::delete).map_err(refused)?;
        Ok(not_kept.into_iter().map(|status| status.id).collect())
    }

    fn recordings_folder(&self) -> PathBuf {
        recordings_folder(self.shared.store.folder())
    }

    /// The counters in Prometheus's text format, version 0.0.4.
    pub fn metrics_text(&self) -> String {
        let unreadable = self.shared.store.unreadable().len();
        self.shared.metrics.unreadable_rows.set(i64::try_from(unreadable).unwrap_or(i64::MAX));
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

    /// Every rig, in the order of the configuration.
    pub fn rigs(&self) -> Vec<RigStatus> {
        self.running_rigs().iter().map(|running| running.instrument.rig_status()).collect()
    }

    /// One rig.
    ///
    /// # Errors
    /// [`UnknownRig`].
    pub fn rig(&self, name: &str) -> Result<RigStatus, UnknownRig> {
        Ok(self.rig_link(name)?.rig_status())
    }

    /// Whether any camera delivers frames, and no session is paused.
    pub fn is_ready(&self) -> bool {
        let delivers = |running: &RunningCamera| {
            running.camera.status.borrow().state == CameraState::Streaming
        };
        self.running().iter().any(delivers) && self.paused().is_empty()
    }

    /// The sessions that are paused because their data cannot be stored, with the reason in words.
    pub fn paused(&self) -> Vec<String> {
        self.shared.health.reasons()
    }

    /// A channel with a camera's newest frame and its detection; `None` before the first frame.
    ///
    /// # Errors
    /// [`UnknownCamera`].
    pub fn frames(
        &self,
        name: &str,
    ) -> Result<watch::Receiver<Option<Arc<LiveFrame>>>, UnknownCamera> {
        Ok(self.link(name)?.frames.subscribe())
    }

    /// What a camera sees from now on, drawn and encoded once for all clients that request the same
    /// drawing.
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
        let (camera, live) = self.newest(name)?;
        Ok(camera.preview.encoded(&live, drawing, &camera.preview_state())?.0)
    }

    /// The target that a camera's newest image shows, if it is recognized; blocks while the image
    /// is decoded and searched.
    ///
    /// # Errors
    /// [`PreviewError`].
    pub fn target_in_view(&self, name: &str) -> Result<Option<TargetInView>, PreviewError> {
        Ok(target_in_view(self.newest_luma(name)?.view()))
    }

    /// A camera's newest image in which a board can be seen, as luma.
    fn newest_luma(&self, name: &str) -> Result<GrayImage, PreviewError> {
        let (camera, live) = self.newest(name)?;
        let kinds = [SensorKind::Color, SensorKind::Infrared];
        let frame = kinds.into_iter().find_map(|sensor| live.frame_set.frame(sensor));
        let frame = frame
            .ok_or_else(|| PreviewError::no_image_of(SensorKind::Color, name, &camera.sensors()))?;
        let mut image = GrayImage::default();
        decode::luma(frame, &mut image)?;
        Ok(image)
    }

    /// Why the camera `name` delivers nothing newer than its newest frame; `None` while it does.
    pub fn why_nothing_newer(&self, name: &str) -> Option<String> {
        let camera = self.link(name).ok()?;
        let status = camera.status.borrow();
        let is_over = matches!(status.state, CameraState::Lost | CameraState::Failed);
        is_over.then(|| status.reason.clone().unwrap_or_else(|| status.state.name().to_owned()))
    }

    fn newest(&self, name: &str) -> Result<(Arc<LiveCamera>, Arc<LiveFrame>), PreviewError> {
        let camera = self.link(name)?;
        let newest = camera.frames.borrow().clone();
        let live = newest.ok_or_else(|| {
            let status = camera.status.borrow();
            let (camera, reason) = (name.to_owned(), status.reason.clone());
            PreviewError::NoFrame { camera, state: status.state, reason }
        })?;
        Ok((camera, live))
    }

    /// The events after `last_seen`; from now on, when `None`.
    pub fn events(&self, last_seen: Option<u64>) -> EventStream {
        self.shared.events.follow(last_seen)
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

    /// The instrument that is the camera `name` alone.
    pub(super) fn own_link(&self, name: &str) -> Result<Arc<Instrument>, UnknownCamera> {
        let running = self.running();
        let found = running.iter().find(|running| running.camera.name == name);
        let found = found.map(|running| Arc::clone(&running.own.instrument));
        found.ok_or_else(|| UnknownCamera { camera: name.to_owned() })
    }

    pub(super) fn rig_link(&self, name: &str) -> Result<Arc<Instrument>, UnknownRig> {
        let running = self.running_rigs();
        let found = running.iter().find(|running| running.instrument.name == name);
        let found = found.map(|running| Arc::clone(&running.instrument));
        found.ok_or_else(|| UnknownRig { rig: name.to_owned() })
    }

    /// The instruments of all single cameras, then those of all rigs.
    pub(super) fn instruments(&self) -> Vec<Arc<Instrument>> {
        let own = self.running().iter().map(|r| Arc::clone(&r.own.instrument)).collect::<Vec<_>>();
        let rigs = self.running_rigs().iter().map(|r| Arc::clone(&r.instrument)).collect();
        [own, rigs].concat()
    }

    fn running(&self) -> RwLockReadGuard<'_, Vec<RunningCamera>> {
        read(&self.cameras)
    }

    fn running_rigs(&self) -> RwLockReadGuard<'_, Vec<RunningInstrument>> {
        read(&self.rigs)
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.shutdown();
    }
}
