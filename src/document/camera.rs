//! The camera document.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a camera is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CameraStateName {
    /// Being opened.
    Starting,
    /// Delivering frames.
    Streaming,
    /// Gone for now; it is being opened again.
    Lost,
    /// Unusable until a person does something.
    Failed,
}

/// A configured camera and what it is doing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CameraDocument {
    /// Its name in the configuration.
    pub name: String,
    /// What drives it: `v4l2`, `uvc`, `realsense`, `recording` or `simulator`.
    pub backend: String,
    /// What it is doing.
    pub state: CameraStateName,
    /// Why it is in this state; null when nothing is wrong.
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

/// Every configured camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CamerasDocument {
    /// In the order of the configuration.
    pub cameras: Vec<CameraDocument>,
}
