//! The calibration document of a camera calibrated without a target.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::scene::{SceneCalibration, SceneView};
use crate::document::image_sensor::UncertaintyDocument;
use crate::document::lens::{LensDocument, LensStdDocument};
use crate::document::pose::PoseDocument;
use crate::document::scene_scale::{METERS, SceneScaleDocument};
use crate::document::verdict::{ChecksDocument, VerdictDocument};

/// A finished calibration without a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneCalibrationDocument {
    /// Sortable by time.
    pub id: String,
    /// The camera's name; null outside a daemon.
    pub camera: Option<String>,
    /// The session it came from; null outside a daemon.
    pub session: Option<String>,
    /// When it was solved.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: jiff::Timestamp,
    /// `{"kind": "scene"}`.
    pub target: SceneTargetDocument,
    /// The unit of lengths: `m` where depth gives it, else null: images do not determine it, and
    /// the greatest distance between two used cameras is 1.
    pub scene_unit: Option<String>,
    /// How well the unit is known, where depth gives it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_scale: Option<SceneScaleDocument>,
    /// The sensor, under `color`.
    pub sensors: SceneSensorsDocument,
    /// Always empty: one sensor.
    #[serde(default)]
    pub extrinsics: Vec<PoseDocument>,
    /// How much was used.
    pub checks: ChecksDocument,
    /// How far to trust it.
    pub verdict: VerdictDocument,
    /// What it took, in milliseconds, without reading the images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elapsed_ms: Option<f64>,
}

/// The target of a calibration without one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SceneTargetDocument {
    /// `scene`.
    pub kind: String,
}

/// The sensors of a calibration without a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneSensorsDocument {
    /// The one sensor.
    pub color: SceneSensorDocument,
}

/// A sensor calibrated without a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneSensorDocument {
    /// Width and height of the images it holds for, in pixels.
    pub image_size: [u32; 2],
    /// The lens.
    pub lens: LensDocument,
    /// Standard deviation of each lens parameter.
    pub lens_std: LensStdDocument,
    /// Covariance of the lens parameters, row by row in the order fx, fy, cx, cy, skew and the
    /// model's coefficients.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lens_covariance: Vec<Vec<f64>>,
    /// Parameters that the images say no more of than the prior: center ± 2 % of the width, square
    /// pixels ± 0.2 %, radial coefficients ± 0.2, tangential ones ± 0.0003.
    pub held_by_prior: Vec<String>,
    /// Root mean square of the used observations' reprojection errors, in pixels.
    pub rms_px: f64,
    /// Predicted 1-σ reprojection uncertainty over the image.
    pub uncertainty_px: UncertaintyDocument,
    /// Each image that was given, in order.
    pub views: Vec<SceneViewDocument>,
    /// How many scene points there are.
    pub points: usize,
}

/// One image of a calibration without a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneViewDocument {
    /// Its path or sequence number.
    pub name: String,
    /// Whether it was used in the estimate.
    pub used: bool,
    /// Why not.
    pub reason: Option<String>,
    /// Its own reprojection error, in pixels; null for a view without a pose.
    pub rms_px: Option<f64>,
    /// Where the scene was; null for a view without a pose. The first used view is the identity.
    pub camera_from_scene: Option<PoseDocument>,
}

impl SceneCalibrationDocument {
    /// Of `calibration`, made at `created_at`.
    pub fn new(id: String, created_at: jiff::Timestamp, calibration: &SceneCalibration) -> Self {
        let sensor = &calibration.sensor;
        let color = SceneSensorDocument {
            image_size: [sensor.image_size.width, sensor.image_size.height],
            lens: (&sensor.lens).into(),
            lens_std: LensStdDocument::new(sensor.lens.model(), &sensor.lens_std),
            lens_covariance: sensor.lens_covariance.clone(),
            held_by_prior: calibration.held_by_prior.iter().map(ToString::to_string).collect(),
            rms_px: sensor.rms_px,
            uncertainty_px: sensor.uncertainty_px.into(),
            views: calibration.views.iter().map(SceneViewDocument::from).collect(),
            points: calibration.points.len(),
        };
        Self {
            id,
            camera: None,
            session: None,
            created_at,
            target: SceneTargetDocument { kind: "scene".to_owned() },
            scene_unit: calibration.scale.map(|_| METERS.to_owned()),
            scene_scale: calibration.scale.map(SceneScaleDocument::from),
            sensors: SceneSensorsDocument { color },
            extrinsics: Vec::new(),
            checks: calibration.checks.into(),
            verdict: (&calibration.verdict).into(),
            elapsed_ms: None,
        }
    }
}

impl From<&SceneView> for SceneViewDocument {
    fn from(view: &SceneView) -> Self {
        Self {
            name: view.name.clone(),
            used: view.camera_from_scene.is_some(),
            reason: view.reason.clone(),
            rms_px: view.rms_px,
            camera_from_scene: view.camera_from_scene.as_ref().map(PoseDocument::from),
        }
    }
}
