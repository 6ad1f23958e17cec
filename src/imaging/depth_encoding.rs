//! What whoever took a depth image states of its readings: it travels with the image to wherever
//! that is used.

use crate::geometry::depth_camera::DepthReading;

/// How the readings of depth images encode depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthEncoding {
    /// What they mean; `None` for disparity of unknown meaning, which a calibration estimates.
    pub reading: Option<DepthReading>,
    /// The reading that means none, besides 0 for metric depth.
    pub invalid: Option<u16>,
}

impl DepthEncoding {
    /// Depth in whole millimeters, as ROS has it (REP 118) and most devices, where nobody states
    /// another unit.
    pub const ORDINARY: Self = Self::metric(0.001);

    /// Depth in whole units of this many meters, where 0 means none.
    pub const fn metric(unit_m: f64) -> Self {
        Self { reading: Some(DepthReading::Metric { unit_m }), invalid: Some(0) }
    }
}
