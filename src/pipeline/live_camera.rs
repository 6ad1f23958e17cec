//! What a camera's threads share: its state as seen from outside, and the links between them.

use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::{mpsc, watch};

use crate::calibration::drift::Drift;
use crate::calibration::guidance::Guidance;
use crate::calibration::provenance::Provenance;
use crate::calibration::scene::correspondence::SceneImage;
use crate::geometry::pose::Pose;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::frame::SensorKind;
use crate::locks::lock;
use crate::pipeline::assembly::SharedFactory;
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::pipeline::captured::Captured;
use crate::pipeline::current_calibration::{CurrentCalibration, ImagesNow};
use crate::pipeline::event::{EventKind, EventLog};
use crate::pipeline::frame_slot::FrameSlot;
use crate::pipeline::live_frame::LiveFrame;
use crate::pipeline::message::Message;
use crate::pipeline::metrics::Metrics;
use crate::pipeline::preview::{Preview, PreviewState};
use crate::pipeline::recording::recorder::RecorderLink;
use crate::pipeline::search::CurrentSearch;
use crate::pipeline::stop_signal::StopSignal;
use crate::store::Store;

/// One camera, as shared by its threads.
#[derive(Debug)]
pub(super) struct LiveCamera {
    pub(super) name: String,
    /// What determines the geometry of its images, in words.
    pub(super) image_source: String,
    pub(super) status: watch::Sender<CameraStatus>,
    pub(super) frames: watch::Sender<Option<Arc<LiveFrame>>>,
    pub(super) search: CurrentSearch,
    pub(super) slot: FrameSlot<Captured>,
    /// To the thread that owns the session of this camera alone.
    pub(super) messages: mpsc::Sender<Message>,
    pub(super) events: Arc<EventLog>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) stop: StopSignal,
    pub(super) recorder: RecorderLink,
    /// What the open device states about its own sensors.
    pub(super) factory: SharedFactory,
    pub(super) preview: Preview,
    /// Where the running session asks for the board.
    pub(super) guidance: Mutex<Guidance>,
    /// The last key frame of the running session.
    pub(super) key_frame: Mutex<Option<SceneImage>>,
    /// What is known about the present images.
    pub(super) images: Mutex<ImagesNow>,
    /// Its own current calibration.
    pub(super) calibrated: Mutex<Option<CurrentCalibration>>,
    /// The rigs that it is in, with their current calibrations, the newest last.
    pub(super) rigs: Mutex<Vec<RigCalibration>>,
}

/// The current calibration of a rig.
#[derive(Debug)]
pub(super) struct RigCalibration {
    pub(super) rig: String,
    pub(super) id: String,
    current: Option<CurrentCalibration>,
}

impl LiveCamera {
    /// Sets the state, and announces it if it changed.
    pub(super) fn set_state(&self, state: CameraState, reason: Option<&str>) {
        let changed = self.status.send_if_modified(|status| {
            let changed = status.state != state || status.reason.as_deref() != reason;
            status.state = state;
            status.reason = reason.map(str::to_owned);
            changed
        });
        if !changed {
            return;
        }
        self.metrics.set_state(&self.name, state);
        tracing::info!(camera = self.name, state = state.name(), reason, "camera");
        self.announce();
    }

    /// The camera delivers frames. The reason is what has changed since a session fixed it, or else
    /// why a current calibration may not be valid for these images, which is also reported as
    /// drift.
    pub(super) fn gives_frames(&self) {
        let images = self.images();
        let (reason, drifts) = self.changes_now(&images);
        self.set_state(CameraState::Streaming, reason.as_deref());
        drop(images);
        self.publish_drifts(drifts);
    }

    /// Compares the current calibrations with the present images again, after either has changed. A
    /// camera that delivers no images keeps its state.
    pub(super) fn compare_calibrations(&self) {
        let images = self.images();
        if self.status.borrow().state != CameraState::Streaming {
            return;
        }
        let (reason, drifts) = self.changes_now(&images);
        let shown = reason.clone();
        // The camera may have been lost meanwhile.
        let changed = self.status.send_if_modified(|status| {
            let changed = status.state == CameraState::Streaming && status.reason != reason;
            if changed {
                status.reason = reason;
            }
            changed
        });
        if changed {
            tracing::info!(camera = self.name, reason = shown, "camera");
            self.announce();
        }
        drop(images);
        self.publish_drifts(drifts);
    }

    /// What is known about the present images. Locked during the comparison until the reason is
    /// set, so that the last comparison is the one shown.
    pub(super) fn images(&self) -> MutexGuard<'_, ImagesNow> {
        lock(&self.images)
    }

    /// The reason that follows from these images, and the part of it that was not reported yet,
    /// each with its camera or rig.
    fn changes_now(&self, images: &ImagesNow) -> (Option<String>, Vec<(String, Drift)>) {
        let now = Provenance {
            source: Some(self.image_source.clone()),
            device: self.status.borrow().identity.device(),
            image_sizes: images.sizes.clone(),
        };
        let mut own = lock(&self.calibrated);
        let mut rigs = lock(&self.rigs);
        let of_rigs = rigs.iter_mut().filter_map(|rig| rig.current.as_mut());
        let (mut reason, mut drifts) = (images.moved.clone(), Vec::new());
        for current in own.iter_mut().chain(of_rigs) {
            let (change, drift) = current.change(&now);
            reason = reason.or(change);
            drifts.extend(drift.map(|drift| (current.instrument().to_owned(), drift)));
        }
        (reason, drifts)
    }

    fn publish_drifts(&self, drifts: Vec<(String, Drift)>) {
        drifts.into_iter().for_each(|(instrument, drift)| self.publish_drift(&instrument, drift));
    }

    /// The device that delivers the frames now, in words; `None` where there is none, or it does
    /// not state its name.
    pub(super) fn streaming_device(&self) -> Option<String> {
        let status = self.status.borrow();
        status.identity.device().filter(|_| status.state == CameraState::Streaming)
    }

    /// Shows the current calibration.
    pub(super) fn set_calibration(&self, id: &str, store: &Store) {
        let current = CurrentCalibration::read(store, id, &self.name, &self.name);
        *lock(&self.calibrated) = current;
        self.status.send_modify(|status| status.calibration = Some(id.to_owned()));
        self.compare_calibrations();
    }

    /// Reports that the current calibration of `instrument` may no longer be valid.
    pub(super) fn publish_drift(&self, instrument: &str, drift: Drift) {
        let Drift { calibration, reason, .. } = &drift;
        tracing::warn!(camera = self.name, calibration, "{reason}");
        self.events.publish(instrument, EventKind::Drift(drift));
    }

    /// Announces the present status.
    pub(super) fn announce(&self) {
        let status = self.status.borrow().clone();
        self.publish(EventKind::Camera(Box::new(status)));
    }

    pub(super) fn publish(&self, kind: EventKind) {
        self.events.publish(&self.name, kind);
    }

    /// What drawings depend on besides the frame.
    pub(super) fn preview_state(&self) -> PreviewState {
        let guidance = lock(&self.guidance);
        let outline_px = guidance.outline_px.clone();
        drop(guidance);
        let calibration = self.status.borrow().calibration.clone();
        let rigs = lock(&self.rigs);
        let rig_calibration = rigs.last().map(|rig| rig.id.clone());
        let key_frame = lock(&self.key_frame).clone();
        let (camera, sensors) = (self.name.clone(), self.sensors());
        PreviewState { camera, sensors, calibration, rig_calibration, outline_px, key_frame }
    }

    /// The sensors that have given an image since the camera came.
    pub(super) fn sensors(&self) -> Vec<SensorKind> {
        self.images().sizes.keys().copied().collect()
    }

    /// The encoding of the depth readings, as the device states it.
    pub(super) fn depth_encoding(&self) -> Option<DepthEncoding> {
        lock(&self.factory).depth_encoding
    }

    /// From now on, shows the features that each image shares with `key_frame`.
    pub(super) fn show_shared_with(&self, key_frame: Option<SceneImage>) {
        *lock(&self.key_frame) = key_frame;
    }

    /// From now on, shows where the board should be held.
    pub(super) fn suggest(&self, guidance: &Guidance) {
        let mut shown = lock(&self.guidance);
        guidance.clone_into(&mut shown);
    }

    /// The pose of the board that the running session suggests, as camera_from_board.
    pub(super) fn suggested_pose(&self) -> Option<Pose> {
        lock(&self.guidance).camera_from_board
    }

    /// From now on, the rig's calibration is the one `id`.
    pub(super) fn set_rig_calibration(&self, rig: &str, id: &str, store: &Store) {
        let current = CurrentCalibration::read(store, id, rig, &self.name);
        let calibration = RigCalibration { rig: rig.to_owned(), id: id.to_owned(), current };
        let mut rigs = lock(&self.rigs);
        rigs.retain(|known| known.rig != rig);
        rigs.push(calibration);
        drop(rigs);
        self.compare_calibrations();
    }

    /// Why the rig's calibration may not be valid for the present images.
    pub(super) fn said_of_rig(&self, rig: &str) -> Option<String> {
        let rigs = lock(&self.rigs);
        let current = rigs.iter().find(|known| known.rig == rig)?.current.as_ref()?;
        current.said().map(str::to_owned)
    }

    /// The camera is no longer in the rig.
    pub(super) fn forget_rig(&self, rig: &str) {
        let mut rigs = lock(&self.rigs);
        rigs.retain(|known| known.rig != rig);
        drop(rigs);
        self.compare_calibrations();
    }

    /// Counts `frames` lost for the reason `why`.
    pub(super) fn count_dropped(&self, why: &str, frames: u64) {
        if frames > 0 {
            self.metrics.dropped.with_label_values(&[&self.name, why]).inc_by(frames);
            self.status.send_modify(|status| status.dropped_frames += frames);
        }
    }
}
