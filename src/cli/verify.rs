//! `plumb verify`: checks whether a calibration is still valid for the camera's present images.
//!
//! The corners are fitted twice: with the lens as it was calibrated, and with the lens that fits
//! them best. The residuals that only the first fit has show how far the lens has moved where the
//! corners are. Without a board, the images are of a static scene (`verify_scene`).

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::calibration::result::ImageCalibration;
use crate::calibration::solve::{UNCERTAINTY_COLUMNS, uncertainty_map};
use crate::cli::Failure;
use crate::cli::files::{image_sensor, read_calibration};
use crate::cli::gather::gather;
use crate::cli::lens_change::LensChange;
use crate::cli::search_args::SearchArgs;
use crate::cli::target_args::ShapeOrSceneArgs;
use crate::cli::verified::{CERTAIN_PX, LEAST_LIMIT_PX, LIMIT_SIGMAS, Verified, print, same_size};
use crate::cli::verify_depth::verify_depth;
use crate::cli::verify_scene::verify_scene;
use crate::estimation::camera::{CameraEstimate, CameraOptions, CameraStart, calibrate_camera};
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::problem::{CameraProblem, GivenParameter, LensChoice};
use crate::estimation::relabeled::RelabeledProblem;
use crate::estimation::student::student_deviations;
use crate::estimation::uncertainty::Distance;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// The side of a square where the calibration does not state it: its size does not affect the
/// result.
const ANY_SQUARE_M: f64 = 0.025;

/// Check whether a calibration still holds for current images of the camera
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration document, as `plumb calibrate --out` gives it
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The camera or sensor that took the images, if the calibration has several
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    #[command(flatten)]
    search: SearchArgs,
    #[command(flatten)]
    target: ShapeOrSceneArgs,
    /// Print the answer as one JSON document
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// When the calibration or the images cannot be read, are of different sizes, or show no board.
pub fn run(args: &Args) -> Result<(), Failure> {
    let calibration = read_calibration(&args.calibration)?;
    let file = args.calibration.display().to_string();
    let (_, sensor) = image_sensor(&calibration, args.sensor.as_deref(), &file)?;
    let square_m = match calibration.target.and_then(|target| target.board()) {
        Some(Target::Chessboard(board)) => board.square_m,
        _ => ANY_SQUARE_M,
    };
    let Some(target) = args.target.read(square_m)? else {
        let verified = verify_scene(&file, sensor, &args.search)?;
        return print(&verified, &file, args.json);
    };
    let (problem, _) = gather(&args.search, target)?.finish()?;
    same_size(problem.image_size, &file, sensor)?;
    let problem = labeled_as_calibrated(problem, &target, sensor);
    let (verified, fixed) = verify(sensor, &problem)?;
    let seen = fixed.views.iter().filter(|view| view.fault.is_none());
    let poses = seen.filter_map(|view| Some((view.name.clone(), view.camera_from_board?)));
    let poses: Vec<(String, Pose)> = poses.collect();
    let by_name = poses.iter().cloned().collect::<BTreeMap<_, _>>();
    if calibration.depth().is_some() && by_name.len() < poses.len() {
        let problem =
            "frames of several recordings have the same numbers: verify the depth of one at a time";
        return Err(Failure::failed(problem));
    }
    let depth = verify_depth(&calibration, &target, &args.search, &by_name)?;
    let is_unseen = depth.is_none() && calibration.depth().is_some();
    let mut verified = verified.with_depth(depth);
    if is_unseen {
        let reason = "depth was not measured: give a folder with color/ and depth/, or a recording";
        verified.reasons.push(reason.to_owned());
    }
    print(&verified, &file, args.json)
}

/// The views of a symmetric board with its corners labeled as the calibration measured them.
fn labeled_as_calibrated(
    problem: CameraProblem,
    target: &Target,
    sensor: &ImageCalibration,
) -> CameraProblem {
    let Some(board) = &sensor.board_shape else { return problem };
    let options = as_calibrated(sensor, Some(board.clone()));
    let labeled = RelabeledProblem::labeled_alike(&problem, &target.symmetries(), &options);
    labeled.map_or(problem, |labeled| labeled.problem)
}

/// The result, and the views fitted with the calibrated lens.
fn verify(
    sensor: &ImageCalibration,
    problem: &CameraProblem,
) -> Result<(Verified, CameraEstimate), Failure> {
    let (best, measured_board) = best_fit(sensor, problem);
    let options = as_calibrated(sensor, measured_board);
    let fixed = calibrate_camera(problem, &options).map_err(Failure::failed)?;
    let noise_px = best.as_ref().map_or(sensor.rms_px, |best| best.rms_px);
    let unexplained_px = (fixed.rms_px.powi(2) - noise_px.powi(2)).max(0.0).sqrt();
    let limit_px = (LIMIT_SIGMAS * sensor.uncertainty_px.median).max(LEAST_LIMIT_PX);
    let change = best.as_ref().and_then(|best| {
        let uncertainty = uncertainty_map(best, UNCERTAINTY_COLUMNS, Distance::Infinity)?;
        let used = best.views.iter().filter(|view| view.fault.is_none()).count();
        LensChange::between(&sensor.lens, &best.lens, &uncertainty, sigmas(used))
    });
    let used = sensor.views.iter().filter(|view| view.used).count();
    let calibrated_px = (sigmas(used) * sensor.uncertainty_px.median).max(LEAST_LIMIT_PX);
    let visible_px = change.map(|change| change.visible_px.hypot(calibrated_px));
    // The poses of the boards compensate for most of a change of focus: residuals alone show little
    // of it.
    let certain_px = change.map(|change| change.seen_px).filter(|seen| Some(*seen) > visible_px);
    let moved_px = certain_px.unwrap_or(0.0).max(unexplained_px);
    let mut reasons = Vec::new();
    if moved_px > limit_px {
        reasons.push(
            "the lens has changed since (refocused, zoomed, knocked?): calibrate again".to_owned(),
        );
    }
    // A corner counts as fitting if its residual is within the calibration's own uncertainty, even
    // if the other corners are more accurate.
    let fitting = fitting_corners(&fixed, limit_px);
    let all = best.as_ref().map_or(corners(problem), |best| fitting_corners(best, limit_px));
    if 10 * fitting < 9 * all {
        reasons
            .push(format!("{fitting} of {all} corners fit the calibrated lens: calibrate again"));
    }
    let views = fixed.views.iter().filter(|view| view.fault.is_none()).count();
    let holds = reasons.is_empty();
    let is_calibration_weaker = change.is_some_and(|change| change.visible_px < calibrated_px);
    let remedy = if is_calibration_weaker {
        "calibrate again with more views, tilted more strongly"
    } else {
        "show the board in more poses, tilted"
    };
    match visible_px {
        Some(visible) if visible > CERTAIN_PX => reasons.push(format!(
            "a lens change of less than {visible:.1} px cannot be detected with these {views} views and this calibration: {remedy}"
        )),
        None => reasons.push(format!(
            "these {views} views do not determine a lens, so most lens changes cannot be detected: show the board in at least 3 poses, tilted"
        )),
        Some(_) => {}
    }
    let verified = Verified {
        holds,
        moved_px,
        limit_px,
        visible_px,
        rms_px: Some(fixed.rms_px),
        best_rms_px: best.map(|best| best.rms_px),
        views,
        depth: None,
        reasons,
    };
    Ok((verified, fixed))
}

/// Options with the calibrated lens, and with the measured board where it is given.
fn as_calibrated(
    sensor: &ImageCalibration,
    measured_board: Option<MeasuredBoard>,
) -> CameraOptions {
    let options = CameraOptions {
        lens: LensChoice::Model(sensor.lens.model()),
        given: GivenParameter::all_of(&sensor.lens),
        measured_board,
        ..CameraOptions::default()
    };
    options.as_stated()
}

/// The best-fitting lens of the calibrated one's model, and the board used for it: the one that the
/// calibration measured, if it fits better. The board seen now may be another one.
fn best_fit(
    sensor: &ImageCalibration,
    problem: &CameraProblem,
) -> (Option<CameraEstimate>, Option<MeasuredBoard>) {
    let with = |measured_board: Option<MeasuredBoard>| {
        let start =
            CameraStart { lens: sensor.lens, camera_from_board: Vec::new(), noise_floor_px: 0.0 };
        let options = CameraOptions {
            lens: LensChoice::Model(sensor.lens.model()),
            start: Some(start),
            measured_board,
            ..CameraOptions::default()
        };
        calibrate_camera(problem, &options.as_stated()).ok()
    };
    let flat = with(None);
    let Some(board) = &sensor.board_shape else { return (flat, None) };
    let measured = with(Some(board.clone()));
    // If the views do not determine a lens, the fits with the calibrated one are compared.
    let rms_px = |best: &Option<CameraEstimate>, board: Option<&MeasuredBoard>| match best {
        Some(best) => best.rms_px,
        None => calibrate_camera(problem, &as_calibrated(sensor, board.cloned()))
            .map_or(f64::INFINITY, |fixed| fixed.rms_px),
    };
    let are_alike = flat.is_some() == measured.is_some();
    if are_alike && rms_px(&measured, Some(board)) < rms_px(&flat, None) {
        (measured, Some(board.clone()))
    } else {
        (flat, None)
    }
}

/// The number of standard deviations that is as improbable, for a lens determined by this many
/// views, as [`LIMIT_SIGMAS`] is for a normal distribution: few views estimate their own scatter
/// poorly.
fn sigmas(views: usize) -> f64 {
    student_deviations(LIMIT_SIGMAS, views.saturating_sub(1) as f64)
}

/// The number of corners that were used, or whose residual is at most `limit_px`.
fn fitting_corners(estimate: &CameraEstimate, limit_px: f64) -> usize {
    let of_view = estimate.views.iter().flat_map(|view| view.used.iter().zip(&view.residuals_px));
    of_view.filter(|(used, [x, y])| **used || x.hypot(*y) <= limit_px).count()
}

fn corners(problem: &CameraProblem) -> usize {
    problem.views.iter().map(|view| view.correspondences.len()).sum()
}
