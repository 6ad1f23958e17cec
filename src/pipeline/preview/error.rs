//! Why there is no image to show.

use crate::imaging::decode::DecodeError;
use crate::imaging::frame::SensorKind;
use crate::pipeline::camera_status::CameraState;
use crate::pipeline::unknown::UnknownCamera;
use crate::store::StoreError;

/// Why there is no image to show.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    /// No such camera is configured.
    #[error(transparent)]
    UnknownCamera(#[from] UnknownCamera),
    /// No image of such a sensor has come from the camera.
    #[error(
        "camera `{camera}` has given no {} image so far; see its sensors at GET /v1/cameras/{camera}",
        sensor.name()
    )]
    UnknownSensor {
        /// The camera's name.
        camera: String,
        /// What was asked for.
        sensor: SensorKind,
    },
    /// Nothing has come from the camera yet.
    #[error(
        "camera `{camera}` has given no frame yet: it is {}{}",
        state.name(),
        reason.as_ref().map_or("; ask again in a moment".to_owned(), |reason| format!(": {reason}"))
    )]
    NoFrame {
        /// The camera's name.
        camera: String,
        /// How it does.
        state: CameraState,
        /// Why.
        reason: Option<String>,
    },
    /// There is no current calibration of this sensor.
    #[error(
        "camera `{camera}` has no approved calibration of {} to undistort with; run a session and approve its calibration",
        sensor.name()
    )]
    NotCalibrated {
        /// The camera's name.
        camera: String,
        /// The sensor.
        sensor: SensorKind,
    },
    /// The camera is in no stereo pair.
    #[error(
        "camera `{camera}`: {} cannot be rectified: {}",
        sensor.name(),
        reason.as_ref().map_or(
            "no calibration of two cameras with it is approved; run a session of its rig, and approve its calibration".to_owned(),
            |reason| format!("by the approved calibration: {reason}"),
        )
    )]
    NotStereo {
        /// The camera's name.
        camera: String,
        /// The sensor.
        sensor: SensorKind,
        /// Why the calibration of its rig is none.
        reason: Option<String>,
    },
    /// There is no current calibration of color and depth.
    #[error(
        "camera `{camera}` has no approved calibration of color and depth to register with; run a session, and approve its calibration"
    )]
    NotRegistered {
        /// The camera's name.
        camera: String,
    },
    /// The newest frame set lacks a sensor that is needed.
    #[error("the newest frames have no {} image; ask again in a moment", sensor.name())]
    Missing {
        /// The sensor.
        sensor: SensorKind,
    },
    /// The newest frame is damaged.
    #[error("the newest frame cannot be read: {0}")]
    Unreadable(#[from] DecodeError),
    /// The current calibration was made of images of another size.
    #[error(
        "the current calibration is for {} images of another size; calibrate again",
        sensor.name()
    )]
    OtherSize {
        /// The sensor.
        sensor: SensorKind,
    },
    /// The current calibration could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl PreviewError {
    /// That the newest frame set of `camera` has no image of `sensor`: the next one may, if the
    /// sensor is one of those that have `given` an image.
    pub(in crate::pipeline) fn no_image_of(
        sensor: SensorKind,
        camera: &str,
        given: &[SensorKind],
    ) -> Self {
        if given.contains(&sensor) {
            return Self::Missing { sensor };
        }
        Self::UnknownSensor { camera: camera.to_owned(), sensor }
    }

    /// Whether the error concerns the newest frame alone: a later one may be shown.
    pub fn is_of_one_frame(&self) -> bool {
        matches!(self, Self::NoFrame { .. } | Self::Missing { .. } | Self::Unreadable(_))
    }
}
