//! The camera document.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::depth_encoding::DepthEncodingDocument;
use crate::document::lens::LensDocument;
use crate::document::pose::{PoseDocument, RotationDocument};
use crate::imaging::factory::{FactoryCalibration, FactorySensor};
use crate::imaging::frame::SensorKind;

/// What a camera is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CameraStateName {
    /// Being opened.
    Starting,
    /// Delivering frames.
    Streaming,
    /// Disconnected; it is being opened again.
    Lost,
    /// Unusable until a person does something.
    Failed,
}

/// A configured camera and what it is doing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraDocument {
    /// Its name in the configuration.
    pub name: String,
    /// What drives it: `v4l2`, `uvc`, `realsense`, `ros2`, `recording` or `simulator`.
    pub backend: String,
    /// What it is doing.
    pub state: CameraStateName,
    /// Why it is in this state, or why its current calibration may not hold; null when nothing is
    /// wrong.
    pub reason: Option<String>,
    /// Its sensors, by name; empty before the first frame.
    pub sensors: BTreeMap<String, CameraSensorDocument>,
    /// Frame sets a second, measured; null before there are two.
    pub fps: Option<f64>,
    /// Frame sets received since the start.
    pub frames: u64,
    /// Frame sets that were lost or skipped since the start.
    pub dropped_frames: u64,
    /// Which device it is.
    pub identity: CameraIdentityDocument,
    /// The factory calibration that the device reports; left out where it reports none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factory: Option<FactoryDocument>,
    /// The running session, if there is one.
    pub session: Option<String>,
    /// The current approved calibration, if there is one.
    pub calibration: Option<String>,
}

/// One sensor of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraSensorDocument {
    /// Width and height of its images, in pixels.
    pub image_size: [u32; 2],
    /// How its frames come.
    pub format: String,
}

/// Which device a camera is; null where the device does not say.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct CameraIdentityDocument {
    /// The device's own name.
    pub model: Option<String>,
    /// The device's serial number.
    pub serial: Option<String>,
    /// Where it is connected, or the file it comes from.
    pub bus: Option<String>,
}

/// The factory calibration that a device reports, in the format of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FactoryDocument {
    /// Its sensors, by name.
    pub sensors: BTreeMap<String, FactorySensorDocument>,
    /// Their poses relative to color.
    pub extrinsics: Vec<FactoryExtrinsicsDocument>,
    /// What the readings of its depth images mean; left out where nothing is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_encoding: Option<DepthEncodingDocument>,
}

/// What is stated of one sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FactorySensorDocument {
    /// The size that the lens is stated for.
    pub image_size: [u32; 2],
    /// The device's own name of its lens model.
    pub stated_model: String,
    /// The lens; null where no lens model of Plumb is equivalent to the device's.
    pub lens: Option<LensDocument>,
    /// Meters per unit of depth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit_m: Option<f64>,
}

/// Where one sensor is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FactoryExtrinsicsDocument {
    /// What it maps, as in `color_from_depth`.
    pub name: String,
    /// The rotation.
    pub rotation: RotationDocument,
    /// The translation, in meters.
    pub translation: [f64; 3],
}

impl FactoryDocument {
    /// Of what is stated; `None` where nothing is.
    pub fn of(factory: &FactoryCalibration) -> Option<Self> {
        let encoding = factory.depth_encoding.as_ref().map(DepthEncodingDocument::from);
        let sensor = |stated: &FactorySensor| {
            let document = FactorySensorDocument {
                image_size: [stated.image_size.width, stated.image_size.height],
                stated_model: stated.stated.model.clone(),
                lens: stated.lens.as_ref().map(LensDocument::from),
                unit_m: encoding
                    .filter(|_| stated.sensor == SensorKind::Depth)
                    .and_then(|encoding| encoding.unit_m),
            };
            (stated.sensor.name().to_owned(), document)
        };
        let extrinsics = |stated: &FactorySensor| {
            let PoseDocument { rotation, translation } =
                PoseDocument::from(&stated.color_from_sensor?);
            let name = format!("color_from_{}", stated.sensor.name());
            (stated.sensor != SensorKind::Color).then_some(FactoryExtrinsicsDocument {
                name,
                rotation,
                translation,
            })
        };
        (!factory.sensors.is_empty() || encoding.is_some()).then(|| Self {
            sensors: factory.sensors.iter().map(sensor).collect(),
            extrinsics: factory.sensors.iter().filter_map(extrinsics).collect(),
            depth_encoding: encoding,
        })
    }
}

/// Every configured camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CamerasDocument {
    /// In the order of the configuration.
    pub cameras: Vec<CameraDocument>,
}
