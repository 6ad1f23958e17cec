//! How a camera does, as `/diagnostics` says it.

use crate::calibration::result::Grade;
use crate::graph::camera::GraphTopics;
use crate::pipeline::RigStatus;
use crate::pipeline::camera_status::{CameraState, CameraStatus};
use crate::recording::ros2_results::{Diagnosis, DiagnosisLevel};

const DAY_NS: f64 = 86_400e9;

/// Of a camera with this status, now.
pub(super) fn of(status: &CameraStatus, topics: Option<&GraphTopics>, now_ns: i64) -> Diagnosis {
    let known = of_calibration(topics);
    let (level, message) = match (status.state, known) {
        (CameraState::Lost | CameraState::Failed, _) => {
            (DiagnosisLevel::Error, status.reason.clone().unwrap_or_default())
        }
        (CameraState::Starting, _) => (DiagnosisLevel::Warn, "is being opened".to_owned()),
        (CameraState::Streaming, known) => known,
    };
    let mut values = vec![("state", status.state.name().to_owned())];
    values.extend(status.fps.map(|fps| ("fps", format!("{fps:.1}"))));
    values.extend(calibration_values(topics, now_ns));
    let driver = topics.and_then(|topics| topics.driver.as_ref());
    values.extend(driver.map(|driver| ("set_camera_info", driver.words())));
    let name = format!("plumb: {}", status.name);
    let hardware_id = status.identity.serial.clone().or_else(|| status.identity.bus.clone());
    Diagnosis { level, name, message, hardware_id: hardware_id.unwrap_or_default(), values }
}

/// Of a rig with this status, now.
pub(super) fn of_rig(status: &RigStatus, topics: Option<&GraphTopics>, now_ns: i64) -> Diagnosis {
    let (level, message) = of_calibration(topics);
    let mut values = vec![("cameras", status.cameras.join(", "))];
    values.extend(calibration_values(topics, now_ns));
    let name = format!("plumb: {}", status.name);
    Diagnosis { level, name, message, hardware_id: String::new(), values }
}

/// What there is to say of the current calibration.
fn of_calibration(topics: Option<&GraphTopics>) -> (DiagnosisLevel, String) {
    let results = topics.and_then(|topics| topics.results.as_ref());
    let drift = topics.and_then(|topics| topics.drift.as_ref());
    match (drift, results) {
        (Some(drift), _) => (DiagnosisLevel::Warn, drift.clone()),
        (None, None) => (DiagnosisLevel::Warn, "has no approved calibration".to_owned()),
        (None, Some(results)) => {
            let level = match results.grade {
                Grade::Poor => DiagnosisLevel::Warn,
                Grade::Usable | Grade::Good => DiagnosisLevel::Ok,
            };
            (level, format!("the calibration is {}", results.grade.name()))
        }
    }
}

/// What it rests on.
fn calibration_values(topics: Option<&GraphTopics>, now_ns: i64) -> Vec<(&'static str, String)> {
    let mut values = Vec::new();
    if let Some(results) = topics.and_then(|topics| topics.results.as_ref()) {
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
    let drift = topics.and_then(|topics| topics.drift.clone());
    values.push(("drift", drift.unwrap_or_else(|| "none".to_owned())));
    values
}
