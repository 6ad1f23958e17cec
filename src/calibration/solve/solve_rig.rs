//! The solve of several cameras that are fixed to each other: each by itself, then all that share
//! views jointly.

use crate::calibration::result::{
    CalibratedSensor, Calibration, Checks, Extrinsics, Finding, Grade, ImageCalibration, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::list_shift::list_shift;
use crate::calibration::solve::rig_input::{RigInput, RigSensorInput};
use crate::calibration::solve::rig_joint::Joint;
use crate::calibration::solve::rig_member::SingleSensor;
use crate::calibration::solve::solve_views;
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;
use crate::estimation::problem::CameraProblem;
use crate::geometry::lens::Lens;
use crate::geometry::target::Target;

/// A solved rig.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedRig {
    /// The sensors that could be calibrated, in the rig's order.
    pub sensors: Vec<(SensorId, ImageCalibration)>,
    /// `a_from_b` for each sensor b that is connected by shared views, directly or through others,
    /// with an earlier sensor a; a is the first sensor of the connected group.
    pub extrinsics: Vec<Extrinsics>,
    /// The worst of each figure over the sensors; that of the halves also includes the sensors'
    /// poses.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
}

impl SolvedRig {
    /// The calibration.
    pub fn into_calibration(self, target: Target) -> Calibration {
        let sensors = self.sensors.into_iter();
        let sensors = sensors.map(|(id, sensor)| CalibratedSensor::image(id, sensor)).collect();
        Calibration {
            extrinsics: self.extrinsics,
            ..Calibration::unnamed(Some(target), sensors, self.checks, self.verdict)
        }
    }
}

/// Why a rig could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigError {
    /// Fewer than two cameras could be calibrated by themselves.
    #[error("only {solved} of {all} cameras can be calibrated; camera `{camera}`: {source}")]
    TooFewCameras {
        /// How many could be.
        solved: usize,
        /// Of how many.
        all: usize,
        /// The first that could not be.
        camera: String,
        /// Why not.
        source: EstimationError,
    },
    /// No two cameras saw the board in one frame set.
    #[error(
        "no two cameras saw the whole board in one frame set: hold it still where two of them see all of it"
    )]
    NothingShared,
    /// One camera's list of frames is shifted against another's.
    #[error(
        "the frames of `{camera}` match those of `{reference}` that are {when} in the list (by {places}): name or number the frames so that frames taken together have the same name or number"
    )]
    Shifted {
        /// The camera.
        camera: String,
        /// The camera that it is compared with.
        reference: String,
        /// By how many places.
        places: usize,
        /// `earlier` or `later`.
        when: &'static str,
    },
    /// The joint solve failed.
    #[error("joint solve of the cameras: {0}")]
    Joint(EstimationError),
}

/// Calibrates each sensor by itself, then those that share views jointly, lenses and poses.
///
/// # Errors
/// [`RigError`]. A sensor that cannot be calibrated, or shares no view with any other, does not
/// affect the others: the verdict names it.
pub fn solve_rig(input: &RigInput, options: &CameraOptions) -> Result<SolvedRig, RigError> {
    let (mut singles, mut failed) = (Vec::new(), Vec::new());
    for sensor in &input.sensors {
        let views = sensor.views.iter().map(|seen| seen.view.clone()).collect();
        let held = |lens: Lens| CameraOptions::holding(&lens, &options.interrupt);
        let options = sensor.given.map_or_else(|| options.clone(), held);
        // Views in which the board stands as before count too: another camera may see it there for
        // the first time.
        let options = CameraOptions { copies_count: true, ..options };
        match solve_views(&CameraProblem { image_size: sensor.image_size, views }, &options) {
            Ok(solved) => singles.push(SingleSensor { input: sensor, solved }),
            Err(source) => failed.push((sensor, source)),
        }
    }
    check_enough(input, &singles, &failed)?;
    if let Some(shifted) = shifted_list(&singles) {
        return Err(shifted);
    }
    let groups = connected(&singles);
    if !groups.iter().any(|group| leads_to_another(group, &singles)) {
        return Err(RigError::NothingShared);
    }
    let mut findings = Vec::new();
    for (sensor, source) in &failed {
        let reason = format!("camera `{}` is left out: {source}", sensor.name);
        findings.push(Finding { grade: Grade::Usable, reason });
    }
    let mut sensors: Vec<ImageCalibration> =
        singles.iter().map(|one| one.solved.sensor.clone()).collect();
    let mut extrinsics = Vec::new();
    let mut worst_pose_ratio: Option<f64> = None;
    for group in &groups {
        if !leads_to_another(group, &singles) {
            let reason = open_place(&singles[group[0]]);
            findings.push(Finding { grade: Grade::Usable, reason });
        }
        if group.len() < 2 {
            continue;
        }
        let (group, joint) = jointly(input, &singles, group, options, &mut findings)?;
        let members: Vec<&SingleSensor<'_>> = group.iter().map(|index| &singles[*index]).collect();
        findings.extend(joint.findings(&members));
        let ratios = joint.halves.iter().filter_map(|halves| Some(halves.pose?.ratio));
        worst_pose_ratio = ratios.chain(worst_pose_ratio).reduce(f64::max);
        for (index, halves) in group.iter().zip(&joint.halves) {
            singles[*index].solved.take_halves(halves.lens, halves.held_out_rms_px);
        }
        for (index, sensor) in group.iter().zip(joint.sensors) {
            sensors[*index] = sensor;
        }
        extrinsics.extend(joint.extrinsics);
    }
    let verdict = verdict(&singles, &sensors, findings);
    let sensors = singles.iter().zip(sensors).map(|(one, sensor)| (one.input.id.clone(), sensor));
    let checks = checks(&singles, worst_pose_ratio);
    Ok(SolvedRig { sensors: sensors.collect(), extrinsics, checks, verdict })
}

/// Solves the consistent sensors of a group jointly and returns their indices; `findings` name the
/// others.
fn jointly(
    input: &RigInput,
    singles: &[SingleSensor<'_>],
    group: &[usize],
    options: &CameraOptions,
    findings: &mut Vec<Finding>,
) -> Result<(Vec<usize>, Joint), RigError> {
    let mut group = group.to_vec();
    loop {
        let members: Vec<&SingleSensor<'_>> = group.iter().map(|index| &singles[*index]).collect();
        let error = match Joint::solve(input, &members, options) {
            Ok(joint) => return Ok((group, joint)),
            Err(error) => error,
        };
        let named = match &error {
            EstimationError::NothingAgrees { sensor } => {
                members.iter().position(|one| one.input.name == *sensor)
            }
            _ => None,
        };
        let Some(at) = named.filter(|_| group.len() > 2) else {
            return Err(RigError::Joint(error));
        };
        let name = &singles[group.remove(at)].input.name;
        findings.push(Finding {
            grade: Grade::Poor,
            reason: format!("the pose of camera `{name}` is not determined: {error}"),
        });
    }
}

/// Whether a group has more than one camera, or more than one sensor of the only camera.
fn leads_to_another(group: &[usize], singles: &[SingleSensor<'_>]) -> bool {
    singles[group[0]].is_other_than(&singles[group[group.len() - 1]])
}

/// Checks that two sensors could be calibrated, of different cameras if there are several cameras.
fn check_enough(
    input: &RigInput,
    singles: &[SingleSensor<'_>],
    failed: &[(&RigSensorInput, EstimationError)],
) -> Result<(), RigError> {
    let one_camera =
        input.sensors.iter().all(|sensor| sensor.id.camera == input.sensors[0].id.camera);
    let several = match singles {
        [] | [_] => false,
        [first, others @ ..] => one_camera || others.iter().any(|one| first.is_other_than(one)),
    };
    if several {
        return Ok(());
    }
    let first = failed.first().map(|(sensor, source)| (sensor.name.clone(), source.clone()));
    let (camera, source) = first.unwrap_or((String::new(), EstimationError::NoFit));
    Err(RigError::TooFewCameras { solved: singles.len(), all: input.sensors.len(), camera, source })
}

/// The finding that nothing determines this camera's pose.
fn open_place(isolated: &SingleSensor<'_>) -> String {
    let name = &isolated.input.name;
    let reason = "it never saw the whole board at the same time as another camera; show the board to both at once";
    format!("the pose of camera `{name}` is not determined: {reason}")
}

/// A camera whose frames agree with the first one's when they are taken to be of frame sets a few
/// places earlier or later, and not as they are.
fn shifted_list(singles: &[SingleSensor<'_>]) -> Option<RigError> {
    let (first, others) = singles.split_first()?;
    let reference = first.poses();
    others.iter().find_map(|other| {
        let by = list_shift(&reference, &other.poses())?;
        let (camera, reference) = (other.input.name.clone(), first.input.name.clone());
        let when = if by > 0 { "earlier" } else { "later" };
        Some(RigError::Shifted { camera, reference, places: by.unsigned_abs(), when })
    })
}

/// Groups of cameras that share frame sets, directly or through others; each group in order, and
/// the groups by their first camera.
fn connected(singles: &[SingleSensor<'_>]) -> Vec<Vec<usize>> {
    let frame_sets = |one: &SingleSensor<'_>| {
        one.poses().into_iter().map(|own| own.frame_set).collect::<Vec<_>>()
    };
    let frame_sets: Vec<Vec<usize>> = singles.iter().map(frame_sets).collect();
    let share = |a: usize, b: usize| {
        frame_sets[a].iter().any(|frame_set| frame_sets[b].contains(frame_set))
    };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for camera in 0..singles.len() {
        let (joined, separate): (Vec<_>, Vec<_>) =
            groups.into_iter().partition(|group| group.iter().any(|other| share(*other, camera)));
        let mut joined = joined.concat();
        joined.push(camera);
        joined.sort_unstable();
        groups = separate;
        groups.push(joined);
        groups.sort();
    }
    groups
}

/// `pose_ratio`: the split-half ratio of the worst sensor's pose.
fn checks(singles: &[SingleSensor<'_>], pose_ratio: Option<f64>) -> Checks {
    let all = || singles.iter().map(|one| &one.solved.checks);
    let worst = |figure: fn(&Checks) -> Option<f64>| all().filter_map(figure).reduce(f64::max);
    let lens_ratio = worst(|checks| checks.split_half_ratio);
    Checks {
        split_half_ratio: lens_ratio.into_iter().chain(pose_ratio).reduce(f64::max),
        held_out_rms_px: worst(|checks| checks.held_out_rms_px),
        outlier_fraction: worst(|checks| Some(checks.outlier_fraction)).unwrap_or(0.0),
        coverage: all().map(|checks| checks.coverage).reduce(f64::min).unwrap_or(0.0),
    }
}

/// The verdict of each camera by itself, with its uncertainty in the joint solve (`sensors`), and
/// of all of them.
fn verdict(
    singles: &[SingleSensor<'_>],
    sensors: &[ImageCalibration],
    findings: Vec<Finding>,
) -> Verdict {
    let of_camera = |(one, sensor): (&SingleSensor<'_>, &ImageCalibration)| {
        let of_camera = one.solved.verdict_of(sensor);
        let named = |reason| Finding {
            grade: of_camera.grade,
            reason: format!("{}: {reason}", one.input.name),
        };
        of_camera.reasons.into_iter().map(named).collect::<Vec<_>>()
    };
    // A given lens that is another camera's is the cause of what is wrong with the poses.
    let (causes, others): (Vec<_>, Vec<_>) =
        singles.iter().zip(sensors).partition(|(one, _)| one.solved.given_misfit().is_some());
    let causes = causes.into_iter().flat_map(of_camera);
    Verdict::of(causes.chain(findings).chain(others.into_iter().flat_map(of_camera)).collect())
}

#[cfg(test)]
#[path = "solve_rig_tests.rs"]
mod tests;
