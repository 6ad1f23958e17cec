//! The solve: of one camera or several, each with all of its sensors. A single camera is an
//! instrument of one; of several, each is solved by itself with all of its sensors, and all that
//! saw the board together are placed beside the first.

use crate::calibration::beside_color::with_image_sensor;
use crate::calibration::composed_pose::through;
use crate::calibration::observations::{CameraFrameSets, InstrumentObservations};
use crate::calibration::result::{CalibratedSensor, Calibration, Extrinsics, Grade, Verdict};
use crate::calibration::rgbd_calibration::with_depth;
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::{SolvedCamera, solve_views};
use crate::calibration::solve_rgbd::{RgbdError, solve_rgbd};
use crate::calibration::solve_rig::{RigError, RigInput, holding, solve_rig};
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// How to solve.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SolveOptions {
    /// The lens and what else is estimated of each image sensor. Default: all found out.
    pub camera: CameraOptions,
    /// What becomes of a camera whose depth cannot be calibrated. Default: an error.
    pub unsolved_depth: UnsolvedDepth,
}

/// What becomes of a camera whose depth cannot be calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UnsolvedDepth {
    /// An error: depth is what was asked for.
    #[default]
    Refused,
    /// It is calibrated without depth, and the verdict says why.
    LeftOut,
}

/// Why an instrument could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InstrumentError {
    /// There is no camera at all.
    #[error("no camera was observed: give the views of one at least")]
    NoCamera,
    /// Several cameras or depth, and no board that they saw.
    #[error("several sensors are solved by the board that they all see: give its size")]
    NoBoard,
    /// The views of the only camera leave it open.
    #[error("{0}")]
    Views(#[from] EstimationError),
    /// The only camera's sensors do not go together.
    #[error("{0}")]
    Sensors(#[from] RgbdError),
    /// Several cameras could not be placed.
    #[error("{0}")]
    Rig(#[from] RigError),
    /// The sensors of one of several cameras do not go together.
    #[error("camera `{camera}`: {source}")]
    Camera {
        /// Its name.
        camera: String,
        /// Why not.
        source: RgbdError,
    },
}

/// Calibrates every sensor of the instrument, and where it is beside the first camera's color.
///
/// # Errors
/// [`InstrumentError`]: views that leave something open, or sensors that do not go together.
pub fn solve(
    observations: &InstrumentObservations,
    options: &SolveOptions,
) -> Result<Calibration, InstrumentError> {
    match observations.cameras.as_slice() {
        [] => Err(InstrumentError::NoCamera),
        [only] => solve_camera(observations.board, only, options),
        several => {
            let board = observations.board.ok_or(InstrumentError::NoBoard)?;
            solve_rig_of(board, several, options)
        }
    }
}

/// One camera with all of its sensors.
fn solve_camera(
    board: Option<Target>,
    camera: &CameraFrameSets,
    options: &SolveOptions,
) -> Result<Calibration, InstrumentError> {
    if board.is_none() && (camera.depth.is_some() || camera.image_sensors.len() > 1) {
        return Err(InstrumentError::NoBoard);
    }
    let own = match with_own_depth(board, camera, options)? {
        Some(calibration) => calibration,
        None => color_alone(board, camera, options)?,
    };
    Ok(with_image_sensors(own, board, camera, options))
}

fn color_alone(
    board: Option<Target>,
    camera: &CameraFrameSets,
    options: &SolveOptions,
) -> Result<Calibration, EstimationError> {
    let held = camera.given.map(|lens| holding(&lens));
    let options = held.as_ref().unwrap_or(&options.camera);
    let solved = solve_views(&camera.problem(SensorKind::Color), options)?;
    Ok(solved.into_calibration(board))
}

/// Color, infrared and depth; `None` without depth.
fn with_own_depth(
    board: Option<Target>,
    camera: &CameraFrameSets,
    options: &SolveOptions,
) -> Result<Option<Calibration>, InstrumentError> {
    let Some(input) = board.and_then(|board| camera.with_depth(board)) else { return Ok(None) };
    let finished = |solved: SolvedCamera| solved.into_calibration(board);
    match (solve_rgbd(&input, &options.camera), options.unsolved_depth) {
        (Ok(solved), _) => Ok(Some(with_depth(finished(solved.color.clone()), &input, &solved))),
        (Err(reason), UnsolvedDepth::Refused) => Err(reason.into()),
        (Err(reason), UnsolvedDepth::LeftOut) => {
            let mut calibration = color_alone(board, camera, options)?;
            add_reason(&mut calibration.verdict, without_depth(&reason));
            Ok(Some(calibration))
        }
    }
}

fn with_image_sensors(
    calibration: Calibration,
    board: Option<Target>,
    camera: &CameraFrameSets,
    options: &SolveOptions,
) -> Calibration {
    let Some(board) = board else { return calibration };
    camera.beside_color().fold(calibration, |calibration, kind| {
        with_image_sensor(calibration, (board, camera, kind), &options.camera)
    })
}

/// Several cameras: their color sensors together, then what each has beside color.
fn solve_rig_of(
    board: Target,
    cameras: &[CameraFrameSets],
    options: &SolveOptions,
) -> Result<Calibration, InstrumentError> {
    let name = |camera: &CameraFrameSets| camera.name.clone().unwrap_or_default();
    let color = |camera: &CameraFrameSets| {
        camera.as_rig_camera(&name(camera), SensorKind::Color, |_, seen| seen.number)
    };
    let input = RigInput { board, cameras: cameras.iter().map(color).collect() };
    let mut whole = solve_rig(&input, &options.camera)?.into_calibration(board);
    for camera in cameras {
        let own = with_own_depth(Some(board), camera, options).map_err(|error| match error {
            InstrumentError::Sensors(source) => {
                InstrumentError::Camera { camera: name(camera), source }
            }
            other => other,
        })?;
        if let Some(own) = own {
            let own = with_image_sensors(own, Some(board), camera, options);
            add_camera(&mut whole, &name(camera), own);
        }
    }
    let order =
        |id: &SensorId| (cameras.iter().position(|camera| camera.name == id.camera), id.kind);
    whole.sensors.sort_by_key(|sensor| order(&sensor.id));
    whole.extrinsics.sort_by_key(|known| (order(&known.target), order(&known.source)));
    Ok(whole)
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

fn without_depth(reason: &RgbdError) -> String {
    format!("depth is not calibrated: {reason}")
}

fn add_reason(verdict: &mut Verdict, reason: String) {
    verdict.grade = verdict.grade.min(Grade::Usable);
    verdict.reasons.push(reason);
}

#[cfg(test)]
#[path = "instrument_tests.rs"]
mod tests;
