//! Reports that the camera's current calibration may no longer be valid: the device was moved, or
//! the views that a session keeps disagree with it.

use crate::calibration::drift::{Drift, DriftWatch};
use crate::calibration::result::ImageCalibration;
use crate::calibration::session::KeptView;
use crate::pipeline::session_thread::SessionThread;

impl SessionThread {
    /// The watch that compares the views of a new session with the current calibration; `None`
    /// where there is no calibration, and for a rig.
    pub(super) fn drift_watch(&self) -> Option<DriftWatch> {
        let (id, sensor) = self.current_calibration()?;
        Some(DriftWatch::new(&id, &sensor))
    }

    /// Compares a kept view with the current calibration.
    pub(super) fn check_drift(&mut self, kept: &KeptView) {
        let (Some(watch), Some(session)) = (&mut self.drift, &self.session) else { return };
        let Some(view) = session.view(kept) else { return };
        let Some(board) = session.record().request.target.board() else { return };
        let seen = view.to_board_view(&board);
        if let Some(drift) = watch.see(&seen, &board.symmetries(), view.frame.image_size) {
            self.publish_drift(&drift);
        }
    }

    /// The device reports that a setting which the last session fixed has changed.
    pub(super) fn report_moved(&self, what: String) {
        if let Some((calibration, sensor)) = self.current_calibration() {
            self.publish_drift(&Drift {
                calibration,
                reason: what,
                rms_px: None,
                expected_px: sensor.rms_px,
            });
        }
    }

    /// Publishes drift of the camera that this instrument is.
    fn publish_drift(&self, drift: &Drift) {
        self.instrument
            .cameras
            .iter()
            .for_each(|camera| camera.publish_drift(&camera.name, drift.clone()));
    }

    fn current_calibration(&self) -> Option<(String, ImageCalibration)> {
        let ([camera], false) = (self.instrument.cameras.as_slice(), self.instrument.is_rig) else {
            return None;
        };
        let id = camera.status.borrow().calibration.clone()?;
        let calibration = self.store.calibration(&id).unwrap_or_else(|error| {
            tracing::error!(
                camera = camera.name,
                calibration = id,
                "drift is not watched: {error}"
            );
            None
        })?;
        Some((id, calibration.guide()?.clone()))
    }
}
