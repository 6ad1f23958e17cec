//! The solve of several cameras that are fixed to each other: each by itself, then all that share
//! views jointly.

use nalgebra::{Matrix3, Matrix6, Vector3};

use crate::calibration::list_shift::list_shift;
use crate::calibration::result::{
    CalibratedSensor, Calibration, Checks, Extrinsics, Grade, ImageCalibration, Verdict, pose_std,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::{SolvedCamera, sensor_calibration, solve_views};
use crate::estimation::camera::CameraOptions;
use crate::estimation::consistent_labels::{SensorPoses, consistent_labels};
use crate::estimation::error::EstimationError;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::{BoardView, CameraProblem, LensChoice};
use crate::estimation::rig::{RigProblem, RigSensor, SensorPlace, calibrate_rig};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// Image sensors that are fixed to each other, to be calibrated together.
#[derive(Debug, Clone, PartialEq)]
pub struct RigInput {
    /// The board.
    pub board: Target,
    /// The sensors, camera by camera.
    pub sensors: Vec<RigSensorInput>,
}

/// One image sensor of a rig and what it saw.
#[derive(Debug, Clone, PartialEq)]
pub struct RigSensorInput {
    /// Which.
    pub id: SensorId,
    /// What it is called in messages.
    pub name: String,
    /// The size of its images.
    pub image_size: ImageSize,
    /// Its lens, where that is known and held.
    pub given: Option<Lens>,
    /// What it saw, and in which frame set: those of the same number were seen together.
    pub views: Vec<(usize, BoardView)>,
}

/// A solved rig.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedRig {
    /// The sensors that could be calibrated, in the rig's order.
    pub sensors: Vec<(SensorId, ImageCalibration)>,
    /// `a_from_b` of each sensor b that shares views, directly or through others, with an earlier
    /// sensor a; a is the first of those that it is connected with.
    pub extrinsics: Vec<Extrinsics>,
    /// The worst of each figure over the sensors.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
}

impl SolvedRig {
    /// The calibration that it amounts to.
    pub fn into_calibration(self, target: Target) -> Calibration {
        let sensors = self.sensors.into_iter();
        let sensors = sensors.map(|(id, sensor)| CalibratedSensor::image(id, sensor)).collect();
        let made = (self.checks, self.verdict);
        Calibration {
            extrinsics: self.extrinsics,
            ..Calibration::unnamed(Some(target), sensors, made)
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
        "no two cameras saw the whole board at the same moment: hold it still where two of them see all of it"
    )]
    NothingShared,
    /// One camera's list of frames is shifted against another's.
    #[error(
        "the frames of `{camera}` fit those of `{reference}` {places} places {when}, and not those they are taken to be together with: name or number them so that frames taken together are alike"
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
    /// All together could not be.
    #[error("the cameras together: {0}")]
    Joint(EstimationError),
}

/// A sensor that was calibrated by itself.
struct Alone<'a> {
    input: &'a RigSensorInput,
    solved: SolvedCamera,
}

/// Calibrates each sensor by itself, then those that share views jointly, lenses and poses.
///
/// # Errors
/// [`RigError`]. A sensor that cannot be calibrated, or shares no view with any other, costs the
/// others nothing: the verdict names it.
pub fn solve_rig(input: &RigInput, options: &CameraOptions) -> Result<SolvedRig, RigError> {
    let (mut alone, mut failed) = (Vec::new(), Vec::new());
    for sensor in &input.sensors {
        let views = sensor.views.iter().map(|(_, view)| view.clone()).collect();
        let held = |lens: Lens| holding(&lens, &options.interrupt);
        let options = sensor.given.map_or_else(|| options.clone(), held);
        match solve_views(&CameraProblem { image_size: sensor.image_size, views }, &options) {
            Ok(solved) => alone.push(Alone { input: sensor, solved }),
            Err(source) => failed.push((sensor, source)),
        }
    }
    check_enough(input, &alone, &failed)?;
    if let Some(shifted) = shifted_list(&alone) {
        return Err(shifted);
    }
    let groups = connected(&alone);
    let across = |group: &Vec<usize>| alone[group[0]].is_other_than(&alone[group[group.len() - 1]]);
    if !groups.iter().any(across) {
        return Err(RigError::NothingShared);
    }
    let mut findings = Vec::new();
    for (sensor, source) in &failed {
        let reason = format!("camera `{}` is left out: {source}", sensor.name);
        findings.push((Grade::Usable, reason));
    }
    let mut sensors: Vec<ImageCalibration> =
        alone.iter().map(|one| one.solved.sensor.clone()).collect();
    let mut extrinsics = Vec::new();
    for group in &groups {
        if !across(group) {
            findings.push((Grade::Usable, open_place(&alone[group[0]])));
        }
        if group.len() < 2 {
            continue;
        }
        let members: Vec<&Alone<'_>> = group.iter().map(|index| &alone[*index]).collect();
        let joint = Joint::solve(input, &members, &options.interrupt)?;
        findings.extend(joint.findings(&members));
        for (index, sensor) in group.iter().zip(joint.sensors) {
            sensors[*index] = sensor;
        }
        extrinsics.extend(joint.extrinsics);
    }
    let sensors = alone.iter().zip(sensors).map(|(one, sensor)| (one.input.id.clone(), sensor));
    Ok(SolvedRig {
        sensors: sensors.collect(),
        extrinsics,
        checks: checks(&alone),
        verdict: verdict(&alone, findings),
    })
}

/// Two sensors that could be calibrated, of two cameras where there are as many.
fn check_enough(
    input: &RigInput,
    alone: &[Alone<'_>],
    failed: &[(&RigSensorInput, EstimationError)],
) -> Result<(), RigError> {
    let one_camera =
        input.sensors.iter().all(|sensor| sensor.id.camera == input.sensors[0].id.camera);
    let several = match alone {
        [] | [_] => false,
        [first, others @ ..] => one_camera || others.iter().any(|one| first.is_other_than(one)),
    };
    if several {
        return Ok(());
    }
    let first = failed.first().map(|(sensor, source)| (sensor.name.clone(), source.clone()));
    let (camera, source) = first.unwrap_or((String::new(), EstimationError::NoFit));
    Err(RigError::TooFewCameras { solved: alone.len(), all: input.sensors.len(), camera, source })
}

/// That nothing places the camera of this sensor.
fn open_place(isolated: &Alone<'_>) -> String {
    let name = &isolated.input.name;
    let reason =
        "saw the whole board at no moment at which another camera did: show it to both at once";
    format!("where camera `{name}` is stays open: it {reason}")
}

/// Options that hold every parameter of `lens`; `interrupt` ends the estimate.
pub(super) fn holding(lens: &Lens, interrupt: &Interrupt) -> CameraOptions {
    let names = Lens::parameter_names(lens.model()).into_iter().map(str::to_owned);
    let given = names.zip(lens.parameters()).collect();
    CameraOptions {
        lens: LensChoice::Model(lens.model()),
        given,
        interrupt: interrupt.clone(),
        ..CameraOptions::default()
    }
}

/// A camera whose frames agree with the first one's when they are taken to be of frame sets a few
/// places earlier or later, and not as they are.
fn shifted_list(alone: &[Alone<'_>]) -> Option<RigError> {
    let (first, others) = alone.split_first()?;
    let reference = first.poses();
    others.iter().find_map(|other| {
        let by = list_shift(&reference, &other.poses())?;
        let (camera, reference) = (other.input.name.clone(), first.input.name.clone());
        let when = if by > 0 { "earlier" } else { "later" };
        Some(RigError::Shifted { camera, reference, places: by.unsigned_abs(), when })
    })
}

/// Which cameras share frame sets, directly or through others; each group in order, and the groups
/// by their first camera.
fn connected(alone: &[Alone<'_>]) -> Vec<Vec<usize>> {
    let frame_sets = |one: &Alone<'_>| {
        one.poses().into_iter().map(|(frame_set, _)| frame_set).collect::<Vec<_>>()
    };
    let frame_sets: Vec<Vec<usize>> = alone.iter().map(frame_sets).collect();
    let share = |a: usize, b: usize| {
        frame_sets[a].iter().any(|frame_set| frame_sets[b].contains(frame_set))
    };
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for camera in 0..alone.len() {
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

impl Alone<'_> {
    /// Whether it is of another camera, or another sensor of the only one.
    fn is_other_than(&self, other: &Self) -> bool {
        match (&self.input.id.camera, &other.input.id.camera) {
            (None, None) => self.input.id.kind != other.input.id.kind,
            (one, other) => one != other,
        }
    }

    /// The pose of every view in use, with its frame set.
    fn poses(&self) -> SensorPoses {
        let views = self.input.views.iter().zip(&self.solved.estimate.views);
        let pose = |((frame_set, _), view): (
            &(usize, BoardView),
            &crate::estimation::camera::ViewEstimate,
        )| {
            Some((*frame_set, view.camera_from_board.filter(|_| view.fault.is_none())?))
        };
        views.filter_map(pose).collect()
    }

    /// What it saw, with the points of each view where `symmetries` say that they are.
    fn with_labels_corrected(
        &self,
        board_from_labels: &[Pose],
        chosen: &[usize],
    ) -> Vec<(usize, BoardView)> {
        let good = self
            .solved
            .estimate
            .views
            .iter()
            .map(|view| view.fault.is_none() && view.camera_from_board.is_some());
        let mut chosen = chosen.iter();
        let views = self.input.views.iter().zip(good);
        let with_labels_corrected = |((frame_set, view), good): (&(usize, BoardView), bool)| {
            let symmetry = if good { chosen.next().copied().unwrap_or(0) } else { 0 };
            let mut view = view.clone();
            for corner in &mut view.correspondences {
                corner.point_in_board = board_from_labels[symmetry] * corner.point_in_board;
            }
            (*frame_set, view)
        };
        views.map(with_labels_corrected).collect()
    }
}

/// Cameras that were solved together.
struct Joint {
    sensors: Vec<ImageCalibration>,
    extrinsics: Vec<Extrinsics>,
    /// For each sensor: its noise together with the others over that by itself.
    rms_ratio: Vec<f64>,
}

impl Joint {
    fn solve(
        input: &RigInput,
        group: &[&Alone<'_>],
        interrupt: &Interrupt,
    ) -> Result<Self, RigError> {
        let symmetries = input.board.symmetries();
        let board_from_labels: Vec<Pose> = symmetries.iter().map(Pose::inverse).collect();
        let chosen = consistent_labels(
            &group.iter().map(|one| one.poses()).collect::<Vec<_>>(),
            &symmetries,
        );
        let sensor = |(one, chosen): (&&Alone<'_>, &Vec<usize>)| RigSensor {
            name: one.input.name.clone(),
            image_size: one.input.image_size,
            views: one.with_labels_corrected(&board_from_labels, chosen),
            options: match &one.input.given {
                Some(lens) => holding(lens, interrupt),
                None => CameraOptions {
                    lens: LensChoice::Model(one.solved.sensor.lens.model()),
                    interrupt: interrupt.clone(),
                    ..CameraOptions::default()
                },
            },
        };
        let sensors: Vec<RigSensor> = group.iter().zip(&chosen).map(sensor).collect();
        let end = sensors
            .iter()
            .flat_map(|sensor| &sensor.views)
            .map(|(frame_set, _)| frame_set + 1)
            .max();
        let problem = RigProblem { sensors, frame_sets: end.unwrap_or(0) };
        let estimate = calibrate_rig(&problem).map_err(RigError::Joint)?;
        let reference = &group[0].input.id;
        let placed = group.iter().zip(&estimate.places).skip(1);
        let with_comparison = |(one, camera): (&&Alone<'_>, _)| ImageCalibration {
            compared: one.solved.sensor.compared.clone(),
            ..sensor_calibration(camera)
        };
        let rms_ratio = group
            .iter()
            .zip(&estimate.cameras)
            .map(|(one, camera)| camera.rms_px / one.solved.estimate.rms_px.max(1e-3));
        Ok(Self {
            sensors: group.iter().zip(&estimate.cameras).map(with_comparison).collect(),
            extrinsics: placed
                .map(|(one, place)| reference_from(reference, &one.input.id, place))
                .collect(),
            rms_ratio: rms_ratio.collect(),
        })
    }

    fn findings(&self, group: &[&Alone<'_>]) -> Vec<(Grade, String)> {
        let name = |member: usize| group[member].input.name.as_str();
        let each = self.rms_ratio.iter().enumerate();
        let misfitting = each.filter(|(_, rms_ratio)| **rms_ratio > MISFITTING);
        let misfitting = misfitting.map(|(member, rms_ratio)| {
            let cause =
                "the board moved between the cameras' images, or the cameras against each other: hold it still";
            let camera = name(member);
            (
                Grade::Usable,
                format!("camera `{camera}` fits {rms_ratio:.1} times worse with the others than by itself; {cause}"),
            )
        });
        let open = self.extrinsics.iter().enumerate().filter_map(|(place, known)| {
            let (rotation_deg, translation_m) =
                (largest(known.rotation_std).to_degrees(), largest(known.translation_std_m));
            let loose = rotation_deg > LOOSE_DEG
                || translation_m
                    > LOOSE_PART * known.target_from_source.translation().norm().max(0.1);
            let advice = "show the board to both in more places, near and tilted";
            loose.then(|| {
                let reason = format!(
                    "{}_from_{} is known to {rotation_deg:.2}° and {:.1} mm only: {advice}",
                    name(0),
                    name(place + 1),
                    1e3 * translation_m
                );
                (Grade::Usable, reason)
            })
        });
        misfitting.chain(open).collect()
    }
}

/// A camera whose residuals grow by more than this when it is solved with the others was not where
/// they say.
const MISFITTING: f64 = 1.5;
/// Standard deviations above which a relative pose is reported as loose: of the rotation in degrees,
/// of the translation as a part of its length.
const LOOSE_DEG: f64 = 0.1;
const LOOSE_PART: f64 = 0.01;

fn largest(values: [f64; 3]) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}

/// The pose the other way round, with its covariance carried along: with R, t of `sensor_from_rig`,
/// a rotation ω and a translation τ of it are −Rᵀω and −Rᵀτ − Rᵀ\[t\]ω of its inverse.
fn reference_from(reference: &SensorId, sensor: &SensorId, place: &SensorPlace) -> Extrinsics {
    let rig_from_sensor = place.sensor_from_rig.inverse();
    let back = rig_from_sensor.rotation_matrix();
    let mut by_place = Matrix6::zeros();
    by_place.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
    by_place.fixed_view_mut::<3, 3>(3, 3).copy_from(&-back);
    by_place
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(-back * cross(&place.sensor_from_rig.translation())));
    let (rotation_std, translation_std) =
        pose_std(&(by_place * place.covariance * by_place.transpose()));
    Extrinsics {
        target: reference.clone(),
        source: sensor.clone(),
        target_from_source: rig_from_sensor,
        rotation_std: rotation_std.into(),
        translation_std_m: translation_std.into(),
    }
}

fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

fn checks(alone: &[Alone<'_>]) -> Checks {
    let all = || alone.iter().map(|one| &one.solved.checks);
    let worst = |figure: fn(&Checks) -> Option<f64>| all().filter_map(figure).reduce(f64::max);
    Checks {
        split_half_ratio: worst(|checks| checks.split_half_ratio),
        held_out_rms_px: worst(|checks| checks.held_out_rms_px),
        outlier_fraction: worst(|checks| Some(checks.outlier_fraction)).unwrap_or(0.0),
        coverage: all().map(|checks| checks.coverage).reduce(f64::min).unwrap_or(0.0),
    }
}

/// What holds of each camera by itself, and of all together.
fn verdict(alone: &[Alone<'_>], mut findings: Vec<(Grade, String)>) -> Verdict {
    for one in alone {
        let Verdict { grade, reasons } = &one.solved.verdict;
        findings
            .extend(reasons.iter().map(|reason| (*grade, format!("{}: {reason}", one.input.name))));
    }
    let grades = alone
        .iter()
        .map(|one| one.solved.verdict.grade)
        .chain(findings.iter().map(|(grade, _)| *grade));
    let grade = grades.min().unwrap_or(Grade::Good);
    findings.sort_by_key(|(grade, _)| *grade);
    Verdict { grade, reasons: findings.into_iter().map(|(_, reason)| reason).collect() }
}

#[cfg(test)]
#[path = "solve_rig_tests.rs"]
mod tests;
