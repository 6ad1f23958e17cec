//! What a rig saw, before anything is calibrated.

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

/// One image sensor of a rig and what it saw.
#[derive(Debug, Clone, PartialEq)]
pub struct RigSensorInput {
    /// Which.
    pub id: SensorId,
    /// What it is called in messages.
    pub name: String,
    /// The size of its images.
    pub image_size: ImageSize,
    /// Its lens, where that is known and held.
    pub given: Option<Lens>,
    /// What it saw.
    pub views: Vec<FrameSetView>,
}
