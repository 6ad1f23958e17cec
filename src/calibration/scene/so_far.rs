//! What the key frames of a running session determine so far, and what to do next.

use std::sync::Arc;

use crate::calibration::result::Grade;
use crate::calibration::scene::conditions::SceneConditions;
use crate::calibration::scene::correspondence::SceneImage;
use crate::calibration::scene::{SceneCalibration, SceneOptions, SceneRefusal, calibrate_scene};
use crate::calibration::session_record::{RunningEstimate, SHOWN_COLUMNS};
use crate::calibration::solve::sensor_uncertainty;
use crate::estimation::problem::LensChoice;
use crate::estimation::scene::bundle::CameraMotion;
use crate::estimation::uncertainty::Distance;

/// What the key frames of a session amount to.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSoFar {
    /// The estimate; `None` while they do not determine the lens.
    pub running: Option<RunningEstimate>,
    /// Whether the verdict on it is better than poor.
    pub is_trusted: bool,
    /// What to do next, in words.
    pub next_step: String,
}

/// With a smaller median parallax, in degrees, depth is poorly determined.
const PARALLAX_DEG: f64 = 5.0;
/// Unless the camera rotated by this about its axis, in degrees, only the parallax determines the
/// principal point.
const ROLLED_DEG: f64 = 45.0;
/// Below this relief the points are nearly in one plane.
const LEAST_RELIEF: f64 = 0.02;
/// The part of the image in which a lens should have been seen.
const LEAST_COVERAGE: f64 = 0.7;

const SIDEWAYS: &str = "step sideways, keeping the same scene in view";
const ROLL: &str = "turn the camera by 90 degrees about its axis";
const TEXTURE: &str = "point the camera at something with texture";
const DEPTH: &str = "point the camera at things at different depths";

/// Estimates from the images of the key frames.
pub fn scene_so_far(images: &[SceneImage], lens: LensChoice) -> SceneSoFar {
    let options = SceneOptions { lens, ..SceneOptions::default() };
    match calibrate_scene(images, &options) {
        Ok(calibration) => {
            let next_step = after(&calibration);
            let is_trusted = calibration.verdict.grade != Grade::Poor;
            let calibration = calibration.into_calibration();
            let running = calibration.guide().and_then(|sensor| {
                let is_known = sensor.uncertainty_px.worst.is_finite() && sensor.rms_px.is_finite();
                let map = sensor_uncertainty(sensor, SHOWN_COLUMNS, Distance::Infinity);
                is_known.then(|| RunningEstimate {
                    lens: sensor.lens,
                    rms_px: sensor.rms_px,
                    uncertainty_px: sensor.uncertainty_px,
                    uncertainty_map: map.map(Arc::new),
                    views: images.len() as u32,
                })
            });
            SceneSoFar { running, is_trusted, next_step }
        }
        Err(refusal) => {
            SceneSoFar { running: None, is_trusted: false, next_step: instead(&refusal) }
        }
    }
}

/// What the estimate lacks most.
fn after(calibration: &SceneCalibration) -> String {
    let SceneConditions { motion, parallax_deg, rolled_deg, relief, .. } = calibration.conditions;
    if motion == CameraMotion::RotationOnly {
        format!("{SIDEWAYS}: so far the camera only rotated")
    } else if parallax_deg < PARALLAX_DEG {
        format!("{SIDEWAYS}: there is little parallax yet")
    } else if rolled_deg < ROLLED_DEG {
        ROLL.to_owned()
    } else if relief < LEAST_RELIEF {
        format!("{DEPTH}: so far they are nearly in one plane")
    } else if calibration.checks.coverage < LEAST_COVERAGE {
        format!("{TEXTURE} that fills the whole image")
    } else {
        "continue around the scene: each view from a new place lowers the uncertainty".to_owned()
    }
}

/// What to do when there is no estimate.
fn instead(refusal: &SceneRefusal) -> String {
    match refusal {
        SceneRefusal::TooFewImages { .. }
        | SceneRefusal::TooFewViews { .. }
        | SceneRefusal::Still => SIDEWAYS.to_owned(),
        SceneRefusal::HardlyAnyParallax => format!("{SIDEWAYS}: there is hardly any parallax yet"),
        SceneRefusal::ForwardMotion { .. } => {
            format!("{SIDEWAYS}, not forward; then {ROLL}")
        }
        SceneRefusal::FocalUndetermined { .. } => format!("{SIDEWAYS}; then {ROLL}"),
        SceneRefusal::OnePlane => format!("{DEPTH}, not at one plane"),
        SceneRefusal::NoTexture { .. } => TEXTURE.to_owned(),
        SceneRefusal::RepeatedTexture { .. } => format!("{TEXTURE} that does not repeat"),
        SceneRefusal::NothingAgrees { .. }
        | SceneRefusal::OnlyWhatStays { .. }
        | SceneRefusal::TooFewConnected { .. } => {
            format!("take smaller steps, and {TEXTURE} that does not repeat")
        }
        other => other.to_string(),
    }
}
