//! Instruments: one or more cameras that are calibrated together, as seen from outside, and the
//! link to their threads. Each camera is an instrument; each rig is one more.

use std::sync::{Arc, Mutex};

use tokio::sync::{mpsc, watch};

use crate::calibration::result::Calibration;
use crate::calibration::session_record::SessionRecord;
use crate::locks::lock;
use crate::pipeline::event::{CalibrationEvent, EventKind, EventLog};
use crate::pipeline::jobs::Jobs;
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::message::Message;
use crate::pipeline::metrics::Metrics;
use crate::pipeline::stop_signal::StopSignal;
use crate::store::{Store, StoreError};

/// A rig to start: cameras that are fixed to each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigPlan {
    /// Its name in the configuration.
    pub name: String,
    /// The names of its cameras; the first is the rig's own frame.
    pub cameras: Vec<String>,
}

/// A rig and its state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigStatus {
    /// Its name in the configuration.
    pub name: String,
    /// The names of its cameras.
    pub cameras: Vec<String>,
    /// The running session, if there is one.
    pub session: Option<String>,
    /// The current approved calibration, if there is one.
    pub calibration: Option<String>,
    /// Why that calibration may no longer be valid for the images of one of its cameras; `None`
    /// otherwise.
    pub reason: Option<String>,
}

/// One instrument, as shared by its threads and its readers.
#[derive(Debug)]
pub(super) struct Instrument {
    pub(super) name: String,
    /// In the instrument's order.
    pub(super) cameras: Vec<Arc<LiveCamera>>,
    pub(super) is_rig: bool,
    pub(super) session: watch::Sender<Option<Arc<SessionRecord>>>,
    pub(super) calibration: watch::Sender<Option<String>>,
    /// Held while another calibration is made the current one.
    pub(super) approving: Mutex<()>,
    pub(super) messages: mpsc::Sender<Message>,
    pub(super) jobs: Jobs,
    pub(super) events: Arc<EventLog>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) stop: StopSignal,
}

impl Instrument {
    /// The names of the cameras in a session of this instrument; empty if the instrument is a
    /// single camera.
    pub(super) fn member_names(&self) -> Vec<String> {
        let cameras = if self.is_rig { self.cameras.as_slice() } else { &[] };
        cameras.iter().map(|camera| camera.name.clone()).collect()
    }

    /// Stores with `write` that `calibration` is the current one, then shows and announces it. One
    /// call at a time, so that the calibration shown is the one stored.
    pub(super) fn make_current(
        &self,
        calibration: &Calibration,
        store: &Store,
        write: impl FnOnce() -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let _one_at_a_time = lock(&self.approving);
        write()?;
        self.set_calibration(&calibration.id, store);
        self.announce_calibration(calibration, true);
        Ok(())
    }

    /// Announces that there is a calibration, and whether it is the current one.
    pub(super) fn announce_calibration(&self, calibration: &Calibration, current: bool) {
        if let Some(event) = CalibrationEvent::of(calibration, current) {
            self.publish(EventKind::Calibration(event));
        }
    }

    fn set_calibration(&self, id: &str, store: &Store) {
        self.calibration.send_replace(Some(id.to_owned()));
        match (self.cameras.as_slice(), self.is_rig) {
            ([camera], false) => camera.set_calibration(id, store),
            _ => self.share_calibration(id, store),
        }
    }

    /// Gives a rig's calibration to its cameras.
    pub(super) fn share_calibration(&self, id: &str, store: &Store) {
        self.cameras.iter().for_each(|camera| camera.set_rig_calibration(&self.name, id, store));
    }

    pub(super) fn publish(&self, kind: EventKind) {
        self.events.publish(&self.name, kind);
    }

    pub(super) fn rig_status(&self) -> RigStatus {
        let session = self.session.borrow();
        let running = session.as_ref().filter(|record| !record.state.is_over());
        RigStatus {
            name: self.name.clone(),
            cameras: self.cameras.iter().map(|camera| camera.name.clone()).collect(),
            session: running.map(|record| record.id.clone()),
            calibration: self.calibration.borrow().clone(),
            reason: self.cameras.iter().find_map(|camera| camera.said_of_rig(&self.name)),
        }
    }

    /// Asks its threads to end.
    pub(super) fn ask_to_stop(&self) {
        self.stop.set();
        self.jobs.close();
        // If the queue is full, the thread is awake anyway.
        let _ = self.messages.try_send(Message::Wake);
    }
}
