//! One image sensor of a calibration.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::result::{
    CalibratedView, ComparedLens, ImageCalibration, ProjectionUncertainty, SceneSupport,
};
use crate::document::board_shape::{BoardShapeDocument, RollingShutterDocument};
use crate::document::error::{DocumentError, physical};
use crate::document::lens::{LensDocument, LensStdDocument};
use crate::document::lens_model::LensModelName;
use crate::document::pose::PoseDocument;
use crate::document::reading::null_is_a_value;
use crate::document::view_motion::ViewMotionDocument;
use crate::estimation::view_motion::ViewMotion;
use crate::geometry::lens::Lens;
use crate::geometry::physical::RMS_PX;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::decode::MAX_PIXELS;

/// One image sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SensorDocument {
    /// Width and height of the images it holds for, in pixels.
    pub image_size: [u32; 2],
    /// The lens.
    pub lens: LensDocument,
    /// Standard deviation of each lens parameter.
    pub lens_std: LensStdDocument,
    /// Covariance of the lens parameters, row by row in the order fx, fy, cx, cy, skew and the
    /// model's coefficients; left out where it is not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lens_covariance: Vec<Vec<f64>>,
    /// Root mean square of the used corners' reprojection errors, in pixels.
    pub rms_px: f64,
    /// Predicted 1-σ projection uncertainty over the image.
    pub uncertainty_px: UncertaintyDocument,
    /// The lens models that were compared, where the choice was left to the solve.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub compared: Vec<ComparedLensDocument>,
    /// How far the board was bowed at its middle along its x and its y, in meters, away from the
    /// camera; only where it was to be estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board_warp_m: Option<[f64; 2]>,
    /// The measured shape of the board, where the views show that it differs from the stated one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board_shape: Option<BoardShapeDocument>,
    /// How the board moved while the rows of an image were read, where the views show it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rolling_shutter: Option<RollingShutterDocument>,
    /// How many scene points there are, without a board.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<usize>,
    /// Parameters that the images of a scene do not determine beyond the prior: principal point ± 2
    /// % of the width, square pixels ± 0.2 %, radial coefficients ± 0.2, tangential ones ± 0.0003.
    #[schema(value_type = Vec<String>)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_by_prior: Option<Vec<String>>,
    /// Each image or frame that was offered, in order.
    pub views: Vec<ViewDocument>,
}

/// Predicted 1-σ uncertainty of a projected pixel, after the best compensating camera motion, in
/// pixels; null where the views do not bound it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UncertaintyDocument {
    /// At the image's center.
    pub center: Option<f64>,
    /// The median over the image.
    pub median: Option<f64>,
    /// The worst of the image.
    pub worst: Option<f64>,
}

/// One lens model of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ComparedLensDocument {
    /// Which.
    pub model: LensModelName,
    /// Held-out (cross-validation) error, in pixels.
    pub held_out_rms_px: f64,
}

/// One view of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ViewDocument {
    /// Its path or sequence number.
    pub name: String,
    /// Whether it was used in the estimate.
    pub used: bool,
    /// Why not.
    pub reason: Option<String>,
    /// Its own reprojection error, in pixels; null for a view without a pose.
    pub rms_px: Option<f64>,
    /// Where the board was; null for a view without a pose.
    pub camera_from_board: Option<PoseDocument>,
    /// How the board moved while the view's rows were read; left out without a rolling shutter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<ViewMotionDocument>,
    /// Where the scene was, without a board only; null for a view without a pose. The first used
    /// view is the identity.
    #[schema(value_type = Option<PoseDocument>)]
    #[serde(
        default,
        deserialize_with = "null_is_a_value",
        skip_serializing_if = "Option::is_none"
    )]
    pub camera_from_scene: Option<Option<PoseDocument>>,
}

impl From<&ImageCalibration> for SensorDocument {
    fn from(sensor: &ImageCalibration) -> Self {
        Self {
            image_size: [sensor.image_size.width, sensor.image_size.height],
            lens: (&sensor.lens).into(),
            lens_std: LensStdDocument::new(sensor.lens.model(), &sensor.lens_std),
            lens_covariance: sensor.lens_covariance.clone(),
            rms_px: sensor.rms_px,
            uncertainty_px: sensor.uncertainty_px.into(),
            compared: sensor.compared.iter().map(ComparedLensDocument::from).collect(),
            board_warp_m: sensor.board_warp_m,
            board_shape: sensor.board_shape.as_ref().map(BoardShapeDocument::from),
            rolling_shutter: sensor.rolling_shutter.map(RollingShutterDocument::from),
            points: sensor.scene.as_ref().map(|scene| scene.points),
            held_by_prior: sensor.scene.as_ref().map(|scene| scene.held_by_prior.clone()),
            views: sensor
                .views
                .iter()
                .map(|view| view_document(view, sensor.scene.is_some()))
                .collect(),
        }
    }
}

impl TryFrom<&SensorDocument> for ImageCalibration {
    type Error = DocumentError;
    fn try_from(document: &SensorDocument) -> Result<Self, DocumentError> {
        let lens = Lens::try_from(&document.lens).map_err(|e| e.inside("lens"))?;
        let view = |(i, view): (usize, &ViewDocument)| {
            CalibratedView::try_from(view).map_err(|e| e.inside(&format!("views[{i}]")))
        };
        Ok(Self {
            image_size: image_size(document.image_size)?,
            lens_std: document
                .lens_std
                .to_values(lens.model())
                .map_err(|e| e.inside("lens_std"))?,
            lens_covariance: lens_covariance(&document.lens_covariance, lens.parameters().len())?,
            lens,
            rms_px: physical("rms_px", document.rms_px, &RMS_PX)?,
            uncertainty_px: document.uncertainty_px.into(),
            views: document.views.iter().enumerate().map(view).collect::<Result<_, _>>()?,
            compared: document.compared.iter().map(ComparedLens::from).collect(),
            board_warp_m: document.board_warp_m,
            board_shape: document.board_shape.as_ref().map(TryInto::try_into).transpose()?,
            rolling_shutter: document.rolling_shutter.map(Into::into),
            scene: document.points.map(|points| SceneSupport {
                points,
                held_by_prior: document.held_by_prior.clone().unwrap_or_default(),
                scale: None,
            }),
        })
    }
}

fn lens_covariance(rows: &[Vec<f64>], parameters: usize) -> Result<Vec<Vec<f64>>, DocumentError> {
    let square = rows.len() == parameters && rows.iter().all(|row| row.len() == parameters);
    if rows.is_empty() || square {
        return Ok(rows.to_vec());
    }
    let problem =
        format!("is not {parameters} rows of {parameters} numbers, one for each lens parameter");
    Err(DocumentError::field("lens_covariance", problem))
}

/// An image size from `image_size`.
///
/// # Errors
/// [`DocumentError::Field`] unless each side is 1 to 65,535 pixels, and all no more than an image
/// may have.
pub fn image_size([width, height]: [u32; 2]) -> Result<ImageSize, DocumentError> {
    let fits = |side: u32| (1..=u32::from(u16::MAX)).contains(&side);
    let wrong = || {
        format!(
            "{width}x{height} is not the size of an image: each side is 1 to 65535 pixels, all at most 120 megapixels"
        )
    };
    if fits(width) && fits(height) && u64::from(width) * u64::from(height) <= MAX_PIXELS {
        Ok(ImageSize::new(width, height))
    } else {
        Err(DocumentError::field("image_size", wrong()))
    }
}

impl From<ProjectionUncertainty> for UncertaintyDocument {
    fn from(uncertainty: ProjectionUncertainty) -> Self {
        let bounded = |uncertainty_px: f64| uncertainty_px.is_finite().then_some(uncertainty_px);
        Self {
            center: bounded(uncertainty.center),
            median: bounded(uncertainty.median),
            worst: bounded(uncertainty.worst),
        }
    }
}

impl From<UncertaintyDocument> for ProjectionUncertainty {
    fn from(document: UncertaintyDocument) -> Self {
        let unbounded = |uncertainty_px: Option<f64>| uncertainty_px.unwrap_or(f64::INFINITY);
        Self {
            center: unbounded(document.center),
            median: unbounded(document.median),
            worst: unbounded(document.worst),
        }
    }
}

impl From<&ComparedLens> for ComparedLensDocument {
    fn from(compared: &ComparedLens) -> Self {
        Self { model: LensModelName(compared.model), held_out_rms_px: compared.held_out_rms_px }
    }
}

impl From<&ComparedLensDocument> for ComparedLens {
    fn from(document: &ComparedLensDocument) -> Self {
        Self { model: document.model.0, held_out_rms_px: document.held_out_rms_px }
    }
}

/// `is_of_scene` where there is no board.
fn view_document(view: &CalibratedView, is_of_scene: bool) -> ViewDocument {
    let camera_from_scene = view.camera_from_scene.as_ref().map(PoseDocument::from);
    ViewDocument {
        name: view.name.clone(),
        used: view.used,
        reason: view.reason.clone(),
        rms_px: view.rms_px,
        camera_from_board: view.camera_from_board.as_ref().map(PoseDocument::from),
        motion: view.motion.as_ref().map(ViewMotionDocument::from),
        camera_from_scene: is_of_scene.then_some(camera_from_scene),
    }
}

impl TryFrom<&ViewDocument> for CalibratedView {
    type Error = DocumentError;
    fn try_from(document: &ViewDocument) -> Result<Self, DocumentError> {
        let camera_from_board = document.camera_from_board.as_ref().map(Pose::try_from).transpose();
        let camera_from_scene = document.camera_from_scene.as_ref().and_then(Option::as_ref);
        let camera_from_scene = camera_from_scene.map(Pose::try_from).transpose();
        let motion = document.motion.as_ref().map(ViewMotion::try_from).transpose();
        Ok(Self {
            name: document.name.clone(),
            used: document.used,
            reason: document.reason.clone(),
            rms_px: document.rms_px,
            camera_from_board: camera_from_board.map_err(|e| e.inside("camera_from_board"))?,
            motion: motion.map_err(|e| e.inside("motion"))?,
            camera_from_scene: camera_from_scene.map_err(|e| e.inside("camera_from_scene"))?,
        })
    }
}
