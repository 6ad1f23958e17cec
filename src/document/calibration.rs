//! The calibration document.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::calibration::{
    CalibratedView, Calibration, ComparedLens, Extrinsics, ProjectionUncertainty, RigCamera,
    SensorCalibration,
};
use crate::calibration::depth_calibration::DepthCalibration;
use crate::document::depth::DepthDocument;
use crate::document::error::DocumentError;
use crate::document::lens::{LensDocument, LensModelName, LensStdDocument};
use crate::document::pose::{PoseDocument, RotationDocument};
use crate::document::target::TargetDocument;
use crate::document::time;
use crate::document::verdict::{ChecksDocument, VerdictDocument};
use crate::geometry::board::Chessboard;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::decode::MAX_PIXELS;

/// A finished calibration of one camera, or of a rig of cameras.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CalibrationDocument {
    /// Sortable by time.
    pub id: String,
    /// The camera's name, or the rig's; null outside a daemon.
    pub camera: Option<String>,
    /// The session it came from; null outside a daemon.
    pub session: Option<String>,
    /// When it was solved.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: jiff::Timestamp,
    /// The board; null where correspondences were given without one.
    pub target: Option<TargetDocument>,
    /// Each calibrated sensor. A camera with one sensor has it under `color`, gray or not.
    pub sensors: SensorsDocument,
    /// The cameras of a rig, in its order; left out for one camera.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<RigCameraDocument>,
    /// Where the sensors are relative to each other; empty for one sensor.
    #[serde(default)]
    pub extrinsics: Vec<ExtrinsicsDocument>,
    /// How it does beyond the views it was fitted to.
    pub checks: ChecksDocument,
    /// How far to trust it.
    pub verdict: VerdictDocument,
    /// What the solve and its uncertainty took, in milliseconds; only in the answer to a solve.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elapsed_ms: Option<f64>,
}

/// Every calibration of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CalibrationsDocument {
    /// Newest first.
    pub calibrations: Vec<CalibrationDocument>,
}

/// The sensors of a calibration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct SensorsDocument {
    /// The visible picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<SensorDocument>,
    /// The infrared picture; of a stereo depth camera the left one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub infrared: Option<SensorDocument>,
    /// The right infrared picture of a stereo depth camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub infrared2: Option<SensorDocument>,
    /// Distance per pixel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<DepthDocument>,
}

/// A camera of a rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RigCameraDocument {
    /// Its name, as in the extrinsics' `left_from_right`.
    pub name: String,
    /// Its calibrated sensors.
    pub sensors: SensorsDocument,
}

/// One picture sensor.
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
    /// Predicted 1-σ reprojection uncertainty over the image.
    pub uncertainty_px: UncertaintyDocument,
    /// The lens models that were compared, where the choice was left to the solve.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub compared: Vec<ComparedLensDocument>,
    /// How far the board was bowed at its middle along its x and its y, in meters, away from the
    /// side that is seen; only where that was to be estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board_warp_m: Option<[f64; 2]>,
    /// Each picture or frame that was offered, in order.
    pub views: Vec<ViewDocument>,
}

/// Predicted 1-σ uncertainty of a projected pixel, after the best compensating camera motion, in
/// pixels; null where the views leave it without bound.
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
    /// Error on views that were not fitted to, in pixels.
    pub held_out_rms_px: f64,
}

/// One view of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ViewDocument {
    /// Its path or sequence number.
    pub name: String,
    /// Whether it took part in the estimate.
    pub used: bool,
    /// Why not.
    pub reason: Option<String>,
    /// Its own reprojection error, in pixels; null for a view without a pose.
    pub rms_px: Option<f64>,
    /// Where the board was; null for a view without a pose.
    pub camera_from_board: Option<PoseDocument>,
}

/// Where one sensor is relative to another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExtrinsicsDocument {
    /// What it maps, as in `color_from_depth`; between the cameras of a rig, as in
    /// `left_from_right`.
    pub name: String,
    /// The rotation.
    pub rotation: RotationDocument,
    /// The translation, in meters.
    pub translation: [f64; 3],
    /// Standard deviation of the rotation about each axis, in radians.
    pub rotation_std: [f64; 3],
    /// Standard deviation of the translation, in meters.
    pub translation_std: [f64; 3],
}

impl From<&Calibration> for CalibrationDocument {
    fn from(calibration: &Calibration) -> Self {
        Self {
            id: calibration.id.clone(),
            camera: calibration.camera.clone(),
            session: calibration.session.clone(),
            created_at: time::from_utc_ns(calibration.created_at_ns),
            target: calibration.target.map(TargetDocument::from),
            sensors: SensorsDocument {
                color: calibration.color.as_ref().map(SensorDocument::from),
                infrared: calibration.infrared.as_ref().map(SensorDocument::from),
                infrared2: calibration.infrared2.as_ref().map(SensorDocument::from),
                depth: calibration.depth.as_ref().map(DepthDocument::from),
            },
            cameras: calibration.cameras.iter().map(RigCameraDocument::from).collect(),
            extrinsics: calibration.extrinsics.iter().map(ExtrinsicsDocument::from).collect(),
            checks: calibration.checks.into(),
            verdict: (&calibration.verdict).into(),
            elapsed_ms: None,
        }
    }
}

impl TryFrom<&CalibrationDocument> for Calibration {
    type Error = DocumentError;
    fn try_from(document: &CalibrationDocument) -> Result<Self, DocumentError> {
        let sensor = |sensor: &Option<SensorDocument>, name: &str| {
            let sensor = sensor.as_ref().map(SensorCalibration::try_from).transpose();
            sensor.map_err(|e| e.inside(&format!("sensors.{name}")))
        };
        let extrinsics = |(i, extrinsics): (usize, &ExtrinsicsDocument)| {
            Extrinsics::try_from(extrinsics).map_err(|e| e.inside(&format!("extrinsics[{i}]")))
        };
        let depth = document.sensors.depth.as_ref().map(DepthCalibration::try_from);
        let camera = |(i, camera): (usize, &RigCameraDocument)| {
            RigCamera::try_from(camera).map_err(|e| e.inside(&format!("cameras[{i}]")))
        };
        Ok(Self {
            id: document.id.clone(),
            camera: document.camera.clone(),
            session: document.session.clone(),
            created_at_ns: time::utc_ns(document.created_at),
            target: document
                .target
                .map(Chessboard::try_from)
                .transpose()
                .map_err(|e| e.inside("target"))?,
            color: sensor(&document.sensors.color, "color")?,
            infrared: sensor(&document.sensors.infrared, "infrared")?,
            infrared2: sensor(&document.sensors.infrared2, "infrared2")?,
            depth: depth.transpose().map_err(|e| e.inside("sensors.depth"))?,
            cameras: document.cameras.iter().enumerate().map(camera).collect::<Result<_, _>>()?,
            extrinsics: document
                .extrinsics
                .iter()
                .enumerate()
                .map(extrinsics)
                .collect::<Result<_, _>>()?,
            checks: document.checks.into(),
            verdict: (&document.verdict).into(),
        })
    }
}

impl From<&RigCamera> for RigCameraDocument {
    fn from(camera: &RigCamera) -> Self {
        let sensors =
            SensorsDocument { color: Some((&camera.sensor).into()), ..SensorsDocument::default() };
        Self { name: camera.name.clone(), sensors }
    }
}

impl TryFrom<&RigCameraDocument> for RigCamera {
    type Error = DocumentError;
    fn try_from(document: &RigCameraDocument) -> Result<Self, DocumentError> {
        let missing = || DocumentError::field("sensors.color", "is missing");
        let sensor =
            SensorCalibration::try_from(document.sensors.color.as_ref().ok_or_else(missing)?);
        Ok(Self {
            name: document.name.clone(),
            sensor: sensor.map_err(|e| e.inside("sensors.color"))?,
        })
    }
}

impl From<&SensorCalibration> for SensorDocument {
    fn from(sensor: &SensorCalibration) -> Self {
        Self {
            image_size: [sensor.image_size.width, sensor.image_size.height],
            lens: (&sensor.lens).into(),
            lens_std: LensStdDocument::new(sensor.lens.model(), &sensor.lens_std),
            lens_covariance: sensor.lens_covariance.clone(),
            rms_px: sensor.rms_px,
            uncertainty_px: sensor.uncertainty_px.into(),
            compared: sensor.compared.iter().map(ComparedLensDocument::from).collect(),
            board_warp_m: sensor.board_warp_m,
            views: sensor.views.iter().map(ViewDocument::from).collect(),
        }
    }
}

impl TryFrom<&SensorDocument> for SensorCalibration {
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
            rms_px: document.rms_px,
            uncertainty_px: document.uncertainty_px.into(),
            views: document.views.iter().enumerate().map(view).collect::<Result<_, _>>()?,
            compared: document.compared.iter().map(ComparedLens::from).collect(),
            board_warp_m: document.board_warp_m,
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
/// [`DocumentError::Field`] unless each side is 1 to 65,535 pixels, and all no more than a picture
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
        Self { model: compared.model.into(), held_out_rms_px: compared.held_out_rms_px }
    }
}

impl From<&ComparedLensDocument> for ComparedLens {
    fn from(document: &ComparedLensDocument) -> Self {
        Self { model: LensModel::from(document.model), held_out_rms_px: document.held_out_rms_px }
    }
}

impl From<&CalibratedView> for ViewDocument {
    fn from(view: &CalibratedView) -> Self {
        Self {
            name: view.name.clone(),
            used: view.used,
            reason: view.reason.clone(),
            rms_px: view.rms_px,
            camera_from_board: view.camera_from_board.as_ref().map(PoseDocument::from),
        }
    }
}

impl TryFrom<&ViewDocument> for CalibratedView {
    type Error = DocumentError;
    fn try_from(document: &ViewDocument) -> Result<Self, DocumentError> {
        let camera_from_board = document.camera_from_board.as_ref().map(Pose::try_from).transpose();
        Ok(Self {
            name: document.name.clone(),
            used: document.used,
            reason: document.reason.clone(),
            rms_px: document.rms_px,
            camera_from_board: camera_from_board.map_err(|e| e.inside("camera_from_board"))?,
        })
    }
}

impl From<&Extrinsics> for ExtrinsicsDocument {
    fn from(extrinsics: &Extrinsics) -> Self {
        let PoseDocument { rotation, translation } = (&extrinsics.target_from_source).into();
        Self {
            name: extrinsics.name.clone(),
            rotation,
            translation,
            rotation_std: extrinsics.rotation_std,
            translation_std: extrinsics.translation_std_m,
        }
    }
}

impl TryFrom<&ExtrinsicsDocument> for Extrinsics {
    type Error = DocumentError;
    fn try_from(document: &ExtrinsicsDocument) -> Result<Self, DocumentError> {
        let target_from_source = Pose::try_from(&PoseDocument {
            rotation: document.rotation,
            translation: document.translation,
        })?;
        Ok(Self {
            name: document.name.clone(),
            target_from_source,
            rotation_std: document.rotation_std,
            translation_std_m: document.translation_std,
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::calibration::calibration::{Checks, Grade, Verdict};
    use crate::document::reading::{from_json, to_json, to_json_pretty};
    use crate::geometry::board::BoardSize;

    /// A calibration with every field filled in.
    pub(crate) fn example() -> Calibration {
        let third = 1.0 / 3.0;
        let target_from_source =
            Pose::from_axis_angle(Vector3::new(0.1, 0.2, -third), Vector3::new(0.0, -0.1, third));
        let view = |name: &str, used| CalibratedView {
            name: name.into(),
            used,
            reason: (!used).then(|| "mirrored".to_owned()),
            rms_px: used.then_some(third / 10.0),
            camera_from_board: used.then_some(target_from_source),
        };
        let lens = Lens::from_parameters(
            LensModel::Brown,
            &[532.8 + third, 531.0, 319.5, 239.5, 0.0, -0.3, 0.1 * third, 1e-5, -2e-5, 0.0],
        );
        let sensor = SensorCalibration {
            image_size: ImageSize::new(640, 480),
            lens: lens.unwrap(),
            lens_std: vec![0.1, 0.1, 0.2, 0.2, 0.0, 0.01, 0.02, 1e-6, 1e-6, 0.0],
            lens_covariance: (0..10)
                .map(|i| (0..10).map(|j| third.powi(1 + i + j)).collect())
                .collect(),
            rms_px: third,
            uncertainty_px: ProjectionUncertainty { center: 0.01, median: 0.02, worst: 0.1 },
            views: vec![view("left01.jpg", true), view("left02.jpg", false)],
            compared: vec![ComparedLens { model: LensModel::Brown, held_out_rms_px: 0.2 }],
            board_warp_m: Some([0.001, -0.0005]),
        };
        Calibration {
            id: "01KAJ0000000000000000000000".into(),
            camera: Some("front".into()),
            session: None,
            created_at_ns: 1_770_000_000_123_456_789,
            target: Some(Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap()),
            color: Some(sensor),
            infrared: None,
            infrared2: None,
            depth: None,
            cameras: Vec::new(),
            extrinsics: vec![Extrinsics {
                name: "color_from_infrared".into(),
                target_from_source,
                rotation_std: [1e-4; 3],
                translation_std_m: [1e-5; 3],
            }],
            checks: Checks {
                split_half_ratio: None,
                held_out_rms_px: Some(0.2),
                outlier_fraction: 0.01,
                coverage: 0.8,
            },
            verdict: Verdict {
                grade: Grade::Usable,
                reasons: vec!["no views in the lower left".into()],
            },
        }
    }

    #[test]
    fn a_calibration_survives_to_the_bit() {
        let calibration = example();
        let document = CalibrationDocument::from(&calibration);
        for json in [to_json(&document).unwrap(), to_json_pretty(&document).unwrap()] {
            let back: CalibrationDocument = from_json(json.as_bytes()).unwrap();
            assert_eq!(back, document);
            assert_eq!(Calibration::try_from(&back), Ok(calibration.clone()));
        }
    }

    #[test]
    fn the_contract_s_example_is_read() {
        let json = r#"{
          "id": "1", "camera": "front", "session": "2", "created_at": "2026-01-02T03:04:05.5Z",
          "target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025},
          "sensors": {"color": {
              "image_size": [640, 480],
              "lens": {"model": "brown", "fx": 1, "fy": 1, "cx": 0, "cy": 0, "skew": 0, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0},
              "lens_std": {"fx": 0, "fy": 0, "cx": 0, "cy": 0, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0},
              "rms_px": 0.0,
              "uncertainty_px": {"center": 0.0, "median": 0.0, "worst": 0.0},
              "views": [{"name": "0", "used": true, "reason": null, "rms_px": 0.0,
                         "camera_from_board": {"rotation": {"w":1,"x":0,"y":0,"z":0}, "translation": [0,0,0]}}]}},
          "extrinsics": [],
          "checks": {"split_half_ratio": 0.0, "held_out_rms_px": 0.0, "outlier_fraction": 0.0, "coverage": 0.0},
          "verdict": {"grade": "good", "reasons": []}}"#;
        let calibration =
            Calibration::try_from(&from_json::<CalibrationDocument>(json.as_bytes()).unwrap())
                .unwrap();
        assert_eq!(calibration.created_at_ns, 1_767_323_045_500_000_000);
        assert_eq!(calibration.color.unwrap().lens.model(), LensModel::Brown);
    }

    #[test]
    fn errors_name_the_whole_path() {
        let mut document = CalibrationDocument::from(&example());
        let sensor = document.sensors.color.as_mut().unwrap();
        sensor.views[0].camera_from_board.as_mut().unwrap().rotation.w = 2.0;
        let error = Calibration::try_from(&document).unwrap_err();
        assert_eq!(error.path(), Some("sensors.color.views[0].camera_from_board.rotation"));
        document.sensors.color.as_mut().unwrap().lens_covariance.pop();
        let error = Calibration::try_from(&document).unwrap_err();
        assert_eq!(error.path(), Some("sensors.color.lens_covariance"));
    }
}
