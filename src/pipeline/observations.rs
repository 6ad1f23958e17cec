//! A session's views, with those of the cameras' other sensors, as a problem to solve.

use crate::calibration::scene::SceneDepth;
use crate::calibration::scene::key_frames::KeyFrame;
use crate::calibration::session::Session;
use crate::calibration::solve::rgbd_input::DepthSensor;
use crate::calibration::view::{FrameFacts, View, target_as_seen};
use crate::calibration::{CameraFrameSets, InstrumentObservations, ObservedFrameSet};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::problem::Correspondence;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::FactorySensor;
use crate::imaging::frame::SensorKind;
use crate::pipeline::auxiliary::{AuxiliaryView, AuxiliaryViews};
use crate::pipeline::solve_job::{SolveInput, SolveJob};

/// The solve of a session; `stated` is what each camera's device states about its depth sensor.
pub(super) fn solve_job(
    session: &Session,
    auxiliary: &AuxiliaryViews,
    stated: &[Option<FactorySensor>],
    is_rig: bool,
) -> SolveJob {
    let record = session.record();
    let Some(board) = record.request.target.board() else {
        let stated = stated.first().and_then(Option::as_ref);
        let key_frames = session.camera(0).map_or(&[][..], |part| part.key_frames());
        let images = key_frames.iter().map(|key| key.image.clone()).collect();
        let depth = scene_depth(key_frames, auxiliary.views(), stated).map(Box::new);
        let observations = SolveInput::Scene(images, depth);
        return SolveJob {
            session: record.id.clone(),
            lens: record.request.lens,
            observations,
            interrupt: Interrupt::new(),
        };
    };
    let places = (0..).take_while(|place| session.camera(*place).is_some());
    let camera = |place: usize| {
        let stated = stated.get(place).and_then(Option::as_ref);
        let seen = CameraObservations::of(session, board, place, auxiliary)?;
        let name = session.camera(place)?.summary().camera.clone();
        let given = record.request.held(&name);
        let camera = CameraFrameSets { given, ..seen.frame_sets(stated) };
        // A rig's camera that has not delivered an image yet is left out.
        let gave = seen.color_size.width > 0;
        let name = is_rig.then_some(name);
        (gave || !is_rig).then_some(CameraFrameSets { name, ..camera })
    };
    let views = session.camera(0).filter(|_| !is_rig).map_or(&[][..], |part| part.views());
    let observations = InstrumentObservations {
        board: Some(target_as_seen(&board, views)),
        cameras: places.filter_map(camera).collect(),
    };
    let observations = SolveInput::Board(Box::new(observations));
    SolveJob {
        session: record.id.clone(),
        lens: record.request.lens,
        observations,
        interrupt: Interrupt::new(),
    }
}

/// Depth that was measured together with the key frames of a scene; `None` where there is none.
fn scene_depth(
    key_frames: &[KeyFrame],
    auxiliary: &[AuxiliaryView],
    stated: Option<&FactorySensor>,
) -> Option<SceneDepth> {
    let of_depth = || auxiliary.iter().filter(|view| view.sensor == SensorKind::Depth);
    let size = of_depth().next()?.image_size;
    let image = |key: &KeyFrame| of_depth().find(|view| view.number == key.number)?.depth.clone();
    let encoding = of_depth().find_map(|view| view.depth_encoding);
    let sensor = depth_sensor(encoding, size, stated, false);
    Some(SceneDepth { sensor, images: key_frames.iter().map(image).collect() })
}

/// What is known about a depth sensor with images of `size`, including the device's statements.
fn depth_sensor(
    encoding: Option<DepthEncoding>,
    size: ImageSize,
    stated: Option<&FactorySensor>,
    with_infrared: bool,
) -> DepthSensor {
    let encoding = encoding.unwrap_or(DepthEncoding::ORDINARY);
    DepthSensor {
        reading: encoding.reading,
        invalid: encoding.invalid,
        factory: stated.and_then(|stated| stated.depth_lens(size)),
        with_infrared,
    }
}

/// The observations of one camera of a session.
struct CameraObservations<'a> {
    board: Target,
    /// Its views, each with its number in the session and that of its frame set.
    views: Vec<(u32, usize, &'a View)>,
    /// 0 × 0 before the first image.
    color_size: ImageSize,
    auxiliary: &'a [AuxiliaryView],
}

impl<'a> CameraObservations<'a> {
    fn of(
        session: &'a Session,
        board: Target,
        place: usize,
        auxiliary: &'a AuxiliaryViews,
    ) -> Option<Self> {
        let kept = session.kept().iter().filter(|kept| kept.camera == place);
        let views = kept
            .filter_map(|kept| Some((kept.number, kept.frame_set as usize, session.view(kept)?)));
        Some(Self {
            board,
            views: views.collect(),
            color_size: session.camera(place)?.image_size().unwrap_or(ImageSize::new(0, 0)),
            auxiliary: auxiliary.views(),
        })
    }

    /// What a sensor delivered with the view `number`.
    fn with(&self, number: u32, sensor: SensorKind) -> Option<&'a AuxiliaryView> {
        self.auxiliary.iter().find(|view| view.number == number && view.sensor == sensor)
    }

    /// Everything that a sensor delivered with the camera's views.
    fn all(&self, sensor: SensorKind) -> impl Iterator<Item = &'a AuxiliaryView> {
        self.views.iter().filter_map(move |(number, ..)| self.with(*number, sensor))
    }

    /// The observations of each sensor; images of another size than the sensor's first are left
    /// out.
    fn frame_sets(&self, stated: Option<&FactorySensor>) -> CameraFrameSets {
        let depth_size = self.all(SensorKind::Depth).next().map(|depth| depth.image_size);
        let is_other = |kind: &SensorKind| kind.is_image() && *kind != SensorKind::Color;
        let size = |kind| Some((kind, self.all(kind).next()?.image_size));
        let others: Vec<(SensorKind, ImageSize)> =
            SensorKind::ALL.into_iter().filter(is_other).filter_map(size).collect();
        let frame_set = |(number, frame_set, view): &(u32, usize, &View)| {
            let other = |(kind, size): &(SensorKind, ImageSize)| {
                let seen = self.with(*number, *kind).filter(|seen| seen.image_size == *size);
                (*kind, self.corners(seen, view))
            };
            let color = (SensorKind::Color, view.to_board_view(&self.board).correspondences);
            ObservedFrameSet {
                number: *frame_set,
                name: view.frame.display_name(),
                time_s: None,
                is_view: true,
                corners: std::iter::once(color).chain(others.iter().map(other)).collect(),
                depth: self
                    .with(*number, SensorKind::Depth)
                    .and_then(|view| view.depth.as_deref())
                    .filter(|depth| Some(depth.size()) == depth_size)
                    .cloned(),
            }
        };
        let color = (SensorKind::Color, self.color_size);
        CameraFrameSets {
            name: None,
            image_sensors: std::iter::once(color).chain(others.iter().copied()).collect(),
            given: None,
            depth: depth_size.map(|size| self.depth_sensor(size, stated)),
            frame_sets: self.views.iter().map(frame_set).collect(),
        }
    }

    /// What is known about the depth sensor, including the device's statements.
    fn depth_sensor(&self, size: ImageSize, stated: Option<&FactorySensor>) -> DepthSensor {
        let mut of_depth = SensorKind::ALL.into_iter().filter(|kind| kind.is_of_depth());
        let infrared = of_depth.find_map(|kind| self.all(kind).next());
        let encoding = self.all(SensorKind::Depth).find_map(|view| view.depth_encoding);
        let with_infrared = infrared.is_some_and(|infrared| infrared.image_size == size);
        depth_sensor(encoding, size, stated, with_infrared)
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
