//! A calibration of color, infrared and depth as one document.

use nalgebra::DMatrix;

use crate::calibration::depth_calibration::{DepthCalibration, judge_depth};
use crate::calibration::factory_check::FactoryCheck;
use crate::calibration::result::{
    CalibratedSensor, Calibration, Extrinsics, Grade, ImageCalibration, Verdict, pose_std,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve_rgbd::{RgbdInput, SolvedRgbd};
use crate::estimation::rgbd::RgbdEstimate;
use crate::geometry::lens::Lens;
use crate::imaging::frame::SensorKind;

/// `calibration`, which holds what color gave by itself, with everything that the joint solve adds
/// or makes surer.
pub fn with_depth(
    mut calibration: Calibration,
    input: &RgbdInput,
    solved: &SolvedRgbd,
) -> Calibration {
    let joint = &solved.joint;
    let of_depth = solved.factory.as_ref().and_then(|check| check.kept.as_deref()).unwrap_or(joint);
    let depth = DepthCalibration::of(of_depth, input.depth.invalid);
    let views_with_depth = input.captures.iter().filter(|capture| capture.depth.is_some()).count();
    let extrinsics = |source: SensorKind, estimate: &RgbdEstimate| {
        let (rotation_std, translation_std) = pose_std(&estimate.color_from_depth_covariance);
        Extrinsics {
            target: SensorId::own(SensorKind::Color),
            source: SensorId::own(source),
            target_from_source: estimate.color_from_depth,
            rotation_std: rotation_std.into(),
            translation_std_m: translation_std.into(),
        }
    };
    if let Some(color) = calibration.image_mut(SensorKind::Color) {
        set_lens(color, joint.color, &joint.color_covariance);
    }
    calibration.extrinsics = vec![extrinsics(SensorKind::Depth, of_depth)];
    if let Some(mut infrared) = solved.infrared.clone() {
        set_lens(&mut infrared.sensor, joint.depth.lens, &joint.depth_covariance);
        let id = SensorId::own(SensorKind::Infrared);
        calibration.add_sensor(CalibratedSensor::image(id, infrared.sensor));
        calibration.extrinsics.push(extrinsics(SensorKind::Infrared, joint));
        calibration.verdict = both(calibration.verdict, infrared.verdict);
    }
    if let Some(reason) = without_color(input) {
        calibration.verdict.grade = calibration.verdict.grade.min(Grade::Usable);
        calibration.verdict.reasons.push(reason);
    }
    calibration.verdict.reasons.extend(weak_place(of_depth));
    if !joint.not_together.is_empty() {
        calibration.verdict.reasons.push(not_together(joint));
    }
    calibration.verdict.reasons.extend(solved.factory.as_ref().map(FactoryCheck::line));
    calibration.verdict =
        judge_depth(calibration.verdict, &depth, solved.without_depth.len(), views_with_depth);
    calibration.add_sensor(CalibratedSensor::depth(None, depth));
    calibration
}

/// Views that color tells nothing of, where they are many.
pub fn without_color(input: &RgbdInput) -> Option<String> {
    let views =
        || input.captures.iter().filter(|capture| capture.is_view && capture.depth.is_some());
    let (all, without) =
        (views().count(), views().filter(|capture| capture.color.is_empty()).count());
    (3 * without > all).then(|| {
        format!("the board was not seen in color in {without} of {all} views with depth: keep it within both pictures")
    })
}

/// Sensors whose distance along color's axis is less sure than this, in meters, are worth telling
/// of.
const WEAK_M: f64 = 0.005;

/// Planes alone hardly tell how far one sensor is behind the other from its focal length and the
/// curve of its error.
fn weak_place(estimate: &RgbdEstimate) -> Option<String> {
    let std_mm = 1e3 * pose_std(&estimate.color_from_depth_covariance).1.z;
    (std_mm > 1e3 * WEAK_M).then(|| {
        format!(
            "how far the depth camera stands back from color's is known to {std_mm:.0} mm only, by planes alone, which cannot tell it from the focal length and the curve of depth's error; depth as corrected agrees with color for all that: tilt the board more, near and far, or record infrared"
        )
    })
}

fn not_together(joint: &RgbdEstimate) -> String {
    let (apart, all) = (joint.not_together.len(), joint.color_from_board.len());
    format!(
        "color and depth of {apart} of {all} views are of different moments, and these take no part in where the sensors are: hold the board still, or let the device take both together"
    )
}

fn set_lens(sensor: &mut ImageCalibration, lens: Lens, covariance: &DMatrix<f64>) {
    sensor.lens = lens;
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
