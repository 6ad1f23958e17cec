//! The result: an immutable calibration with its uncertainty, checks and verdict. It has a list of
//! sensors, whatever the instrument: one camera, a depth camera, a rig.

pub mod verdict;

use nalgebra::Matrix6;

pub(in crate::calibration) use crate::calibration::result::verdict::Finding;
pub use crate::calibration::result::verdict::{Checks, Grade, Verdict};

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::sensor::SensorId;
use crate::calibration::target::CalibrationTarget;
use crate::estimation::measured_board::{MeasuredBoard, RollingShutter};
use crate::estimation::view_motion::ViewMotion;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

/// A finished calibration of an instrument: one camera, or a rig of cameras. Never changed once
/// made: a new solve is a new calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Sortable by time; empty until one is assigned.
    pub id: String,
    /// The camera's name, or the rig's; `None` for a solve outside a daemon.
    pub camera: Option<String>,
    /// The session it came from; `None` outside a daemon.
    pub session: Option<String>,
    /// UTC, nanoseconds since the Unix epoch.
    pub created_at_ns: i64,
    /// The board or the scene; `None` where correspondences were given without one.
    pub target: Option<CalibrationTarget>,
    /// Its sensors, camera by camera in the rig's order, each camera's in the order of kinds.
    pub sensors: Vec<CalibratedSensor>,
    /// The relative poses of the sensors; empty for one sensor.
    pub extrinsics: Vec<Extrinsics>,
    /// How it performs on views that it was not fitted to.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
}

/// A sensor with its calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedSensor {
    /// Which.
    pub id: SensorId,
    /// What is known of it.
    pub result: SensorResult,
}

/// What is known about a sensor, depending on what it measures.
#[derive(Debug, Clone, PartialEq)]
pub enum SensorResult {
    /// Light: a color or infrared image.
    Image(ImageCalibration),
    /// Distance.
    Depth(DepthCalibration),
}

impl CalibratedSensor {
    /// A calibrated image sensor.
    pub fn image(id: SensorId, sensor: ImageCalibration) -> Self {
        Self { id, result: SensorResult::Image(sensor) }
    }

    /// A calibrated depth sensor of an instrument's camera.
    pub fn depth(camera: Option<&str>, depth: DepthCalibration) -> Self {
        let id = SensorId { camera: camera.map(str::to_owned), kind: SensorKind::Depth };
        Self { id, result: SensorResult::Depth(depth) }
    }

    /// Its calibration, if it is an image sensor.
    pub fn as_image(&self) -> Option<&ImageCalibration> {
        match &self.result {
            SensorResult::Image(sensor) => Some(sensor),
            SensorResult::Depth(_) => None,
        }
    }

    /// Its calibration, if it is a depth sensor.
    pub fn as_depth(&self) -> Option<&DepthCalibration> {
        match &self.result {
            SensorResult::Image(_) => None,
            SensorResult::Depth(depth) => Some(depth),
        }
    }
}

impl Calibration {
    /// One with neither name nor time, and no extrinsics.
    pub fn unnamed(
        target: Option<impl Into<CalibrationTarget>>,
        sensors: Vec<CalibratedSensor>,
        checks: Checks,
        verdict: Verdict,
    ) -> Self {
        Self {
            id: String::new(),
            camera: None,
            session: None,
            created_at_ns: 0,
            target: target.map(Into::into),
            sensors,
            extrinsics: Vec::new(),
            checks,
            verdict,
        }
    }

    /// The sensor `id`.
    pub fn sensor(&self, id: &SensorId) -> Option<&CalibratedSensor> {
        self.sensors.iter().find(|sensor| sensor.id == *id)
    }

    /// Its image sensors, in order.
    pub fn image_sensors(&self) -> impl Iterator<Item = (&SensorId, &ImageCalibration)> {
        self.sensors.iter().filter_map(|sensor| Some((&sensor.id, sensor.as_image()?)))
    }

    /// The image sensor of this kind of an instrument that is one camera.
    pub fn image(&self, kind: SensorKind) -> Option<&ImageCalibration> {
        self.sensor(&SensorId::own(kind))?.as_image()
    }

    /// The image sensor `id`, to change.
    pub fn image_mut(&mut self, id: &SensorId) -> Option<&mut ImageCalibration> {
        match &mut self.sensors.iter_mut().find(|sensor| sensor.id == *id)?.result {
            SensorResult::Image(sensor) => Some(sensor),
            SensorResult::Depth(_) => None,
        }
    }

    /// The color sensor of an instrument that is one camera.
    pub fn color(&self) -> Option<&ImageCalibration> {
        self.image(SensorKind::Color)
    }

    /// The depth sensor of an instrument that is one camera.
    pub fn depth(&self) -> Option<&DepthCalibration> {
        self.sensor(&SensorId::own(SensorKind::Depth))?.as_depth()
    }

    /// The image sensor that boards are detected in, for an instrument that is one camera: color if
    /// there is one.
    pub fn guide(&self) -> Option<&ImageCalibration> {
        let own = |(id, sensor): (_, _)| -> Option<&ImageCalibration> {
            let id: &SensorId = id;
            id.camera.is_none().then_some(sensor)
        };
        self.image_sensors().find_map(own)
    }

    /// Adds a sensor at its place in the order.
    pub fn add_sensor(&mut self, sensor: CalibratedSensor) {
        let before = |other: &CalibratedSensor| {
            other.id.camera != sensor.id.camera || other.id.kind < sensor.id.kind
        };
        let at = self.sensors.iter().position(|other| !before(other));
        self.sensors.insert(at.unwrap_or(self.sensors.len()), sensor);
    }

    /// The pose of `source` in the frame of `target`, if it is stated.
    pub fn pose(&self, target: &SensorId, source: &SensorId) -> Option<&Extrinsics> {
        self.extrinsics.iter().find(|known| known.target == *target && known.source == *source)
    }

    /// The pose of `source` in the frame of `target`: as stated, inverted, or through a third
    /// sensor.
    pub fn relative_pose(&self, target: &SensorId, source: &SensorId) -> Option<Pose> {
        let step = |a: &SensorId, b: &SensorId| {
            if a == b {
                return Some(Pose::identity());
            }
            let stated = self.pose(a, b).map(|known| known.target_from_source);
            stated.or_else(|| Some(self.pose(b, a)?.target_from_source.inverse()))
        };
        let by_way = |via: &CalibratedSensor| Some(step(target, &via.id)? * step(&via.id, source)?);
        step(target, source).or_else(|| self.sensors.iter().find_map(by_way))
    }

    /// The sensor's name in documents: its kind; in a rig its camera, with the kind where cameras
    /// have several sensors (`left.infrared`).
    pub fn name_of(&self, id: &SensorId) -> String {
        match &id.camera {
            None => id.kind.name().to_owned(),
            Some(camera) if self.has_one_sensor_each() => camera.clone(),
            Some(camera) => format!("{camera}.{}", id.kind.name()),
        }
    }

    /// Whether no camera has two sensors.
    pub fn has_one_sensor_each(&self) -> bool {
        let alone = |sensor: &CalibratedSensor| {
            self.sensors.iter().filter(|other| other.id.camera == sensor.id.camera).count() == 1
        };
        self.sensors.iter().all(alone)
    }
}

/// One image sensor: its lens and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageCalibration {
    /// The size of the images it holds for.
    pub image_size: ImageSize,
    /// The lens.
    pub lens: Lens,
    /// Standard deviation of each lens parameter, in the order of [`Lens::parameter_names`]; 0 for
    /// a fixed one.
    pub lens_std: Vec<f64>,
    /// Covariance of the lens parameters, row by row in the same order; empty where it is not
    /// known.
    pub lens_covariance: Vec<Vec<f64>>,
    /// Root mean square over the used corners of the 2-D reprojection error, in pixels.
    pub rms_px: f64,
    /// Predicted 1-σ projection uncertainty over the image.
    pub uncertainty_px: ProjectionUncertainty,
    /// Every view that was offered, in order.
    pub views: Vec<CalibratedView>,
    /// Lens models that were compared, if the choice was left to the solve; empty otherwise.
    pub compared: Vec<ComparedLens>,
    /// How far the board was bowed at its middle along its x and its y, in meters, where that was
    /// estimated.
    pub board_warp_m: Option<[f64; 2]>,
    /// The board's shape as this sensor's views show it.
    pub board_shape: Option<MeasuredBoard>,
    /// Motion while the rows of its images were read, where the views show it.
    pub rolling_shutter: Option<RollingShutter>,
    /// The support from a scene, if there was no target.
    pub scene: Option<SceneSupport>,
}

/// How a scene supports a lens.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSupport {
    /// How many scene points were used.
    pub points: usize,
    /// Lens parameters whose prior is at least as certain as the images' own estimate.
    pub held_by_prior: Vec<String>,
    /// The uncertainty of the scale, if depth gives it; without it lengths have no unit.
    pub scale: Option<SceneScale>,
}

/// How well measured depth determines the scale of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneScale {
    /// The relative standard deviation of a length.
    pub relative_std: f64,
    /// The number of measured depths of scene points.
    pub readings: usize,
    /// In how many images.
    pub views: usize,
}

/// Predicted 1-σ uncertainty of a projected pixel, after the best compensating camera motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ProjectionUncertainty {
    /// At the image's center.
    pub center: f64,
    /// The median over the image.
    pub median: f64,
    /// The worst of the image.
    pub worst: f64,
}

/// One view of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedView {
    /// Its path or sequence number.
    pub name: String,
    /// Whether it was used in the estimate.
    pub used: bool,
    /// Why not.
    pub reason: Option<String>,
    /// Its own reprojection error; `None` for a view without a pose.
    pub rms_px: Option<f64>,
    /// The board's pose; `None` for a view without a pose.
    pub camera_from_board: Option<Pose>,
    /// How the board moved while the view's rows were read; `None` without a rolling shutter.
    pub motion: Option<ViewMotion>,
    /// The scene's pose, without a board; the first used view is the identity.
    pub camera_from_scene: Option<Pose>,
}

/// The pose of one sensor relative to another.
#[derive(Debug, Clone, PartialEq)]
pub struct Extrinsics {
    /// The sensor whose frame it leads to.
    pub target: SensorId,
    /// The sensor whose frame it leads from.
    pub source: SensorId,
    /// The pose of the source in the target's frame.
    pub target_from_source: Pose,
    /// Standard deviation of the rotation about each axis, in radians.
    pub rotation_std: [f64; 3],
    /// Standard deviation of the translation, in meters.
    pub translation_std_m: [f64; 3],
}

/// Standard deviations of a pose, axis by axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseStd {
    /// Of the rotation about each axis, in radians.
    pub rotation: [f64; 3],
    /// Of the translation along each, in meters.
    pub translation_m: [f64; 3],
}

impl PoseStd {
    /// From the covariance of a step (rotation in radians, then translation in meters).
    pub fn of(covariance: &Matrix6<f64>) -> Self {
        let std = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        Self { rotation: [0, 1, 2].map(std), translation_m: [3, 4, 5].map(std) }
    }
}

/// One lens model of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparedLens {
    /// The model's name.
    pub model: crate::geometry::lens::LensModel,
    /// Error on held-out views.
    pub held_out_rms_px: f64,
}
