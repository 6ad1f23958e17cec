//! Identifies a sensor of an instrument. Sensors are data, so that one camera, a depth camera and a
//! rig of either differ only in their number.

use crate::imaging::frame::SensorKind;

/// A sensor of an instrument.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SensorId {
    /// Its camera's name in the rig; `None` where the instrument is one camera.
    pub camera: Option<String>,
    /// Which of the camera's sensors.
    pub kind: SensorKind,
}

impl SensorId {
    /// A sensor of an instrument that is one camera.
    pub const fn own(kind: SensorKind) -> Self {
        Self { camera: None, kind }
    }

    /// A sensor of a rig's camera.
    pub fn of(camera: &str, kind: SensorKind) -> Self {
        Self { camera: Some(camera.to_owned()), kind }
    }
}
