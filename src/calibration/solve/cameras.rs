//! Several cameras: all of their image sensors in one joint solve. Depth, which shares infrared's
//! lens and pose, is then fitted to the boards' poses from that solve.

use nalgebra::DMatrix;

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::result::{
    CalibratedSensor, CalibratedView, Calibration, Extrinsics, Grade, ImageCalibration, Verdict,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::solve::composed_pose::through;
use crate::calibration::solve::observations::CameraFrameSets;
use crate::calibration::solve::rgbd_calibration::{
    color_from_depth, halves_of_depth, judged_with_depth,
};
use crate::calibration::solve::rgbd_input::RgbdInput;
use crate::calibration::solve::rig_input::{RigInput, RigSensorInput};
use crate::calibration::solve::solve_options::{
    InstrumentError, SolveOptions, UnsolvedDepth, without_depth,
};
use crate::calibration::solve::solve_rgbd::{SolvedRgbd, solve_rgbd};
use crate::calibration::solve::solve_rig::solve_rig;
use crate::estimation::consistent_labels::FrameSetPose;
use crate::estimation::rgbd::{PlacedDevice, RgbdEstimate, recalibrate_depth};
use crate::estimation::rig::FrameSetView;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// One camera of several, with its own solve of depth.
struct Member<'a> {
    camera: &'a CameraFrameSets,
    name: &'a str,
    /// Its depth, solved with its own sensors only; `None` without depth.
    device: Option<(RgbdInput, SolvedRgbd)>,
    /// Why its depth is left out.
    left_out: Option<String>,
}

/// Solves the image sensors of all cameras together, then places depth.
///
/// # Errors
/// [`InstrumentError`]: cameras that cannot be placed, or depth that does not go with its camera.
pub(super) fn solve_cameras(
    board: Target,
    cameras: &[CameraFrameSets],
    options: &SolveOptions,
) -> Result<Calibration, InstrumentError> {
    let members = cameras.iter().map(|camera| Member::of(board, camera, options));
    let members: Vec<Member<'_>> = members.collect::<Result<_, _>>()?;
    let mut sensors: Vec<RigSensorInput> = members.iter().flat_map(Member::image_sensors).collect();
    if members.iter().all(|member| member.has_one_sensor(&sensors)) {
        sensors
            .iter_mut()
            .for_each(|sensor| sensor.name = sensor.id.camera.clone().unwrap_or_default());
    }
    let input = RigInput { board, sensors };
    let mut whole = solve_rig(&input, &options.camera)?.into_calibration(board);
    for member in &members {
        member.add_depth(&mut whole, &input);
    }
    let order =
        |id: &SensorId| (cameras.iter().position(|camera| camera.name == id.camera), id.kind);
    whole.sensors.sort_by_key(|sensor| order(&sensor.id));
    whole.extrinsics.sort_by_key(|known| (order(&known.target), order(&known.source)));
    Ok(whole)
}

impl<'a> Member<'a> {
    fn of(
        board: Target,
        camera: &'a CameraFrameSets,
        options: &SolveOptions,
    ) -> Result<Self, InstrumentError> {
        let name = camera.name.as_deref().unwrap_or_default();
        let (mut device, mut left_out) = (None, None);
        if let Some(input) = camera.with_depth(board) {
            match (solve_rgbd(&input, &options.camera), options.unsolved_depth) {
                (Ok(solved), _) => device = Some((input, solved)),
                (Err(source), UnsolvedDepth::Refused) => {
                    return Err(InstrumentError::Camera { camera: name.to_owned(), source });
                }
                (Err(reason), UnsolvedDepth::LeftOut) => left_out = Some(without_depth(&reason)),
            }
        }
        Ok(Self { camera, name, device, left_out })
    }

    fn id(&self, kind: SensorKind) -> SensorId {
        SensorId { camera: self.camera.name.clone(), kind }
    }

    fn has_one_sensor(&self, sensors: &[RigSensorInput]) -> bool {
        let own = sensors.iter().filter(|sensor| sensor.id.camera == self.camera.name);
        own.count() == 1 && self.device.is_none()
    }

    /// Each of its image sensors with its observations. Infrared is as in the device's own solve:
    /// the views that were taken together with color, with the board where it was when color was
    /// taken.
    fn image_sensors(&self) -> Vec<RigSensorInput> {
        let kinds = self.camera.image_sensors.iter().map(|(kind, _)| *kind);
        let sensor = |kind: SensorKind| {
            let name = format!("{}.{}", self.name, kind.name());
            let mut sensor = self.camera.as_rig_sensor(name, kind, |_, seen| seen.number);
            if let (SensorKind::Infrared, Some((_, solved))) = (kind, &self.device)
                && solved.infrared.is_some()
            {
                sensor.views = solved.infrared_with_color();
                for seen in &mut sensor.views {
                    seen.frame_set = self.camera.frame_sets[seen.frame_set].number;
                }
            }
            sensor
        };
        let seen = |sensor: &RigSensorInput| {
            sensor.id.kind == SensorKind::Color || !sensor.views.is_empty()
        };
        kinds.map(sensor).filter(seen).collect()
    }

    /// Adds depth, its pose, and the findings about it.
    fn add_depth(&self, whole: &mut Calibration, input: &RigInput) {
        if let Some(reason) = &self.left_out {
            whole.verdict.lower(Grade::Usable, format!("{}: {reason}", self.name));
        }
        let Some((own, solved)) = &self.device else { return };
        let of = |kind| whole.sensor(&self.id(kind)).and_then(CalibratedSensor::as_image);
        let Some(color) = of(SensorKind::Color) else { return };
        let infrared = of(SensorKind::Infrared).filter(|_| solved.infrared.is_some());
        let placed = infrared.and_then(|infrared| self.placed(color, infrared, whole, input));
        let kept = solved.factory.as_ref().and_then(|check| check.kept.as_deref());
        let refitted = match (kept, &placed) {
            (None, Some((placed, _))) => {
                recalibrate_depth(&solved.problem, &solved.joint, placed).ok()
            }
            _ => None,
        };
        let of_own = kept.unwrap_or(&solved.joint);
        let of_own_halves = if refitted.is_none() { halves_of_depth(solved) } else { Vec::new() };
        let (estimate, known) = match (refitted, placed, infrared) {
            (Some(refitted), Some((_, known)), Some(infrared)) => {
                let depth_covariance = covariance(infrared);
                let known = Extrinsics { source: self.id(SensorKind::Depth), ..known };
                (RgbdEstimate { depth_covariance, ..refitted }, known)
            }
            _ => (of_own.clone(), self.by_way_of_color(whole, of_own)),
        };
        let depth = DepthCalibration::of(&estimate, own.depth.invalid);
        let clean = Verdict { grade: Grade::Good, reasons: Vec::new() };
        let mut verdict = judged_with_depth(clean, own, solved, &estimate, &depth);
        for finding in of_own_halves {
            verdict.lower(finding.grade, finding.reason);
        }
        whole.sensors.push(CalibratedSensor::depth(self.camera.name.as_deref(), depth));
        whole.extrinsics.push(known);
        whole.verdict.grade = whole.verdict.grade.min(verdict.grade);
        let reasons = verdict.reasons.into_iter().map(|reason| format!("{}: {reason}", self.name));
        whole.verdict.reasons.extend(reasons);
    }

    /// The input for fitting depth again, and the pose of infrared; `None` if infrared has no pose
    /// relative to color.
    fn placed(
        &self,
        color: &ImageCalibration,
        infrared: &ImageCalibration,
        whole: &Calibration,
        input: &RigInput,
    ) -> Option<(PlacedDevice, Extrinsics)> {
        let (_, solved) = self.device.as_ref()?;
        let pose = |kind| whole.extrinsics.iter().find(|known| known.source == self.id(kind));
        let known = pose(SensorKind::Infrared)?;
        let color_from_target = match pose(SensorKind::Color) {
            Some(color) if color.target == known.target => color.target_from_source.inverse(),
            Some(_) => return None,
            None => (known.target == self.id(SensorKind::Color)).then(Pose::identity)?,
        };
        let color_from_depth = color_from_target * known.target_from_source;
        let boards = [(SensorKind::Color, color), (SensorKind::Infrared, infrared)]
            .map(|(kind, sensor)| boards(input, &self.id(kind), sensor));
        let board = |frame_set: &usize| {
            let number = self.camera.frame_sets[*frame_set].number;
            let of = |boards: &[FrameSetPose]| {
                let own = boards.iter().find(|own| own.frame_set == number)?;
                Some(own.sensor_from_board)
            };
            of(&boards[0]).or_else(|| Some(color_from_depth * of(&boards[1])?))
        };
        let placed = PlacedDevice {
            color: color.lens,
            depth: infrared.lens,
            color_from_depth,
            color_from_board: solved.frame_set_of_view.iter().map(board).collect(),
        };
        Some((placed, known.clone()))
    }

    /// The pose of depth by way of its own camera's color, for a depth camera without infrared.
    fn by_way_of_color(&self, whole: &Calibration, estimate: &RgbdEstimate) -> Extrinsics {
        let color = self.id(SensorKind::Color);
        let own = color_from_depth(self.id(SensorKind::Depth), color.clone(), estimate);
        match whole.extrinsics.iter().find(|known| known.source == color) {
            Some(first) => through(first, &own),
            None => own,
        }
    }
}

/// The boards' poses in a sensor of the rig.
fn boards(input: &RigInput, id: &SensorId, sensor: &ImageCalibration) -> Vec<FrameSetPose> {
    let Some(own) = input.sensors.iter().find(|own| own.id == *id) else { return Vec::new() };
    let pose = |(seen, view): (&FrameSetView, &CalibratedView)| {
        let sensor_from_board = view.camera_from_board?;
        Some(FrameSetPose { frame_set: seen.frame_set, sensor_from_board })
    };
    own.views.iter().zip(&sensor.views).filter_map(pose).collect()
}

fn covariance(sensor: &ImageCalibration) -> DMatrix<f64> {
    let rows = &sensor.lens_covariance;
    DMatrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j])
}
