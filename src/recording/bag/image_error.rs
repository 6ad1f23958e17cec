//! Why a message of ROS has no image that is read.

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode::DecodeError;
use crate::recording::fields::TooShort;

/// Encodings that are read, for messages.
const KNOWN: &str = "mono8, mono16, bgr8, rgb8, bgra8, rgba8, yuv422, yuv422_yuy2, nv12, bayer_*, 8UC1, 8UC3, 16UC1 or 32FC1";

/// Why a message has no image that is read; the words follow the name of its topic.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RosImageError {
    /// It ends before its fields do.
    #[error("a {message_type} message cannot be read: {fault}")]
    Message {
        /// Its type.
        message_type: String,
        /// What is wrong.
        fault: TooShort,
    },
    /// Pixels in an encoding that is not read.
    #[error("images encoded as {encoding:?}, not {KNOWN}")]
    UnknownEncoding {
        /// As the message names it.
        encoding: String,
    },
    /// No rows or no columns.
    #[error("a {encoding} image of {size} has no pixels")]
    NoPixels {
        /// As the message names it.
        encoding: String,
        /// The size that it states.
        size: ImageSize,
    },
    /// Less data than its rows need.
    #[error(
        "a {size} {encoding} image with rows every {step_bytes} bytes has {data_bytes} bytes of data"
    )]
    TooFewBytes {
        /// The size that it states.
        size: ImageSize,
        /// As the message names it.
        encoding: String,
        /// From one row to the next.
        step_bytes: usize,
        /// In all.
        data_bytes: usize,
    },
    /// The same of a frame whose pixels are as they came.
    #[error("{size} images with rows every {stride_bytes} bytes and {data_bytes} bytes of data")]
    CutFrame {
        /// The size that it states.
        size: ImageSize,
        /// From one row to the next.
        stride_bytes: usize,
        /// In all.
        data_bytes: usize,
    },
    /// A compressed image that is neither JPEG nor PNG.
    #[error("images compressed as {format:?}, not jpeg or png")]
    UnknownCompression {
        /// As the message names it.
        format: String,
    },
    /// Compressed depth that is not PNG.
    #[error("depth compressed as {format:?} without a PNG inside")]
    DepthWithoutPng {
        /// As the message names it.
        format: String,
    },
    /// Compressed depth whose PNG cannot be decoded.
    #[error(transparent)]
    Depth(#[from] DecodeError),
}
