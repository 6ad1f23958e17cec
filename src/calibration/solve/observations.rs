//! The observations of an instrument's sensors: the one input of [`crate::calibration::solve()`],
//! whether the instrument is a camera, a depth camera, or a rig of either.

use crate::calibration::sensor::SensorId;
use crate::calibration::solve::rgbd_input::{DepthSensor, RgbdFrameSet, RgbdInput};
use crate::calibration::solve::rig_input::RigSensorInput;
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence};
use crate::estimation::rig::FrameSetView;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::SensorKind;

/// The observations of an instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct InstrumentObservations {
    /// The board; `None` where correspondences were given without one, for one camera's color.
    pub board: Option<Target>,
    /// Its cameras, of which the first is the instrument's own frame.
    pub cameras: Vec<CameraFrameSets>,
}

/// The observations of one camera's sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFrameSets {
    /// Its name in the rig; `None` where the instrument is this camera.
    pub name: Option<String>,
    /// Its image sensors, color among them, with the size of their images.
    pub image_sensors: Vec<(SensorKind, ImageSize)>,
    /// The lens of its color sensor, if it is known and held fixed.
    pub given: Option<Lens>,
    /// What is known of its depth sensor; `None` without one.
    pub depth: Option<DepthSensor>,
    /// What was seen, in the order of time.
    pub frame_sets: Vec<ObservedFrameSet>,
}

/// The observations in one frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservedFrameSet {
    /// The number of the frame set; other cameras' frame sets with the same number were taken
    /// together with it.
    pub number: usize,
    /// Its path or sequence number.
    pub name: String,
    /// When color was taken, in seconds from an arbitrary origin; `None` if times are not
    /// meaningful.
    pub time_s: Option<f64>,
    /// Whether it is a view. The others determine how the board moved, and the time offsets between
    /// the sensors.
    pub is_view: bool,
    /// The board in the images that show it, by sensor.
    pub corners: Vec<(SensorKind, Vec<Correspondence>)>,
    /// The depth image, where there is one.
    pub depth: Option<DepthImage>,
}

impl ObservedFrameSet {
    /// A view of color alone.
    pub fn of_view(FrameSetView { frame_set, view }: FrameSetView) -> Self {
        Self {
            number: frame_set,
            name: view.name,
            time_s: None,
            is_view: true,
            corners: vec![(SensorKind::Color, view.correspondences)],
            depth: None,
        }
    }

    /// The board's corners in the image of this sensor; empty where it does not show the board.
    pub fn corners(&self, sensor: SensorKind) -> &[Correspondence] {
        let of = self.corners.iter().find(|(kind, _)| *kind == sensor);
        of.map_or(&[], |(_, corners)| corners.as_slice())
    }

    fn board_view(&self, sensor: SensorKind) -> BoardView {
        BoardView { name: self.name.clone(), correspondences: self.corners(sensor).to_vec() }
    }
}

impl InstrumentObservations {
    /// Of an instrument that is one camera.
    pub fn of_camera(board: Option<Target>, camera: CameraFrameSets) -> Self {
        Self { board, cameras: vec![camera] }
    }

    /// Of an instrument that is one sensor.
    pub fn of_views(board: Option<Target>, problem: CameraProblem) -> Self {
        let views = problem.views.into_iter().enumerate();
        let views = views.map(|(frame_set, view)| FrameSetView { frame_set, view });
        let camera = CameraFrameSets {
            name: None,
            image_sensors: vec![(SensorKind::Color, problem.image_size)],
            given: None,
            depth: None,
            frame_sets: views.map(ObservedFrameSet::of_view).collect(),
        };
        Self::of_camera(board, camera)
    }

    /// The instrument's sensors, camera by camera.
    pub fn sensors(&self) -> Vec<SensorId> {
        let of_camera = |camera: &CameraFrameSets| {
            let images = camera.image_sensors.iter().map(|(kind, _)| *kind);
            let depth = camera.depth.iter().map(|_| SensorKind::Depth);
            let id = |kind| SensorId { camera: camera.name.clone(), kind };
            images.chain(depth).map(id).collect::<Vec<_>>()
        };
        self.cameras.iter().flat_map(of_camera).collect()
    }
}

impl CameraFrameSets {
    /// The size of a sensor's images; `None` for a sensor that it lacks.
    pub fn image_size(&self, sensor: SensorKind) -> Option<ImageSize> {
        self.image_sensors.iter().find(|(kind, _)| *kind == sensor).map(|(_, size)| *size)
    }

    /// The image sensors other than color, and other than the infrared sensor whose images depth is
    /// computed from, which is solved together with depth.
    pub(super) fn beside_color(&self) -> impl Iterator<Item = SensorKind> {
        let with_depth = self.depth.is_some();
        let kinds = self.image_sensors.iter().map(|(kind, _)| *kind);
        kinds.filter(move |kind| *kind != SensorKind::Color && !(with_depth && kind.is_of_depth()))
    }

    /// The frame sets that are views.
    pub(super) fn views(&self) -> impl Iterator<Item = &ObservedFrameSet> {
        self.frame_sets.iter().filter(|seen| seen.is_view)
    }

    /// The views that show the board in this sensor's images, as a problem of that sensor alone.
    pub(super) fn problem(&self, sensor: SensorKind) -> CameraProblem {
        let seen = self.views().filter(|seen| !seen.corners(sensor).is_empty());
        CameraProblem {
            image_size: self.image_size(sensor).unwrap_or(ImageSize::new(0, 0)),
            views: seen.map(|seen| seen.board_view(sensor)).collect(),
        }
    }

    /// One image sensor as a sensor of a rig, called `name`. `frame_set_of` numbers a view, given
    /// its index among the views and its frame set.
    pub(super) fn as_rig_sensor(
        &self,
        name: String,
        sensor: SensorKind,
        frame_set_of: impl Fn(usize, &ObservedFrameSet) -> usize,
    ) -> RigSensorInput {
        let seen = self.views().enumerate();
        let seen = seen.filter(|(_, seen)| !seen.corners(sensor).is_empty());
        RigSensorInput {
            id: SensorId { camera: self.name.clone(), kind: sensor },
            name,
            image_size: self.image_size(sensor).unwrap_or(ImageSize::new(0, 0)),
            given: self.given.filter(|_| sensor == SensorKind::Color),
            views: seen
                .map(|(index, seen)| FrameSetView {
                    frame_set: frame_set_of(index, seen),
                    view: seen.board_view(sensor),
                })
                .collect(),
        }
    }

    /// The joint problem of color, infrared and depth; `None` without depth.
    pub(super) fn with_depth(&self, board: Target) -> Option<RgbdInput> {
        let frame_set = |seen: &ObservedFrameSet| RgbdFrameSet {
            name: seen.name.clone(),
            time_s: seen.time_s,
            is_view: seen.is_view,
            color: seen.corners(SensorKind::Color).to_vec(),
            infrared: seen.corners(SensorKind::Infrared).to_vec(),
            depth: seen.depth.clone(),
        };
        Some(RgbdInput {
            board,
            color_size: self.image_size(SensorKind::Color)?,
            depth: self.depth.clone()?,
            frame_sets: self.frame_sets.iter().map(frame_set).collect(),
        })
    }
}
