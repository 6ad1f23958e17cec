//! The result of a calibration without a target.

use nalgebra::Point3;

use crate::calibration::result::{Checks, ProjectionUncertainty, Verdict};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// A lens from images of a static scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneCalibration {
    /// The lens with its uncertainty.
    pub sensor: SceneSensor,
    /// Each image that was given, in order.
    pub views: Vec<SceneView>,
    /// The scene.
    pub points: Vec<ScenePoint>,
    /// Counts of what was used.
    pub checks: Checks,
    /// How far to trust it.
    pub verdict: Verdict,
    /// Parameters whose prior is at least as certain as the images' own estimate.
    pub held_by_prior: Vec<&'static str>,
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
    /// Predicted 1-σ reprojection uncertainty over the image.
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
    /// greatest distance between two is 1.
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
