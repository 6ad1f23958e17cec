//! A rig of cameras as seen from outside, and the link to its thread.

use std::sync::Arc;

use tokio::sync::watch;

use crate::calibration::session_record::SessionRecord;
use crate::pipeline::rig_inbox::RigInbox;

/// A rig to set going: cameras that are fixed to each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigPlan {
    /// Its name in the configuration.
    pub name: String,
    /// The names of its cameras; the first is the rig's own frame.
    pub cameras: Vec<String>,
}

/// A rig and what it is doing.
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
}

/// One rig, as its thread and its readers see it.
#[derive(Debug)]
pub(super) struct LiveRig {
    pub(super) plan: RigPlan,
    pub(super) session: watch::Sender<Option<Arc<SessionRecord>>>,
    pub(super) calibration: watch::Sender<Option<String>>,
    pub(super) inbox: Arc<RigInbox>,
}

impl LiveRig {
    pub(super) fn status(&self) -> RigStatus {
        let session = self.session.borrow();
        let running = session.as_ref().filter(|record| !record.state.is_over());
        RigStatus {
            name: self.plan.name.clone(),
            cameras: self.plan.cameras.clone(),
            session: running.map(|record| record.id.clone()),
            calibration: self.calibration.borrow().clone(),
        }
    }
}
