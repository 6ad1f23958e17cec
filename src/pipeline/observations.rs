//! A session's views, with what the cameras' other sensors gave, as a problem to solve.

use crate::calibration::second_infrared::{StereoCapture, StereoInput};
use crate::calibration::session::Session;
use crate::calibration::solve_instrument::{CameraObservations, Observations};
use crate::calibration::solve_rgbd::{DepthSensor, RgbdCapture, RgbdInput};
use crate::calibration::view::{FrameFacts, View, target_as_seen};
use crate::estimation::problem::Correspondence;
use crate::geometry::depth_camera::DepthReading;
use crate::geometry::target::Target;
use crate::imaging::factory::FactorySensor;
use crate::imaging::frame::SensorKind;
use crate::pipeline::auxiliary::{AuxiliaryView, AuxiliaryViews};
use crate::pipeline::solve_job::{SeenBySensors, SolveJob, problem_of};

/// Depth in whole millimeters, as ROS has it (REP 118) and most devices, where nobody states
/// another unit.
const ORDINARY_UNIT_M: f64 = 0.001;

/// The problem of a session; `stated` is what each camera's device states of its depth sensor.
pub(super) fn solve_job(
    session: &Session,
    auxiliary: &AuxiliaryViews,
    stated: &[Option<FactorySensor>],
    is_rig: bool,
) -> Option<SolveJob> {
    let record = session.record();
    let of_camera = |place: usize| {
        let stated = stated.get(place).and_then(Option::as_ref);
        CameraSeen::of(session, place, auxiliary)
            .map_or((None, None), |seen| (seen.rgbd_input(stated), seen.stereo_input()))
    };
    let seen = if is_rig {
        let input = session.input();
        let place = |name: &str| {
            (0..).map_while(|place| session.camera(place)).position(|p| p.summary().camera == name)
        };
        let camera = |color: crate::calibration::solve_rig::RigCameraInput| {
            let (depth, second_infrared) = place(&color.name).map_or((None, None), of_camera);
            CameraObservations { color, depth, second_infrared }
        };
        let cameras = input.cameras.into_iter().map(camera).collect();
        SeenBySensors::Rig(Observations { board: input.board, cameras })
    } else {
        let (depth, second_infrared) = of_camera(0);
        let problem = problem_of(session, 0)?;
        SeenBySensors::Camera { problem, depth: depth.map(Box::new), second_infrared }
    };
    let views = session.camera(0).filter(|_| !is_rig).map_or(&[][..], |part| part.views());
    let target = target_as_seen(&record.request.target, views);
    let session = record.id.clone();
    Some(SolveJob { session, target, lens: record.request.lens, seen })
}

/// What one camera of a session saw.
struct CameraSeen<'a> {
    board: Target,
    /// Its views, each with its number in the session.
    views: Vec<(u32, &'a View)>,
    color_size: crate::geometry::pixel::ImageSize,
    auxiliary: &'a [AuxiliaryView],
}

impl<'a> CameraSeen<'a> {
    fn of(session: &'a Session, place: usize, auxiliary: &'a AuxiliaryViews) -> Option<Self> {
        let kept = session.kept().iter().filter(|kept| kept.camera == place);
        Some(Self {
            board: session.record().request.target,
            views: kept.filter_map(|kept| Some((kept.number, session.view(kept)?))).collect(),
            color_size: session.camera(place)?.image_size()?,
            auxiliary: auxiliary.views(),
        })
    }

    /// What a sensor gave with the view `number`.
    fn with(&self, number: u32, sensor: SensorKind) -> Option<&'a AuxiliaryView> {
        self.auxiliary.iter().find(|view| view.number == number && view.sensor == sensor)
    }

    /// All that a sensor gave with the camera's views.
    fn all(&self, sensor: SensorKind) -> impl Iterator<Item = &'a AuxiliaryView> {
        self.views.iter().filter_map(move |(number, _)| self.with(*number, sensor))
    }

    /// The joint problem of color, infrared and depth, with what the device states of its depth
    /// sensor; `None` where there is no depth.
    fn rgbd_input(&self, stated: Option<&FactorySensor>) -> Option<RgbdInput> {
        let depth_size = self.all(SensorKind::Depth).next()?.image_size;
        let capture = |(number, view): &(u32, &View)| RgbdCapture {
            name: view.frame.display_name(),
            time_s: None,
            is_view: true,
            color: view.to_board_view(&self.board).correspondences,
            infrared: self.corners(self.with(*number, SensorKind::Infrared), view),
            depth: self
                .with(*number, SensorKind::Depth)
                .and_then(|view| view.depth.as_deref())
                .filter(|depth| depth.size() == depth_size)
                .cloned(),
        };
        let infrared = self.all(SensorKind::Infrared).next();
        let unit_m = self.all(SensorKind::Depth).find_map(|view| view.unit_m);
        let depth = DepthSensor {
            reading: Some(DepthReading::Metric { unit_m: unit_m.unwrap_or(ORDINARY_UNIT_M) }),
            invalid: Some(0),
            factory: stated.filter(|stated| stated.image_size == depth_size).and_then(|stated| {
                let depth_from_color = stated.color_from_sensor?.inverse();
                Some((stated.lens?, depth_from_color))
            }),
            with_infrared: infrared.is_some_and(|infrared| infrared.image_size == depth_size),
        };
        let captures = self.views.iter().map(capture).collect();
        Some(RgbdInput { board: self.board, color_size: self.color_size, depth, captures })
    }

    /// Color and right infrared; `None` where there is none of the latter.
    fn stereo_input(&self) -> Option<StereoInput> {
        let infrared2_size = self.all(SensorKind::Infrared2).next()?.image_size;
        let capture = |(number, view): &(u32, &View)| {
            let infrared2 = self.with(*number, SensorKind::Infrared2);
            StereoCapture {
                name: view.frame.display_name(),
                color: view.to_board_view(&self.board).correspondences,
                infrared2: self
                    .corners(infrared2.filter(|seen| seen.image_size == infrared2_size), view),
            }
        };
        let captures = self.views.iter().map(capture).collect();
        let (board, color_size) = (self.board, self.color_size);
        Some(StereoInput { board, color_size, infrared2_size, captures })
    }

    fn corners(&self, seen: Option<&AuxiliaryView>, view: &View) -> Vec<Correspondence> {
        let Some((seen, detection)) = seen.and_then(|seen| Some((seen, seen.detection.clone()?)))
        else {
            return Vec::new();
        };
        let frame = FrameFacts { image_size: seen.image_size, ..view.frame.clone() };
        View { number: view.number, frame, detection }.to_board_view(&self.board).correspondences
    }
}
