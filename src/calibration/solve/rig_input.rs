//! The observations of a rig, before calibration.

use crate::calibration::sensor::SensorId;
use crate::estimation::rig::FrameSetView;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::target::Target;

/// Image sensors that are fixed to each other, to be calibrated together.
#[derive(Debug, Clone, PartialEq)]
pub struct RigInput {
    /// The board.
    pub board: Target,
    /// The sensors, camera by camera.
    pub sensors: Vec<RigSensorInput>,
}

/// One image sensor of a rig with its observations.
#[derive(Debug, Clone, PartialEq)]
pub struct RigSensorInput {
    /// Which.
    pub id: SensorId,
    /// Its name in messages.
    pub name: String,
    /// The size of its images.
    pub image_size: ImageSize,
    /// Its lens, if it is known and held fixed.
    pub given: Option<Lens>,
    /// What it saw.
    pub views: Vec<FrameSetView>,
}
