//! A calibration of colour, infrared and depth as one document.

use nalgebra::DMatrix;

use crate::calibration::calibration::{Calibration, Extrinsics, Grade, SensorCalibration, Verdict};
use crate::calibration::depth_calibration::{DepthCalibration, judge_depth};
use crate::calibration::solve_rgbd::{RgbdInput, SolvedRgbd, pose_std};
use crate::estimation::rgbd::RgbdEstimate;
use crate::geometry::lens::Lens;

/// `calibration`, which holds what colour gave by itself, with everything that the joint solve adds or makes surer.
pub fn with_depth(mut calibration: Calibration, input: &RgbdInput, solved: &SolvedRgbd) -> Calibration {
    let joint = &solved.joint;
    let depth = DepthCalibration::of(joint, input.depth.invalid);
    let views_with_depth = input.captures.iter().filter(|capture| capture.depth.is_some()).count();
    let (rotation_std, translation_std) = pose_std(&joint.color_from_depth_covariance);
    let extrinsics = |name: &str| Extrinsics {
        name: name.to_owned(),
        target_from_source: joint.color_from_depth,
        rotation_std: rotation_std.into(),
        translation_std_m: translation_std.into(),
    };
    calibration.color = calibration.color.map(|sensor| with_lens(sensor, joint.color, &joint.color_covariance));
    calibration.extrinsics = vec![extrinsics("color_from_depth")];
    if let Some(infrared) = solved.infrared.clone() {
        calibration.infrared = Some(with_lens(infrared.sensor, joint.depth.lens, &joint.depth_covariance));
        calibration.extrinsics.push(extrinsics("color_from_infrared"));
        calibration.verdict = both(calibration.verdict, infrared.verdict);
    }
    if let Some(reason) = without_color(input) {
        calibration.verdict.grade = calibration.verdict.grade.min(Grade::Usable);
        calibration.verdict.reasons.push(reason);
    }
    if !joint.not_together.is_empty() {
        calibration.verdict.reasons.push(not_together(joint));
    }
    calibration.verdict = judge_depth(calibration.verdict, &depth, solved.without_depth.len(), views_with_depth);
    calibration.depth = Some(depth);
    calibration
}

/// Views that colour tells nothing of, where they are many.
pub fn without_color(input: &RgbdInput) -> Option<String> {
    let views = || input.captures.iter().filter(|capture| capture.is_view && capture.depth.is_some());
    let (all, without) = (views().count(), views().filter(|capture| capture.color.is_empty()).count());
    (3 * without > all).then(|| {
        format!("the board was not seen in colour in {without} of {all} views with depth: keep it within both pictures")
    })
}

fn not_together(joint: &RgbdEstimate) -> String {
    let (apart, all) = (joint.not_together.len(), joint.color_from_board.len());
    format!(
        "colour and depth of {apart} of {all} views are of different moments, and these take no part in where the sensors are: hold the board still, or let the device take both together"
    )
}

fn with_lens(mut sensor: SensorCalibration, lens: Lens, covariance: &DMatrix<f64>) -> SensorCalibration {
    sensor.lens = lens;
    sensor.lens_covariance = covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    sensor.lens_std = covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
    sensor
}

fn both(color: Verdict, infrared: Verdict) -> Verdict {
    let named =
        |sensor: &str, reasons: Vec<String>| reasons.into_iter().map(|r| format!("{sensor}: {r}")).collect::<Vec<_>>();
    let grade: Grade = color.grade.min(infrared.grade);
    Verdict { grade, reasons: [named("color", color.reasons), named("infrared", infrared.reasons)].concat() }
}
