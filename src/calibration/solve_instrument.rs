//! The solve of an instrument of whole cameras: each by itself with all of its sensors, then all
//! that saw the board together, so that every sensor is placed beside the first camera's color.

use crate::calibration::composed_pose::through;
use crate::calibration::result::{CalibratedSensor, Calibration, Extrinsics, Verdict};
use crate::calibration::rgbd_calibration::with_depth;
use crate::calibration::second_infrared::{StereoInput, with_second_infrared};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve_rgbd::{RgbdError, RgbdInput, solve_rgbd};
use crate::calibration::solve_rig::{RigCameraInput, RigError, RigInput, solve_rig};
use crate::estimation::camera::CameraOptions;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// What the cameras of an instrument saw.
#[derive(Debug, Clone, PartialEq)]
pub struct Observations {
    /// The board.
    pub board: Target,
    /// Its cameras; the first is the instrument's own frame.
    pub cameras: Vec<CameraObservations>,
}

/// What one camera saw.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraObservations {
    /// In color, frame set by frame set.
    pub color: RigCameraInput,
    /// With depth and infrared, of a camera that has them.
    pub depth: Option<RgbdInput>,
    /// With right infrared, of a camera that has it.
    pub second_infrared: Option<StereoInput>,
}

/// Why an instrument could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// Its cameras could not be placed.
    #[error("{0}")]
    Rig(#[from] RigError),
    /// One camera's sensors could not be calibrated.
    #[error("camera `{camera}`: {source}")]
    Camera {
        /// Its name.
        camera: String,
        /// Why not.
        source: RgbdError,
    },
}

/// Calibrates each camera with all of its sensors, and places all of them.
///
/// # Errors
/// [`SolveError`].
pub fn solve(
    observations: &Observations,
    options: &CameraOptions,
) -> Result<Calibration, SolveError> {
    let cameras = observations.cameras.iter().map(|camera| camera.color.clone()).collect();
    let rig = solve_rig(&RigInput { board: observations.board, cameras }, options)?;
    let mut whole = rig.into_calibration(observations.board);
    for camera in &observations.cameras {
        if let Some(own) = alone(observations.board, camera, options)? {
            add_camera(&mut whole, &camera.color.name, own);
        }
    }
    let order = |id: &SensorId| {
        let of = |camera: &CameraObservations| Some(&camera.color.name) == id.camera.as_ref();
        (observations.cameras.iter().position(of), id.kind)
    };
    whole.sensors.sort_by_key(|sensor| order(&sensor.id));
    whole.extrinsics.sort_by_key(|known| (order(&known.target), order(&known.source)));
    Ok(whole)
}

/// A camera by itself; `None` for one with a single sensor.
fn alone(
    board: Target,
    camera: &CameraObservations,
    options: &CameraOptions,
) -> Result<Option<Calibration>, SolveError> {
    let Some(input) = &camera.depth else { return Ok(None) };
    let named = |source| SolveError::Camera { camera: camera.color.name.clone(), source };
    let solved = solve_rgbd(input, options).map_err(named)?;
    let color = solved.color.clone().into_calibration(Some(board));
    let calibration = with_depth(color, input, &solved);
    Ok(Some(match &camera.second_infrared {
        Some(stereo) => with_second_infrared(calibration, stereo, options),
        None => calibration,
    }))
}

/// Adds the sensors of `own` beside the color sensor that the rig has of this camera.
fn add_camera(whole: &mut Calibration, camera: &str, own: Calibration) {
    let of_camera = |id: &SensorId| SensorId { camera: Some(camera.to_owned()), kind: id.kind };
    let color = SensorId::of(camera, SensorKind::Color);
    if whole.sensor(&color).is_none() {
        return;
    }
    let placed = whole.extrinsics.iter().find(|known| known.source == color).cloned();
    for known in own.extrinsics {
        let known = Extrinsics { target: color.clone(), source: of_camera(&known.source), ..known };
        whole.extrinsics.push(match &placed {
            Some(first) => through(first, &known),
            None => known,
        });
    }
    let others = own.sensors.into_iter().filter(|sensor| sensor.id.kind != SensorKind::Color);
    for CalibratedSensor { id, result } in others {
        whole.sensors.push(CalibratedSensor { id: of_camera(&id), result });
    }
    add_verdict(&mut whole.verdict, camera, own.verdict);
}

/// What holds of a camera's other sensors, besides what the rig says of its color already.
fn add_verdict(whole: &mut Verdict, camera: &str, own: Verdict) {
    whole.grade = whole.grade.min(own.grade);
    for reason in own.reasons {
        let reason = format!("{camera}: {}", reason.strip_prefix("color: ").unwrap_or(&reason));
        if !whole.reasons.contains(&reason) {
            whole.reasons.push(reason);
        }
    }
}
