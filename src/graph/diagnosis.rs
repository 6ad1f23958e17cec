//! How a camera does, as `/diagnostics` says it.

use crate::calibration::result::Grade;
use crate::graph::camera::KnownCalibration;
use crate::graph::results::Results;
use crate::pipeline::RigStatus;
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::recording::ros2_results::{Diagnosis, DiagnosisLevel};

const DAY_NS: f64 = 86_400e9;

/// Of a camera with this status, now; `driver` is how its driver stands, if it has one.
pub(super) fn of(
    status: &CameraStatus,
    known: &KnownCalibration,
    driver: Option<String>,
    now_ns: i64,
) -> Diagnosis {
    let is_streaming = status.state == CameraState::Streaming;
    let current = CurrentNow::of(known, status.reason.as_deref().filter(|_| is_streaming));
    let (level, message) = match status.state {
        CameraState::Lost | CameraState::Failed => {
            (DiagnosisLevel::Error, status.reason.clone().unwrap_or_default())
        }
        CameraState::Starting => (DiagnosisLevel::Warn, "is being opened".to_owned()),
        CameraState::Streaming => current.verdict(),
    };
    let mut values = vec![("state", status.state.name().to_owned())];
    values.extend(status.fps.map(|fps| ("fps", format!("{fps:.1}"))));
    values.extend(current.values(now_ns));
    values.extend(driver.map(|driver| ("set_camera_info", driver)));
    let name = format!("plumb: {}", status.name);
    let hardware_id = status.identity.serial.clone().or_else(|| status.identity.bus.clone());
    Diagnosis { level, name, message, hardware_id: hardware_id.unwrap_or_default(), values }
}

/// Of a rig with this status, now.
pub(super) fn of_rig(status: &RigStatus, known: &KnownCalibration, now_ns: i64) -> Diagnosis {
    let current = CurrentNow::of(known, status.reason.as_deref());
    let (level, message) = current.verdict();
    let mut values = vec![("cameras", status.cameras.join(", "))];
    values.extend(current.values(now_ns));
    let name = format!("plumb: {}", status.name);
    Diagnosis { level, name, message, hardware_id: String::new(), values }
}

/// The current calibration, held against what comes now.
struct CurrentNow<'a> {
    results: Option<&'a Results>,
    drift: Option<&'a str>,
}

impl<'a> CurrentNow<'a> {
    /// With what the state says of it, `None` while all is well.
    fn of(known: &'a KnownCalibration, state: Option<&'a str>) -> Self {
        let drift = state.or(known.residual_drift.as_deref());
        Self { results: known.results.as_ref(), drift }
    }

    /// What there is to say of it.
    fn verdict(&self) -> (DiagnosisLevel, String) {
        match (self.results, self.drift) {
            (None, _) => (DiagnosisLevel::Warn, "has no approved calibration".to_owned()),
            (Some(_), Some(drift)) => (DiagnosisLevel::Warn, drift.to_owned()),
            (Some(results), None) => {
                let level = match results.grade {
                    Grade::Poor => DiagnosisLevel::Warn,
                    Grade::Usable | Grade::Good => DiagnosisLevel::Ok,
                };
                (level, format!("the calibration is {}", results.grade.name()))
            }
        }
    }

    /// What it rests on.
    fn values(&self, now_ns: i64) -> Vec<(&'static str, String)> {
        let mut values = Vec::new();
        if let Some(results) = self.results {
            let age_days = (now_ns - results.created_at_ns) as f64 / DAY_NS;
            values.push(("calibration", results.id.clone()));
            values.push(("verdict", results.grade.name().to_owned()));
            values.extend(results.rms_px.map(|rms_px| ("rms_px", format!("{rms_px:.4}"))));
            values.extend(results.uncertainty_px.map(|px| ("uncertainty_px", format!("{px:.4}"))));
            values.push(("age_days", format!("{age_days:.2}")));
            if !results.left_out.is_empty() {
                values.push(("without_camera_info", results.left_out.join(", ")));
            }
        }
        values.push(("drift", self.drift.unwrap_or("none").to_owned()));
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(residual_drift: Option<&str>) -> KnownCalibration {
        let results = Results {
            id: "c1".to_owned(),
            created_at_ns: 0,
            grade: Grade::Good,
            rms_px: None,
            uncertainty_px: None,
            infos: Vec::new(),
            transforms: Vec::new(),
            left_out: Vec::new(),
        };
        let residual_drift = residual_drift.map(str::to_owned);
        KnownCalibration { results: Some(results), residual_drift }
    }

    /// What is said of a camera in this state, and of its drift.
    fn said(known: &KnownCalibration, state: CameraState, reason: Option<&str>) -> [String; 2] {
        let reason = reason.map(str::to_owned);
        let status = CameraStatus { state, reason, ..CameraStatus::starting("front", "v4l2") };
        let diagnosis = of(&status, known, None, 0);
        let drift = diagnosis.values.into_iter().find(|(name, _)| *name == "drift");
        [diagnosis.message, drift.unwrap().1]
    }

    #[test]
    fn a_drift_is_said_while_it_lasts_and_that_of_boards_until_the_next_calibration() {
        let (good, streaming) = (known(None), CameraState::Streaming);
        let moved = "focus is 30, was 10";
        assert_eq!(said(&good, streaming, Some(moved)), [moved, moved]);
        assert_eq!(said(&good, streaming, None), ["the calibration is good", "none"]);
        assert_eq!(said(&good, CameraState::Lost, Some("unplugged")), ["unplugged", "none"]);
        let misfit = "boards do not fit";
        assert_eq!(said(&known(Some(misfit)), streaming, None), [misfit, misfit]);
        let none = KnownCalibration::default();
        assert_eq!(said(&none, streaming, None), ["has no approved calibration", "none"]);
    }

    #[test]
    fn a_rig_s_drift_is_that_of_its_state() {
        let status = RigStatus {
            name: "head".to_owned(),
            cameras: Vec::new(),
            session: None,
            calibration: Some("c1".to_owned()),
            reason: Some("another device".to_owned()),
        };
        assert_eq!(of_rig(&status, &known(None), 0).message, "another device");
        let well = RigStatus { reason: None, ..status };
        assert_eq!(of_rig(&well, &known(None), 0).message, "the calibration is good");
    }
}
