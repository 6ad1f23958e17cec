//! Starts and stops cameras and rigs without affecting the others of the fleet.

use std::sync::MutexGuard;

use crate::calibration::session_record::SessionRecord;
use crate::locks::{lock, write};
use crate::pipeline::fleet::Fleet;
use crate::pipeline::fleet_error::FleetError;
use crate::pipeline::instrument::RigPlan;
use crate::pipeline::running::{
    CameraPlan, Exchange, RunningCamera, start_camera, start_rig, stop_cameras, stop_rigs,
};
use crate::pipeline::unknown::UnknownCamera;

impl Fleet {
    /// Stops some cameras and rigs and starts others, with the sessions that were left unfinished.
    /// A session whose camera has another source now is aborted instead; its views stay. Blocks
    /// while recordings are completed, and while stored views are read.
    ///
    /// # Errors
    /// [`FleetError`]; what comes before the one that failed is running then.
    pub fn exchange(&self, exchange: Exchange) -> Result<(), FleetError> {
        let Exchange { stopped_rigs, stopped_cameras, cameras, rigs } = exchange;
        // One step for those that abort sessions of instruments that are not configured: an
        // instrument that is being exchanged is not listed meanwhile, but its threads still store
        // its sessions.
        let _exchanging = self.exchanging();
        self.stop_rigs(&stopped_rigs);
        self.replace_cameras(&stopped_cameras, cameras)?;
        self.start_rigs(rigs)
    }

    /// Waits until no exchange is running, and blocks others while the guard is held.
    pub(super) fn exchanging(&self) -> MutexGuard<'_, ()> {
        lock(&self.exchange)
    }

    fn replace_cameras(
        &self,
        stopped: &[String],
        plans: Vec<CameraPlan>,
    ) -> Result<(), FleetError> {
        let cameras = || write(&self.cameras);
        let leaving: Vec<RunningCamera> =
            cameras().extract_if(.., |running| stopped.contains(&running.camera.name)).collect();
        stop_cameras(leaving);
        let mut unfinished = self.shared.store.unfinished_sessions()?;
        for plan in plans {
            let left = take_newest_of(&mut unfinished, &plan.name);
            let started = start_camera(plan, left, &self.shared, &self.options)?;
            cameras().push(started);
        }
        Ok(())
    }

    fn start_rigs(&self, plans: Vec<RigPlan>) -> Result<(), FleetError> {
        let mut unfinished = self.shared.store.unfinished_sessions()?;
        for RigPlan { name, cameras } in plans {
            let left = take_newest_of(&mut unfinished, &name);
            let link = |camera: &String| {
                self.link(camera).map_err(|UnknownCamera { camera }| FleetError::NoCamera {
                    rig: name.clone(),
                    camera,
                })
            };
            let cameras = cameras.iter().map(link).collect::<Result<_, _>>()?;
            let rig = start_rig(name, cameras, left, &self.shared, &self.options)?;
            write(&self.rigs).push(rig);
        }
        Ok(())
    }

    fn stop_rigs(&self, stopped: &[String]) {
        let mut rigs = write(&self.rigs);
        let leaving =
            rigs.extract_if(.., |running| stopped.contains(&running.instrument.name)).collect();
        drop(rigs);
        stop_rigs(leaving);
    }

    /// Sorts cameras and rigs in the order of these names.
    pub fn arrange(&self, cameras: &[&str], rigs: &[&str]) {
        let place = |names: &[&str], name: &str| names.iter().position(|other| *other == name);
        write(&self.cameras).sort_by_key(|running| place(cameras, &running.camera.name));
        write(&self.rigs).sort_by_key(|running| place(rigs, &running.instrument.name));
    }
}

/// Takes the newest of `unfinished` that is of the camera or rig `name`.
fn take_newest_of(unfinished: &mut Vec<SessionRecord>, name: &str) -> Option<SessionRecord> {
    let at = unfinished.iter().rposition(|record| record.camera == name)?;
    Some(unfinished.remove(at))
}
