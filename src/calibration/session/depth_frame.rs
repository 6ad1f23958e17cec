//! The depth image of a frame, as a session takes it.

use std::sync::Arc;

use crate::detection::board_detection::Detection;
use crate::geometry::depth_camera::PosedDepthLens;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::depth_image::DepthImage;

/// The depth image that was taken with a color image.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFrame {
    /// The readings.
    pub image: Arc<DepthImage>,
    /// The meaning of its numbers.
    pub encoding: DepthEncoding,
    /// The lens that the device states, and the pose of the color camera in it.
    pub factory: Option<PosedDepthLens>,
    /// The board in the image of the infrared camera that measures depth.
    pub infrared: Option<Detection>,
}
