//! What a device states about its own sensors, as it left the factory: kept as stated, beside what
//! Plumb finds.

use crate::geometry::depth_camera::PosedDepthLens;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::frame::SensorKind;

/// Everything that a device states; empty for one that states nothing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FactoryCalibration {
    /// One entry a sensor that states anything.
    pub sensors: Vec<FactorySensor>,
    /// What the readings of its depth images mean.
    pub depth_encoding: Option<DepthEncoding>,
}

impl FactoryCalibration {
    /// What is stated of `sensor`.
    pub fn sensor(&self, sensor: SensorKind) -> Option<&FactorySensor> {
        self.sensors.iter().find(|stated| stated.sensor == sensor)
    }
}

/// What is stated of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct FactorySensor {
    /// Which sensor.
    pub sensor: SensorKind,
    /// The size that the lens is stated for.
    pub image_size: ImageSize,
    /// The numbers as stated.
    pub stated: StatedLens,
    /// The same as a lens, where a model of Plumb's says the same.
    pub lens: Option<Lens>,
    /// From this sensor's frame to the color sensor's.
    pub color_from_sensor: Option<Pose>,
}

impl FactorySensor {
    /// Its lens and pose as those of a depth sensor, where both are stated for images of this size.
    pub fn depth_lens(&self, size: ImageSize) -> Option<PosedDepthLens> {
        let depth_from_color = self.color_from_sensor?.inverse();
        let lens = self.lens.filter(|_| self.image_size == size)?;
        Some(PosedDepthLens { lens, depth_from_color })
    }
}

/// A lens in the device's own terms.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedLens {
    /// The device's name for the model.
    pub model: String,
    /// Focal length in pixels along x and y.
    pub focal_px: [f64; 2],
    /// Principal point in pixels.
    pub principal_px: [f64; 2],
    /// The model's coefficients in the device's order.
    pub coefficients: Vec<f64>,
}
