//! The calibration document.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::result::{
    Calibration, Extrinsics, ImageCalibration, SceneScale, SensorResult,
};
use crate::calibration::sensor::SensorId;
use crate::calibration::target::CalibrationTarget;
use crate::document::error::DocumentError;
use crate::document::pose::{PoseDocument, RotationDocument};
use crate::document::reading::null_is_a_value;
use crate::document::scene_scale::{METERS, SceneScaleDocument};
use crate::document::sensors::SensorsDocument;
use crate::document::target::TargetDocument;
use crate::document::time;
use crate::document::verdict::{ChecksDocument, VerdictDocument};
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

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
    /// The board or the scene; null where correspondences were given without one.
    pub target: Option<TargetDocument>,
    /// Unit of length, only in a calibration without a board: `m` where depth determines the scale.
    /// Otherwise null: images alone do not determine it, and lengths are such that the greatest
    /// distance between two used cameras is 1.
    #[schema(value_type = Option<String>)]
    #[serde(
        default,
        deserialize_with = "null_is_a_value",
        skip_serializing_if = "Option::is_none"
    )]
    pub scene_unit: Option<Option<String>>,
    /// How well the unit is known, where depth gives it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_scale: Option<SceneScaleDocument>,
    /// Each calibrated sensor. A camera with one sensor has it under `color`, gray or not.
    pub sensors: SensorsDocument,
    /// The cameras of a rig, in its order; left out for one camera.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<RigCameraDocument>,
    /// Where the sensors are relative to each other; empty for one sensor.
    #[serde(default)]
    pub extrinsics: Vec<ExtrinsicsDocument>,
    /// Checks on data that was not fitted.
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

/// A camera of a rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RigCameraDocument {
    /// Its name, as in the extrinsics' `left_from_right`.
    pub name: String,
    /// Its calibrated sensors.
    pub sensors: SensorsDocument,
}

/// Where one sensor is relative to another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExtrinsicsDocument {
    /// What it maps, as in `color_from_depth`; between the cameras of a rig, as in
    /// `left_from_right`, or `left.color_from_right.depth` where a camera has several sensors.
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
        let mut cameras: Vec<&str> = Vec::new();
        for camera in calibration.sensors.iter().filter_map(|sensor| sensor.id.camera.as_deref()) {
            if !cameras.contains(&camera) {
                cameras.push(camera);
            }
        }
        let camera = |name: &&str| RigCameraDocument {
            name: (*name).to_owned(),
            sensors: SensorsDocument::of(&calibration.sensors, Some(name)),
        };
        let extrinsics = |known: &Extrinsics| extrinsics_document(calibration, known);
        let scale = calibration.guide().and_then(|sensor| sensor.scene.as_ref()?.scale);
        Self {
            id: calibration.id.clone(),
            camera: calibration.camera.clone(),
            session: calibration.session.clone(),
            created_at: time::from_utc_ns(calibration.created_at_ns),
            target: calibration.target.map(TargetDocument::from),
            scene_unit: calibration
                .target
                .filter(CalibrationTarget::is_scene)
                .map(|_| scale.map(|_| METERS.to_owned())),
            scene_scale: scale.map(SceneScaleDocument::from),
            sensors: SensorsDocument::of(&calibration.sensors, None),
            cameras: cameras.iter().map(camera).collect(),
            extrinsics: calibration.extrinsics.iter().map(extrinsics).collect(),
            checks: calibration.checks.into(),
            verdict: (&calibration.verdict).into(),
            elapsed_ms: None,
        }
    }
}

impl TryFrom<&CalibrationDocument> for Calibration {
    type Error = DocumentError;
    fn try_from(document: &CalibrationDocument) -> Result<Self, DocumentError> {
        let mut sensors = document.sensors.to_sensors(None)?;
        for (i, camera) in document.cameras.iter().enumerate() {
            let own = camera.sensors.to_sensors(Some(&camera.name));
            sensors.extend(own.map_err(|e| e.inside(&format!("cameras[{i}]")))?);
        }
        let scale = document.scene_scale.as_ref().map(SceneScale::from);
        for sensor in &mut sensors {
            if let SensorResult::Image(ImageCalibration { scene: Some(scene), .. }) =
                &mut sensor.result
            {
                scene.scale = scale;
            }
        }
        let extrinsics = |(i, extrinsics): (usize, &ExtrinsicsDocument)| {
            extrinsics
                .to_extrinsics(&document.cameras)
                .map_err(|e| e.inside(&format!("extrinsics[{i}]")))
        };
        Ok(Self {
            id: document.id.clone(),
            camera: document.camera.clone(),
            session: document.session.clone(),
            created_at_ns: time::utc_ns(document.created_at),
            target: document
                .target
                .as_ref()
                .map(CalibrationTarget::try_from)
                .transpose()
                .map_err(|e| e.inside("target"))?,
            sensors,
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

fn extrinsics_document(calibration: &Calibration, known: &Extrinsics) -> ExtrinsicsDocument {
    let PoseDocument { rotation, translation } = (&known.target_from_source).into();
    let [target, source] = [&known.target, &known.source].map(|id| calibration.name_of(id));
    ExtrinsicsDocument {
        name: format!("{target}_from_{source}"),
        rotation,
        translation,
        rotation_std: known.rotation_std,
        translation_std: known.translation_std_m,
    }
}

impl ExtrinsicsDocument {
    /// A pose that is known exactly.
    pub fn exact(name: &str, target_from_source: &Pose) -> Self {
        let PoseDocument { rotation, translation } = target_from_source.into();
        let none = [0.0; 3];
        let name = name.to_owned();
        Self { name, rotation, translation, rotation_std: none, translation_std: none }
    }

    fn to_extrinsics(&self, cameras: &[RigCameraDocument]) -> Result<Extrinsics, DocumentError> {
        let unknown = || {
            let problem = format!("`{}` is not TARGET_from_SOURCE of two sensors", self.name);
            DocumentError::field("name", problem)
        };
        // A camera's name may have `_from_` in it.
        let (target, source) = self
            .name
            .match_indices(BETWEEN)
            .find_map(|(at, _)| {
                let source = &self.name[at + BETWEEN.len()..];
                Some((sensor_named(&self.name[..at], cameras)?, sensor_named(source, cameras)?))
            })
            .ok_or_else(unknown)?;
        let pose = PoseDocument { rotation: self.rotation, translation: self.translation };
        Ok(Extrinsics {
            target,
            source,
            target_from_source: Pose::try_from(&pose)?,
            rotation_std: self.rotation_std,
            translation_std_m: self.translation_std,
        })
    }
}

/// What stands between the names of two sensors.
const BETWEEN: &str = "_from_";

/// The sensor that goes by `name` in a calibration of one camera, or of a rig of `cameras`.
fn sensor_named(name: &str, cameras: &[RigCameraDocument]) -> Option<SensorId> {
    if cameras.is_empty() {
        return SensorKind::from_name(name).map(SensorId::own);
    }
    if let Some(camera) = cameras.iter().find(|camera| camera.name == name) {
        let kind = camera.sensors.by_kind.keys().next().copied();
        return Some(SensorId::of(name, kind.unwrap_or(SensorKind::Color)));
    }
    let (camera, kind) = name.rsplit_once('.')?;
    cameras.iter().find(|known| known.name == camera)?;
    SensorKind::from_name(kind).map(|kind| SensorId::of(camera, kind))
}

#[cfg(test)]
pub(crate) mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::calibration::result::{
        CalibratedSensor, CalibratedView, Checks, ComparedLens, Grade, ImageCalibration,
        ProjectionUncertainty, SceneScale, SceneSupport, Verdict,
    };
    use crate::document::image_sensor::SensorDocument;
    use crate::document::reading::{from_json, to_json, to_json_pretty};
    use crate::document::sensors::AnySensorDocument;
    use crate::estimation::view_motion::ViewMotion;
    use crate::geometry::lens::{Lens, LensModel};
    use crate::geometry::pixel::ImageSize;
    use crate::geometry::target::chessboard;

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
            motion: used.then_some(ViewMotion {
                rotation_rad: Vector3::new(0.001, -0.002, third),
                translation_m: Vector3::new(third / 100.0, 0.0, -0.001),
                center_m: Point3::new(0.12, 0.075, 0.0),
            }),
            camera_from_scene: None,
        };
        let lens = Lens::from_parameters(
            LensModel::Brown,
            &[532.8 + third, 531.0, 319.5, 239.5, 0.0, -0.3, 0.1 * third, 1e-5, -2e-5, 0.0],
        );
        let sensor = ImageCalibration {
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
            board_shape: None,
            rolling_shutter: None,
            scene: None,
        };
        Calibration {
            id: "01KAJ0000000000000000000000".into(),
            camera: Some("front".into()),
            session: None,
            created_at_ns: 1_770_000_000_123_456_789,
            target: Some(chessboard(9, 6, 0.03).unwrap().into()),
            sensors: vec![CalibratedSensor::image(SensorId::own(SensorKind::Color), sensor)],
            extrinsics: vec![Extrinsics {
                target: SensorId::own(SensorKind::Color),
                source: SensorId::own(SensorKind::Infrared),
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

    /// The same with an infrared sensor too.
    pub(crate) fn with_infrared(
        mut calibration: Calibration,
        sensor: &ImageCalibration,
    ) -> Calibration {
        let id = SensorId::own(SensorKind::Infrared);
        calibration.add_sensor(CalibratedSensor::image(id, sensor.clone()));
        calibration
    }

    /// A rig of two cameras with color and infrared, with names that are easily confused.
    fn rig() -> Calibration {
        let ids = ["a_from_b", "b"].map(|camera| {
            [SensorKind::Color, SensorKind::Infrared].map(|kind| SensorId::of(camera, kind))
        });
        let sensor =
            |id: &SensorId| CalibratedSensor::image(id.clone(), example().color().unwrap().clone());
        let known = |source: &SensorId| Extrinsics {
            target: ids[0][0].clone(),
            source: source.clone(),
            ..example().extrinsics[0].clone()
        };
        let all = ids.as_flattened();
        Calibration {
            sensors: all.iter().map(sensor).collect(),
            extrinsics: all[1..].iter().map(known).collect(),
            ..example()
        }
    }

    #[test]
    fn extrinsics_name_the_sensors_of_a_rig() {
        let document = CalibrationDocument::from(&rig());
        let names: Vec<&str> = document.extrinsics.iter().map(|e| e.name.as_str()).collect();
        let of = |source: &str| format!("a_from_b.color_from_{source}");
        assert_eq!(names, [of("a_from_b.infrared"), of("b.color"), of("b.infrared")]);
        assert!(document.sensors.by_kind.is_empty() && document.cameras.len() == 2);
        let back: CalibrationDocument = from_json(to_json(&document).unwrap().as_bytes()).unwrap();
        assert_eq!(Calibration::try_from(&back), Ok(rig()));

        let mut one_each = rig();
        one_each.sensors.retain(|sensor| sensor.id.kind == SensorKind::Color);
        one_each.extrinsics.retain(|known| known.source.kind == SensorKind::Color);
        let document = CalibrationDocument::from(&one_each);
        assert_eq!(document.extrinsics[0].name, "a_from_b_from_b");
        assert_eq!(Calibration::try_from(&document), Ok(one_each));

        let mut wrong = CalibrationDocument::from(&rig());
        wrong.extrinsics[1].name = "a_from_b.color_from_c.color".into();
        let error = Calibration::try_from(&wrong).unwrap_err();
        assert_eq!(error.path(), Some("extrinsics[1].name"));
    }

    #[test]
    fn a_calibration_survives_to_the_bit() {
        for calibration in [example(), of_scene()] {
            let document = CalibrationDocument::from(&calibration);
            for json in [to_json(&document).unwrap(), to_json_pretty(&document).unwrap()] {
                let back: CalibrationDocument = from_json(json.as_bytes()).unwrap();
                assert_eq!(back, document);
                assert_eq!(Calibration::try_from(&back), Ok(calibration.clone()));
            }
        }
    }

    /// One without a board.
    fn of_scene() -> Calibration {
        let mut calibration = example();
        calibration.target = Some(CalibrationTarget::Scene);
        let color = calibration.image_mut(&SensorId::own(SensorKind::Color)).unwrap();
        color.scene = Some(SceneSupport {
            points: 900,
            held_by_prior: vec!["cx".into()],
            scale: Some(SceneScale { relative_std: 0.004, readings: 700, views: 11 }),
        });
        for view in &mut color.views {
            view.camera_from_scene = view.camera_from_board.take();
        }
        calibration
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
        assert_eq!(calibration.color().unwrap().lens.model(), LensModel::Brown);
    }

    #[test]
    fn errors_name_the_whole_path() {
        let mut document = CalibrationDocument::from(&example());
        let color = |document: &mut CalibrationDocument| match document
            .sensors
            .by_kind
            .remove(&SensorKind::Color)
        {
            Some(AnySensorDocument::Image(sensor)) => sensor,
            other => panic!("{other:?}"),
        };
        let mut sensor = color(&mut document);
        let mut put = |sensor: &SensorDocument| {
            let sensor = AnySensorDocument::Image(sensor.clone());
            document.sensors.by_kind.insert(SensorKind::Color, sensor);
            Calibration::try_from(&document).unwrap_err()
        };
        sensor.views[0].camera_from_board.as_mut().unwrap().rotation.w = 2.0;
        let error = put(&sensor);
        assert_eq!(error.path(), Some("sensors.color.views[0].camera_from_board.rotation"));
        sensor.lens_covariance.pop();
        let error = put(&sensor);
        assert_eq!(error.path(), Some("sensors.color.lens_covariance"));
    }
}
