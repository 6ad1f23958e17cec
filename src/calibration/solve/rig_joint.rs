//! Cameras of a rig that share views, solved together.

use crate::calibration::result::{Extrinsics, Finding, Grade, ImageCalibration, PoseStd};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::rig_input::RigInput;
use crate::calibration::solve::rig_member::SingleSensor;
use crate::calibration::solve::sensor_calibration;
use crate::calibration::verdict::SPLIT_HALF;
use crate::estimation::camera::CameraOptions;
use crate::estimation::consistent_labels::consistent_labels;
use crate::estimation::error::EstimationError;
use crate::estimation::lens_pole::with_denominator_of;
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::problem::LensChoice;
use crate::estimation::rig::{RigProblem, RigSensor, SensorHalves, SensorPose, calibrate_rig};
use crate::estimation::split_halves::PoseBetweenHalves;
use crate::geometry::pose::Pose;

/// Cameras that were solved together.
pub(super) struct Joint {
    pub(super) sensors: Vec<ImageCalibration>,
    pub(super) extrinsics: Vec<Extrinsics>,
    /// For each sensor: its residuals in the joint solve over those by itself.
    rms_ratio: Vec<f64>,
    /// For each sensor, if there are enough frame sets: the difference between two halves of them.
    pub(super) halves: Vec<SensorHalves>,
}

/// The symmetry of the board that corrects the labels of each view, so that all sensors label the
/// same corners alike.
#[derive(Clone, Copy)]
struct ChosenLabels<'a> {
    /// By symmetry.
    board_from_labels: &'a [Pose],
    /// For each sensor: the symmetry of each of its views in use.
    chosen: &'a [Vec<usize>],
}

impl Joint {
    /// Solves with the board as the cameras measured it, unless the stated board fits better.
    pub(super) fn solve(
        input: &RigInput,
        group: &[&SingleSensor<'_>],
        options: &CameraOptions,
    ) -> Result<Self, EstimationError> {
        let symmetries = input.board.symmetries();
        let board_from_labels: Vec<Pose> = symmetries.iter().map(Pose::inverse).collect();
        let chosen = consistent_labels(
            &group.iter().map(|one| one.poses()).collect::<Vec<_>>(),
            &symmetries,
        );
        let labels = ChosenLabels { board_from_labels: &board_from_labels, chosen: &chosen };
        if let Some(given) = &options.measured_board {
            return Self::on_board(group, labels, Some(given), options);
        }
        let stated = Self::on_board(group, labels, None, options);
        let Some(measured) = measured_by(group, labels) else { return stated };
        match (stated, Self::on_board(group, labels, Some(&measured), options)) {
            (Ok(stated), Ok(on_measured)) if stated.misfit() < on_measured.misfit() => Ok(stated),
            (stated, on_measured) => on_measured.or(stated),
        }
    }

    fn on_board(
        group: &[&SingleSensor<'_>],
        labels: ChosenLabels<'_>,
        board: Option<&MeasuredBoard>,
        options: &CameraOptions,
    ) -> Result<Self, EstimationError> {
        let sensor = |(one, chosen): (&&SingleSensor<'_>, &Vec<usize>)| RigSensor {
            name: one.input.name.clone(),
            image_size: one.input.image_size,
            views: one.with_labels_corrected(labels.board_from_labels, chosen),
            lens_covariance_with_shape: board
                .and(one.solved.estimate.board_shape.as_ref())
                .map(|_| one.solved.estimate.lens_covariance.clone()),
            options: CameraOptions {
                measured_board: board.cloned(),
                ..match &one.input.given {
                    Some(lens) => CameraOptions::holding(lens, &options.interrupt),
                    None => {
                        let lens = &one.solved.sensor.lens;
                        let model = LensChoice::Model(lens.model());
                        let alone = CameraOptions { lens: model, start: None, ..options.clone() };
                        with_denominator_of(lens, &alone).unwrap_or(alone)
                    }
                }
            },
        };
        let sensors: Vec<RigSensor> = group.iter().zip(labels.chosen).map(sensor).collect();
        let end =
            sensors.iter().flat_map(|sensor| &sensor.views).map(|seen| seen.frame_set + 1).max();
        let problem = RigProblem { sensors, frame_sets: end.unwrap_or(0) };
        let estimate = calibrate_rig(&problem)?;
        let reference = &group[0].input.id;
        let others = group.iter().zip(&estimate.sensor_poses).skip(1);
        let as_solved = |(one, camera): (&&SingleSensor<'_>, _)| ImageCalibration {
            compared: one.solved.sensor.compared.clone(),
            board_shape: board.cloned(),
            board_warp_m: board.map(|board| board.bow_m),
            ..sensor_calibration(camera)
        };
        let rms_ratio = group
            .iter()
            .zip(&estimate.cameras)
            .map(|(one, camera)| camera.rms_px / one.solved.estimate.rms_px.max(1e-3));
        Ok(Self {
            sensors: group.iter().zip(&estimate.cameras).map(as_solved).collect(),
            extrinsics: others
                .map(|(one, pose)| reference_from(reference, &one.input.id, pose))
                .collect(),
            rms_ratio: rms_ratio.collect(),
            halves: estimate.halves,
        })
    }

    /// How much worse the cameras fit together than by themselves: the sum of the squared ratios.
    fn misfit(&self) -> f64 {
        self.rms_ratio.iter().map(|ratio| ratio * ratio).sum()
    }

    pub(super) fn findings(&self, group: &[&SingleSensor<'_>]) -> Vec<Finding> {
        let name = |member: usize| group[member].input.name.as_str();
        let each = self.rms_ratio.iter().enumerate();
        let misfitting = each.filter(|(_, rms_ratio)| **rms_ratio > MISFIT_RMS_RATIO);
        let misfitting = misfitting.map(|(member, rms_ratio)| {
            let cause =
                "the board moved between the exposures, or the cameras relative to each other: hold the board still";
            let camera = name(member);
            let reason = format!(
                "the residuals of camera `{camera}` are {rms_ratio:.1} times as large in the joint solve as by itself; {cause}"
            );
            Finding { grade: Grade::Usable, reason }
        });
        let open = self.extrinsics.iter().enumerate().filter_map(|(index, known)| {
            let (rotation_deg, translation_m) =
                (largest(known.rotation_std).to_degrees(), largest(known.translation_std_m));
            let loose = rotation_deg > LOOSE_STD_DEG
                || translation_m
                    > LOOSE_STD_FRACTION * known.target_from_source.translation().norm().max(0.1);
            let advice = "show the board to both in more places, near and tilted";
            loose.then(|| {
                let reason = format!(
                    "the uncertainty of {}_from_{} is {rotation_deg:.2}° and {:.1} mm: {advice}",
                    name(0),
                    name(index + 1),
                    1e3 * translation_m
                );
                Finding { grade: Grade::Usable, reason }
            })
        });
        let differing = self.halves.iter().enumerate().filter_map(|(member, halves)| {
            let PoseBetweenHalves { ratio, rotation_rad, translation_m } = halves.pose?;
            let (rotation_deg, translation_mm) = (rotation_rad.to_degrees(), 1e3 * translation_m);
            Finding::worse_than_good(
                Grade::of_figure(ratio, SPLIT_HALF),
                format!(
                    "the pose of camera `{}` differs between two halves of the frame sets by {ratio:.1} times its predicted uncertainty ({rotation_deg:.3}°, {translation_mm:.2} mm): check that the cameras are rigidly mounted and synchronized",
                    name(member)
                ),
            )
        });
        let contradicted = (0..group.len()).filter_map(|member| self.contradicted(member, group));
        misfitting.chain(open).chain(differing).chain(contradicted).collect()
    }

    /// A finding if a large part of a camera's views, which fit by themselves, contradict the
    /// board's poses by the other cameras: so many views are no outliers.
    fn contradicted(&self, member: usize, group: &[&SingleSensor<'_>]) -> Option<Finding> {
        let single = &group[member].solved.sensor.views;
        let used = single.iter().filter(|view| view.used).count();
        let pairs = single.iter().zip(&self.sensors[member].views);
        let lost: Vec<_> = pairs.filter(|(single, joint)| single.used && !joint.used).collect();
        if (lost.len() as f64) < CONTRADICTED_FRACTION * used as f64 {
            return None;
        }
        let (camera, first) = (&group[member].input.name, &lost.first()?.0.name);
        let reason = format!(
            "{} of {used} views of camera `{camera}` (first: `{first}`) contradict the board poses of the other cameras: a camera was moved, or its frames were taken at other times; use only frames taken while the rig was rigid and synchronized",
            lost.len()
        );
        Some(Finding { grade: Grade::Poor, reason })
    }
}

/// The fraction of a camera's views above which contradicting views are no outliers: boards rarely
/// move in so many. Chosen, not swept.
const CONTRADICTED_FRACTION: f64 = 0.25;

/// The board's shape as measured by cameras with the same labels in all their views, with its
/// points moved to where `labels` place them; `None` if there is no such camera.
fn measured_by(group: &[&SingleSensor<'_>], labels: ChosenLabels<'_>) -> Option<MeasuredBoard> {
    let shape = |(one, chosen): (&&SingleSensor<'_>, &Vec<usize>)| {
        let shape = one.solved.estimate.board_shape.as_ref()?;
        let (first, others) = chosen.split_first()?;
        let alike = others.iter().all(|symmetry| symmetry == first);
        alike.then(|| shape.transformed(&labels.board_from_labels[*first]))
    };
    let shapes: Vec<MeasuredBoard> = group.iter().zip(labels.chosen).filter_map(shape).collect();
    MeasuredBoard::mean_of(&shapes)
}

/// If a camera's residuals grow by more than this factor in the joint solve, the cameras moved
/// relative to each other, or the board moved between their images.
const MISFIT_RMS_RATIO: f64 = 1.5;
/// Standard deviations above which a relative pose is reported as loose: of the rotation in
/// degrees, of the translation as a part of its length.
const LOOSE_STD_DEG: f64 = 0.1;
const LOOSE_STD_FRACTION: f64 = 0.01;

fn largest(values: [f64; 3]) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}

/// The inverse pose, with its covariance propagated.
fn reference_from(reference: &SensorId, sensor: &SensorId, pose: &SensorPose) -> Extrinsics {
    let by_pose = pose.sensor_from_rig.inverse_jacobian();
    let std = PoseStd::of(&(by_pose * pose.covariance * by_pose.transpose()));
    Extrinsics {
        target: reference.clone(),
        source: sensor.clone(),
        target_from_source: pose.sensor_from_rig.inverse(),
        rotation_std: std.rotation,
        translation_std_m: std.translation_m,
    }
}
