//! The solve of an instrument: one camera or several, each with all of its sensors. A single camera
//! is an instrument of one.

use crate::calibration::result::{Calibration, Grade};
use crate::calibration::solve::auxiliary_image_sensor::with_image_sensor;
use crate::calibration::solve::cameras::solve_cameras;
use crate::calibration::solve::labels_alike::labeled_alike;
use crate::calibration::solve::observations::{CameraFrameSets, InstrumentObservations};
use crate::calibration::solve::rgbd_calibration::with_depth;
use crate::calibration::solve::solve_options::{
    InstrumentError, SolveMethod, SolveOptions, UnsolvedDepth, without_depth,
};
use crate::calibration::solve::solve_rgbd::solve_rgbd;
use crate::calibration::solve::{SolvedCamera, solve_dlt, solve_views};
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// Calibrates every sensor of the instrument, and its pose relative to the first camera's color.
///
/// # Errors
/// [`InstrumentError`]: views that leave something open, or sensors that do not go together;
/// [`EstimationError::Interrupted`] once `options.camera.interrupt` was requested.
pub fn solve(
    observations: &InstrumentObservations,
    options: &SolveOptions,
) -> Result<Calibration, InstrumentError> {
    let solved = solve_all(&labeled_alike(observations, options), options);
    // If interrupted, a sensor may have been given up early: that is not a sensor that cannot be
    // calibrated.
    options.camera.interrupt.check()?;
    solved
}

fn solve_all(
    observations: &InstrumentObservations,
    options: &SolveOptions,
) -> Result<Calibration, InstrumentError> {
    match observations.cameras.as_slice() {
        [] => Err(InstrumentError::NoCamera),
        [only] => solve_camera(observations.board, only, options),
        several => {
            let board = observations.board.ok_or(InstrumentError::NoBoard)?;
            solve_cameras(board, several, options)
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
    let held = camera.given.map(|lens| CameraOptions::holding(&lens, &options.camera.interrupt));
    let problem = camera.problem(SensorKind::Color);
    let solved = match options.method {
        SolveMethod::LinearTransform => solve_dlt(&problem, &options.camera.interrupt),
        SolveMethod::BundleAdjustment => {
            solve_views(&problem, held.as_ref().unwrap_or(&options.camera))
        }
    }?;
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
            calibration.verdict.lower(Grade::Usable, without_depth(&reason));
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
        with_image_sensor(calibration, board, camera, kind, &options.camera)
    })
}

#[cfg(test)]
#[path = "instrument_tests.rs"]
mod tests;
