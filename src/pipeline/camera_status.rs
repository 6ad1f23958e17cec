//! The state of a camera.

use crate::geometry::pixel::ImageSize;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{PixelFormat, SensorKind};

/// Whether a camera delivers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraState {
    /// It is being opened, or has delivered no frame yet.
    Starting,
    /// It delivers frames.
    Streaming,
    /// It delivered frames and stopped; it is opened again.
    Lost,
    /// It cannot be opened, or has ended; the reason states whether it is tried again.
    Failed,
}

impl CameraState {
    /// Every state.
    pub const ALL: [Self; 4] = [Self::Starting, Self::Streaming, Self::Lost, Self::Failed];

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Streaming => "streaming",
            Self::Lost => "lost",
            Self::Failed => "failed",
        }
    }
}

/// One sensor of a camera, as its newest frame shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SensorStatus {
    /// Which sensor.
    pub kind: SensorKind,
    /// The size of its frames.
    pub size: ImageSize,
    /// How they are encoded.
    pub format: PixelFormat,
}

/// The identity of the device, as far as the device states it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CameraIdentity {
    /// The device's own name.
    pub model: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// Where it is plugged in, or the file it is read from.
    pub bus: Option<String>,
}

impl CameraIdentity {
    /// The device in words, without its bus; `None` where it states neither model nor serial
    /// number.
    pub fn device(&self) -> Option<String> {
        match (&self.model, &self.serial) {
            (Some(model), Some(serial)) => Some(format!("{model}, serial {serial}")),
            (Some(model), None) => Some(model.clone()),
            (None, Some(serial)) => Some(format!("serial {serial}")),
            (None, None) => None,
        }
    }
}

/// A camera as seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraStatus {
    /// Its name in the configuration.
    pub name: String,
    /// What kind of source it is: `v4l2`, `uvc`, `realsense`, `ros2`, `recording`,
    /// `simulator`.
    pub backend: String,
    /// Whether it delivers.
    pub state: CameraState,
    /// Why it is in this state; `None` while all is well.
    pub reason: Option<String>,
    /// The sensors of its newest frame set.
    pub sensors: Vec<SensorStatus>,
    /// Measured frame sets a second, over about the last second of streaming; `None` before there
    /// are two.
    pub fps: Option<f64>,
    /// Frame sets received since the daemon started.
    pub frames: u64,
    /// Frame sets lost: gaps in the device's count, and frame sets that were replaced by a newer
    /// one before they were searched.
    pub dropped_frames: u64,
    /// Which device it is.
    pub identity: CameraIdentity,
    /// What the device states of its own sensors.
    pub factory: FactoryCalibration,
    /// The id of its current calibration.
    pub calibration: Option<String>,
    /// The id of the session that collects or solves now.
    pub session: Option<String>,
}

impl CameraStatus {
    /// A camera that has not delivered yet.
    pub fn starting(name: &str, backend: &str) -> Self {
        Self {
            name: name.to_owned(),
            backend: backend.to_owned(),
            state: CameraState::Starting,
            reason: None,
            sensors: Vec::new(),
            fps: None,
            frames: 0,
            dropped_frames: 0,
            identity: CameraIdentity::default(),
            factory: FactoryCalibration::default(),
            calibration: None,
            session: None,
        }
    }
}
