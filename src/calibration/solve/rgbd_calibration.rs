//! A calibration of color, infrared and depth as one document.

use nalgebra::DMatrix;

use crate::calibration::depth_calibration::{DepthCalibration, judge_depth};
use crate::calibration::result::{
    CalibratedSensor, Calibration, Extrinsics, Finding, Grade, ImageCalibration, PoseStd, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::factory_check::FactoryCheck;
use crate::calibration::solve::rgbd_guess::ViewWithoutDepth;
use crate::calibration::solve::rgbd_input::RgbdInput;
use crate::calibration::solve::solve_rgbd::SolvedRgbd;
use crate::calibration::solve::{SolvedCamera, uncertainty_over};
use crate::calibration::verdict::SPLIT_HALF;
use crate::estimation::board_pose::board_poses;
use crate::estimation::depth_error::ComparedTile;
use crate::estimation::problem::{BoardView, Correspondence};
use crate::estimation::rgbd::RgbdEstimate;
use crate::estimation::rgbd::halves::RgbdDifference;
use crate::estimation::split_halves::{LensDifference, PoseBetweenHalves};
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::lens::Lens;
use crate::geometry::median::median;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// `calibration`, which has color as solved by itself, updated with everything from the joint
/// solve.
pub fn with_depth(
    mut calibration: Calibration,
    input: &RgbdInput,
    solved: &SolvedRgbd,
) -> Calibration {
    let joint = &solved.joint;
    let of_depth = solved.factory.as_ref().and_then(|check| check.kept.as_deref()).unwrap_or(joint);
    let depth = DepthCalibration::of(of_depth, input.depth.invalid);
    let own = SensorId::own;
    let extrinsics = |source: SensorKind, estimate: &RgbdEstimate| {
        color_from_depth(own(source), own(SensorKind::Color), estimate)
    };
    let seen = JointViews { solved };
    if let Some(color) = calibration.image_mut(&SensorId::own(SensorKind::Color)) {
        set_lens(color, joint.color, &joint.color_covariance);
        seen.place(color, &solved.color, SensorKind::Color);
        let halves = solved.halves.map(|halves| halves.color);
        calibration.verdict = in_halves(&solved.color, halves).verdict_of(color);
    }
    // A check of views held out of color's own solve does not apply to the joint one.
    calibration.checks.held_out_rms_px = None;
    if let Some(halves) = &solved.halves {
        calibration.checks.split_half_ratio = halves.ratio();
    }
    calibration.extrinsics = vec![extrinsics(SensorKind::Depth, of_depth)];
    if let Some(mut infrared) = solved.infrared.clone() {
        set_lens(&mut infrared.sensor, joint.depth.lens, &joint.depth_covariance);
        let alone = infrared.clone();
        infrared.sensor.board_shape = solved.color.sensor.board_shape.clone();
        infrared.sensor.board_warp_m = solved.color.sensor.board_warp_m;
        seen.place(&mut infrared.sensor, &alone, SensorKind::Infrared);
        let halves = solved.halves.and_then(|halves| halves.depth);
        let of_infrared = in_halves(&alone, halves).verdict_of(&infrared.sensor);
        let id = SensorId::own(SensorKind::Infrared);
        calibration.add_sensor(CalibratedSensor::image(id, infrared.sensor));
        calibration.extrinsics.push(extrinsics(SensorKind::Infrared, joint));
        calibration.verdict = both(calibration.verdict, of_infrared);
    }
    calibration.verdict = judged_with_depth(calibration.verdict, input, solved, of_depth, &depth);
    for finding in halves_of_depth(solved) {
        calibration.verdict.lower(finding.grade, finding.reason);
    }
    calibration.add_sensor(CalibratedSensor::depth(None, depth));
    calibration
}

/// `verdict` with the findings about depth, for the estimate `of_depth`.
pub(super) fn judged_with_depth(
    mut verdict: Verdict,
    input: &RgbdInput,
    solved: &SolvedRgbd,
    of_depth: &RgbdEstimate,
    depth: &DepthCalibration,
) -> Verdict {
    let joint = &solved.joint;
    let views_with_depth =
        input.frame_sets.iter().filter(|frame_set| frame_set.depth.is_some()).count();
    let lowering = [
        without_color(input),
        without_depth_image(input),
        scale_doubt(joint, &input.board),
        bent_for_depth(solved),
    ];
    for reason in lowering.into_iter().flatten() {
        verdict.lower(Grade::Usable, reason);
    }
    verdict.reasons.extend(depth_not_used(solved, views_with_depth));
    verdict.reasons.extend(weak_place(of_depth));
    if !joint.not_together.is_empty() {
        verdict.reasons.push(not_together(joint));
    }
    verdict.reasons.extend(solved.factory.as_ref().map(FactoryCheck::line));
    judge_depth(verdict, depth, solved.without_depth.len(), views_with_depth)
}

/// A sensor that was solved by itself, with the difference between halves of the views in the joint
/// solve.
fn in_halves(alone: &SolvedCamera, halves: Option<LensDifference>) -> SolvedCamera {
    let mut solved = alone.clone();
    if let Some(lens) = halves {
        solved.take_halves(lens, None);
    }
    solved
}

/// The difference between two halves of the views in the pose of depth, and in its lens if only
/// planes determine it.
pub(super) fn halves_of_depth(solved: &SolvedRgbd) -> Vec<Finding> {
    let Some(RgbdDifference { depth, color_from_depth, .. }) = solved.halves else {
        return Vec::new();
    };
    let advice = "add views, tilted, near and far, and hold the board still for each";
    let pose = color_from_depth.and_then(|PoseBetweenHalves { ratio, rotation_rad, translation_m }| {
        let (rotation_deg, translation_mm) = (rotation_rad.to_degrees(), 1e3 * translation_m);
        let reason = format!(
            "the depth camera's pose differs between two halves of the views by {ratio:.1} times its predicted uncertainty ({rotation_deg:.2}°, {translation_mm:.1} mm): {advice}"
        );
        Finding::worse_than_good(Grade::of_figure(ratio, SPLIT_HALF), reason)
    });
    let by_planes = depth.filter(|_| solved.infrared.is_none());
    let lens = by_planes.and_then(|LensDifference { ratio, focal_change }| {
        let (ratio, percent) = (ratio?, 100.0 * focal_change);
        let reason = format!(
            "the depth camera's lens differs between two halves of the views by {ratio:.1} times its predicted uncertainty (fx by {percent:.2} %): {advice}"
        );
        Finding::worse_than_good(Grade::of_figure(ratio, SPLIT_HALF), reason)
    });
    pose.into_iter().chain(lens).collect()
}

/// The pose of depth in color's frame, from the device's own solve.
pub(super) fn color_from_depth(
    source: SensorId,
    color: SensorId,
    estimate: &RgbdEstimate,
) -> Extrinsics {
    let std = PoseStd::of(&estimate.color_from_depth_covariance);
    Extrinsics {
        target: color,
        source,
        target_from_source: estimate.color_from_depth,
        rotation_std: std.rotation,
        translation_std_m: std.translation_m,
    }
}

/// A finding if many views have no board in color.
pub fn without_color(input: &RgbdInput) -> Option<String> {
    let views = || {
        input.frame_sets.iter().filter(|frame_set| frame_set.is_view && frame_set.depth.is_some())
    };
    let (all, without) =
        (views().count(), views().filter(|frame_set| frame_set.color.is_empty()).count());
    (3 * without > all).then(|| {
        format!("the board was not seen in color in {without} of {all} views with depth: keep it within both images")
    })
}

/// The greatest standard deviation of the distance between the sensors along color's axis that is
/// not reported, in meters.
const WEAK_STD_M: f64 = 0.005;

/// A finding if the pose of depth is weak: planes alone hardly separate the distance between the
/// sensors along the axis from the focal length and the quadratic term of the depth error.
fn weak_place(estimate: &RgbdEstimate) -> Option<String> {
    let std_m = PoseStd::of(&estimate.color_from_depth_covariance).translation_m;
    let [x_mm, y_mm, z_mm] = std_m.map(|std_m| 1e3 * std_m);
    if x_mm.max(y_mm) > z_mm.max(1e3 * WEAK_STD_M) {
        return Some(format!(
            "the depth camera's position in the color frame is uncertain by {x_mm:.0} mm along x, {y_mm:.0} along y and {z_mm:.0} along z: add views with depth, with the board tilted more, near and far, or record infrared"
        ));
    }
    (z_mm > 1e3 * WEAK_STD_M).then(|| {
        format!(
            "the depth camera's position along the optical axis is uncertain by {z_mm:.0} mm: flat boards alone do not separate it from the focal length and the depth error; corrected depth still agrees with color; tilt the board more, near and far, or record infrared"
        )
    })
}

fn not_together(joint: &RgbdEstimate) -> String {
    let (separate, all) = (joint.not_together.len(), joint.color_from_board.len());
    format!(
        "color and depth of {separate} of {all} views were taken at different times, and are not used for the sensors' pose: hold the board still, or let the device take both together"
    )
}

/// A board that is more uneven than this, in meters (rms), is reported: what lies around it does
/// not continue its plane. Depth on the board is compared with its measured surface, and is as
/// accurate as with a flat one. Of seeded boards bowed by 0.7 mm rms on a wide flat table it is off
/// by 2 mm at the far end of what was seen, of boards that nothing lies around not at all.
const UNEVEN_FOR_DEPTH_M: f64 = 0.001;

/// A finding that the board is not flat, so that depth around it is compared with a plane that does
/// not fit.
fn bent_for_depth(solved: &SolvedRgbd) -> Option<String> {
    let unevenness_m = solved.color.sensor.board_shape.as_ref()?.unevenness_m;
    (unevenness_m > UNEVEN_FOR_DEPTH_M).then(|| {
        format!(
            "the board is bent or uneven by {:.1} mm (rms), which biases the depth error measured around it, where a plane is assumed: use a flat and stiff board",
            1e3 * unevenness_m
        )
    })
}

/// A finding if depth images are missing in views.
fn without_depth_image(input: &RgbdInput) -> Option<String> {
    let views = || {
        input.frame_sets.iter().filter(|frame_set| frame_set.is_view && !frame_set.color.is_empty())
    };
    let missing = || views().filter(|frame_set| frame_set.depth.is_none());
    let first = &missing().next()?.name;
    Some(format!(
        "{} of {} views have no depth image, the first `{first}`: check that none is lost, and that names are equal",
        missing().count(),
        views().count()
    ))
}

/// A finding if depth images could not be used, with the reason of the first.
fn depth_not_used(solved: &SolvedRgbd, views: usize) -> Option<String> {
    let ViewWithoutDepth { name, reason } = solved.without_depth.first()?;
    let count = solved.without_depth.len();
    Some(format!(
        "the depth image of {count} of {views} views was not used; view `{name}`: {reason}"
    ))
}

/// A factor between depth and the board that differs from 1 by more than this is reported: depth
/// cameras err by 1 or 2 parts in a hundred.
const REPORTED_FACTOR_ERROR: f64 = 0.03;

/// A wrong unit or a wrong square gives the same factor in every view: the views' median deviation
/// from it is less than this fraction of its difference from 1.
const FACTOR_DEVIATION_RATIO: f64 = 0.3;

/// A finding if depth differs from the board by the same factor in all views, as with a wrong unit
/// of depth or a wrong square.
fn scale_doubt(joint: &RgbdEstimate, board: &Target) -> Option<String> {
    let DepthReading::Metric { unit_m } = joint.depth.reading else { return None };
    let factor_of = |view: &Vec<ComparedTile>| {
        median(view.iter().map(|compared| compared.plane / compared.tile.inverse_depth).collect())
    };
    let of_views: Vec<f64> = joint.compared.iter().filter_map(factor_of).collect();
    let factor = median(of_views.clone())?;
    let off = (factor - 1.0).abs();
    let deviation = median(of_views.iter().map(|one| (one - factor).abs()).collect())?;
    if off < REPORTED_FACTOR_ERROR || deviation > FACTOR_DEVIATION_RATIO * off {
        return None;
    }
    let percent = 100.0 * (factor - 1.0);
    let (what, length_m) = match board {
        Target::Chessboard(board) => ("square", board.square_m),
        Target::Charuco(board) => ("square", board.square_m),
        Target::AprilGrid(board) => ("tag", board.tag_m),
    };
    let (std, along_m) = factor_std(joint)?;
    if off < CAUSE_SIGMAS * std {
        let (std, along_mm) = (100.0 * std, 1e3 * along_m);
        return Some(format!(
            "depth differs from the board by {percent:+.1} ± {std:.1} % in every view; the cause cannot be determined: a wrong depth unit, a wrong {what} size, or the depth camera's position (uncertain by {along_mm:.0} mm along its axis); show the board nearer and farther, and record infrared if available"
        ));
    }
    let [stated_mm, fitting_mm] = [length_m, length_m * factor].map(|m| 1e3 * m);
    Some(format!(
        "depth differs from the board by {percent:+.1} % in every view: either the depth unit is {:.3e} m, not {unit_m:.3e} m, or a {what} is {fitting_mm:.2} mm, not {stated_mm:.2} mm; measure a {what} with a ruler to decide (a wrong size also scales the distance between the sensors)",
        unit_m / factor
    ))
}

/// A factor that differs from 1 by more than this many standard deviations has a cause.
const CAUSE_SIGMAS: f64 = 3.0;

/// The standard deviation of the factor between depth and the board, due to the position of the
/// depth camera along color's axis and to color's focal length; with the former's standard
/// deviation in meters.
fn factor_std(joint: &RgbdEstimate) -> Option<(f64, f64)> {
    let distances =
        joint.compared.iter().flatten().map(|compared| 1.0 / compared.tile.inverse_depth);
    let distance_m = median(distances.collect())?;
    let along_m = joint.color_from_depth_covariance[(5, 5)].sqrt();
    let focal = joint.color_covariance[(0, 0)].sqrt() / joint.color.matrix.fx;
    Some((focal.hypot(along_m / distance_m), along_m))
}

/// The boards' poses in the joint solve, for a consistent document: with its lenses and these
/// poses, its corners have the reprojection errors that it states.
struct JointViews<'a> {
    solved: &'a SolvedRgbd,
}

impl JointViews<'_> {
    /// Sets the poses and errors of `sensor` to those of the joint solve; `alone` is its own solve.
    fn place(&self, sensor: &mut ImageCalibration, alone: &SolvedCamera, kind: SensorKind) {
        let (mut squares, mut count) = (0.0, 0.0);
        for (view, estimate) in sensor.views.iter_mut().zip(&alone.estimate.views) {
            let SolvedRgbd { problem, .. } = self.solved;
            let place = problem.views.iter().position(|joint| joint.name == view.name);
            let Some(place) = place else { continue };
            let joint = &problem.views[place];
            let corners = if kind == SensorKind::Color { &joint.color } else { &joint.infrared };
            let Some(pose) = self.pose(place, &sensor.lens, corners, kind) else { continue };
            let (mut of_view, mut seen) = (0.0, 0.0);
            for (corner, used) in corners.iter().zip(&estimate.used) {
                let pixel = sensor.lens.pixel_from_point(&(pose * corner.point_in_board));
                if let (Some(pixel), true) = (pixel, *used || !view.used) {
                    of_view += pixel.distance_px(corner.pixel).powi(2);
                    seen += 1.0;
                }
            }
            view.camera_from_board = Some(pose);
            view.rms_px = (seen > 0.0).then(|| f64::sqrt(of_view / seen)).or(view.rms_px);
            if view.used {
                (squares, count) = (squares + of_view, count + seen);
            }
        }
        if count > 0.0 {
            sensor.rms_px = f64::sqrt(squares / count);
        }
    }

    /// The board's pose in a sensor in view `place`. If infrared was taken at another time it saw
    /// the board elsewhere: then its own corners give the pose.
    fn pose(
        &self,
        place: usize,
        lens: &Lens,
        corners: &[Correspondence],
        kind: SensorKind,
    ) -> Option<Pose> {
        let joint = &self.solved.joint;
        let color_from_board = joint.color_from_board[place];
        if kind == SensorKind::Color {
            return Some(color_from_board);
        }
        let expected = joint.color_from_depth.inverse() * color_from_board;
        if joint.time_offset.is_none() && !joint.not_together.contains(&place) {
            return Some(expected);
        }
        let name = self.solved.problem.views[place].name.clone();
        let view = BoardView { name, correspondences: corners.to_vec() };
        let poses = board_poses(lens, &view).ok()?;
        let rotation = |depth_from_board: &Pose| depth_from_board.angle_to(&expected);
        poses
            .iter()
            .map(|found| found.camera_from_board)
            .min_by(|a, b| rotation(a).total_cmp(&rotation(b)))
    }
}

fn set_lens(sensor: &mut ImageCalibration, lens: Lens, covariance: &DMatrix<f64>) {
    sensor.lens = lens;
    sensor.uncertainty_px = uncertainty_over(&lens, covariance, sensor.image_size);
    sensor.lens_covariance =
        covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    sensor.lens_std =
        covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
}

fn both(color: Verdict, infrared: Verdict) -> Verdict {
    let named = |sensor: &str, reasons: Vec<String>| {
        reasons.into_iter().map(|r| format!("{sensor}: {r}")).collect::<Vec<_>>()
    };
    let grade: Grade = color.grade.min(infrared.grade);
    Verdict {
        grade,
        reasons: [named("color", color.reasons), named("infrared", infrared.reasons)].concat(),
    }
}
