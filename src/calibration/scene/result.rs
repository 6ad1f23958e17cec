//! The result of a calibration without a target.

use nalgebra::Point3;

use crate::calibration::result::{
    CalibratedSensor, CalibratedView, Calibration, Checks, ImageCalibration, ProjectionUncertainty,
    SceneScale, SceneSupport, Verdict,
};
use crate::calibration::scene::conditions::SceneConditions;
use crate::calibration::sensor::SensorId;
use crate::calibration::target::CalibrationTarget;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

/// A lens from images of a static scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneCalibration {
    /// The lens with its uncertainty.
    pub sensor: SceneSensor,
    /// Each image that was given, in order.
    pub views: Vec<SceneView>,
    /// The scene.
    pub points: Vec<ScenePoint>,
    /// Outliers and coverage.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
    /// Parameters whose prior is at least as certain as the images' own estimate.
    pub held_by_prior: Vec<&'static str>,
    /// How the camera stood and moved.
    pub conditions: SceneConditions,
    /// How well the meter is known, where depth gives it; without it lengths have no unit.
    pub scale: Option<SceneScale>,
}

/// The lens and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSensor {
    /// The size of the images it holds for.
    pub image_size: ImageSize,
    /// The lens.
    pub lens: Lens,
    /// Standard deviation of each lens parameter, in the order of [`Lens::parameter_names`]; 0 for
    /// a fixed one.
    pub lens_std: Vec<f64>,
    /// Covariance of the lens parameters, row by row in the same order.
    pub lens_covariance: Vec<Vec<f64>>,
    /// Root mean square of the used observations' reprojection errors.
    pub rms_px: f64,
    /// Predicted 1-σ projection uncertainty over the image.
    pub uncertainty_px: ProjectionUncertainty,
}

/// One image.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneView {
    /// Its path or sequence number.
    pub name: String,
    /// Why it has no pose.
    pub reason: Option<String>,
    /// The root mean square length of its residuals, in pixels.
    pub rms_px: Option<f64>,
    /// Its pose; `None` for an image that was not used. The first used is the identity, and the
    /// greatest distance between two is 1 unless lengths are in meters.
    pub camera_from_scene: Option<Pose>,
}

/// A scene point.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePoint {
    /// In the scene's frame.
    pub point: Point3<f64>,
    /// (view, where it shows the point).
    pub seen: Vec<(usize, Pixel)>,
    /// The root mean square length of its residuals, in pixels.
    pub rms_px: f64,
}

impl SceneCalibration {
    /// The same in the form of every other calibration: without a name, and without the points.
    pub fn into_calibration(self) -> Calibration {
        let Self { sensor, views, points, checks, verdict, held_by_prior, scale, .. } = self;
        let held_by_prior = held_by_prior.into_iter().map(str::to_owned).collect();
        let image = ImageCalibration {
            image_size: sensor.image_size,
            lens: sensor.lens,
            lens_std: sensor.lens_std,
            lens_covariance: sensor.lens_covariance,
            rms_px: sensor.rms_px,
            uncertainty_px: sensor.uncertainty_px,
            views: views.into_iter().map(CalibratedView::from).collect(),
            compared: Vec::new(),
            board_warp_m: None,
            board_shape: None,
            rolling_shutter: None,
            scene: Some(SceneSupport { points: points.len(), held_by_prior, scale }),
        };
        let color = CalibratedSensor::image(SensorId::own(SensorKind::Color), image);
        Calibration::unnamed(Some(CalibrationTarget::Scene), vec![color], checks, verdict)
    }
}

impl From<SceneView> for CalibratedView {
    fn from(view: SceneView) -> Self {
        Self {
            name: view.name,
            used: view.camera_from_scene.is_some(),
            reason: view.reason,
            rms_px: view.rms_px,
            camera_from_board: None,
            motion: None,
            camera_from_scene: view.camera_from_scene,
        }
    }
}
