//! The rigs of the fleet.

use std::sync::{Arc, PoisonError, RwLockReadGuard};
use std::thread::JoinHandle;

use tokio::sync::{oneshot, watch};

use crate::calibration::session_record::{SessionRecord, SessionRequest};
use crate::pipeline::board_look::BoardLook;
use crate::pipeline::fleet::{Fleet, FleetError};
use crate::pipeline::live_camera::LiveCamera;
use crate::pipeline::live_rig::{LiveRig, RigPlan, RigStatus};
use crate::pipeline::rig_inbox::RigMessage;
use crate::pipeline::rig_thread::RigThread;
use crate::pipeline::session_request::StartError;
use crate::pipeline::unknown::{UnknownCamera, UnknownRig};

/// A rig with the thread that works for it.
#[derive(Debug)]
pub(super) struct RunningRig {
    pub(super) rig: Arc<LiveRig>,
    pub(super) thread: JoinHandle<()>,
}

impl Fleet {
    /// Sets rigs of the fleet's cameras going, with the sessions that were left unfinished.
    ///
    /// # Errors
    /// [`FleetError`].
    pub fn start_rigs(&self, plans: Vec<RigPlan>) -> Result<(), FleetError> {
        let mut unfinished = self.shared.store.unfinished_sessions()?;
        for plan in plans {
            let left = unfinished.iter().rposition(|(record, _)| record.camera == plan.name);
            let left = left.map(|at| unfinished.remove(at).0);
            let calibration = self.shared.store.current_calibration_id(&plan.name)?;
            let rig = Arc::new(LiveRig {
                plan,
                session: watch::Sender::new(left.clone().map(Arc::new)),
                calibration: watch::Sender::new(calibration),
                inbox: Arc::default(),
            });
            let thread = RigThread {
                rig: Arc::clone(&rig),
                store: Arc::clone(&self.shared.store),
                events: Arc::clone(&self.shared.events),
                auto_approve: self.options.auto_approve,
                admission: self.options.admission,
                current: None,
                board_look: BoardLook::default(),
            };
            let name = rig.plan.name.clone();
            let thread =
                std::thread::Builder::new().name(format!("rig-{name}")).spawn(move || thread.run());
            let thread = thread
                .map_err(|error| FleetError::Thread { camera: name, detail: error.to_string() })?;
            if let (Some(record), Ok(cameras)) = (left, self.cameras_of(&rig.plan)) {
                rig.inbox.ask(RigMessage::Resume(Box::new(record), cameras));
            }
            self.rigs
                .write()
                .unwrap_or_else(PoisonError::into_inner)
                .push(RunningRig { rig, thread });
        }
        Ok(())
    }

    /// Ends the rigs named `stopped` and gives their cameras back; a session that collects goes on
    /// when a rig of that name is started again. Blocks until they have finished what they are
    /// computing.
    pub fn stop_rigs(&self, stopped: &[String]) {
        let mut rigs = self.rigs.write().unwrap_or_else(PoisonError::into_inner);
        let (leaving, staying): (Vec<_>, Vec<_>) =
            rigs.drain(..).partition(|running| stopped.contains(&running.rig.plan.name));
        *rigs = staying;
        drop(rigs);
        leaving.iter().for_each(|running| running.rig.inbox.close());
        for RunningRig { rig, thread } in leaving {
            if thread.join().is_err() {
                tracing::error!(rig = rig.plan.name, "the rig's thread had ended by a fault");
            }
        }
    }

    /// Every rig, in the order of the configuration.
    pub fn rigs(&self) -> Vec<RigStatus> {
        self.running_rigs().iter().map(|running| running.rig.status()).collect()
    }

    /// One rig.
    ///
    /// # Errors
    /// [`UnknownRig`].
    pub fn rig(&self, name: &str) -> Result<RigStatus, UnknownRig> {
        Ok(self.rig_link(name)?.status())
    }

    /// Starts a session on the rig `name`; it is stored when this returns.
    ///
    /// # Errors
    /// [`StartError`], also when one of its cameras is in a session.
    pub async fn start_rig_session(
        &self,
        name: &str,
        request: SessionRequest,
    ) -> Result<SessionRecord, StartError> {
        let rig =
            self.rig_link(name).map_err(|UnknownRig { rig }| StartError::UnknownRig { rig })?;
        let cameras = self
            .cameras_of(&rig.plan)
            .map_err(|UnknownCamera { camera }| StartError::UnknownCamera { camera })?;
        let (reply, answer) = oneshot::channel();
        if !rig.inbox.ask(RigMessage::Start(request, cameras, reply)) {
            return Err(StartError::Stopping);
        }
        answer.await.map_err(|_| StartError::Stopping)?
    }

    pub(super) fn rig_link(&self, name: &str) -> Result<Arc<LiveRig>, UnknownRig> {
        let found = self
            .running_rigs()
            .iter()
            .map(|running| &running.rig)
            .find(|rig| rig.plan.name == name)
            .cloned();
        found.ok_or_else(|| UnknownRig { rig: name.to_owned() })
    }

    fn cameras_of(&self, plan: &RigPlan) -> Result<Vec<Arc<LiveCamera>>, UnknownCamera> {
        plan.cameras.iter().map(|camera| self.link(camera)).collect()
    }

    pub(super) fn running_rigs(&self) -> RwLockReadGuard<'_, Vec<RunningRig>> {
        self.rigs.read().unwrap_or_else(PoisonError::into_inner)
    }
}
