//! Why a frame cannot be decoded, and what to do.

use crate::geometry::pixel::ImageSize;

/// The most pixels that an image may have: 120 megapixels, above any camera that boards are shown
/// to.
pub const MAX_PIXELS: u64 = 120_000_000;

/// A frame that cannot be decoded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// No bytes at all.
    #[error("the image has 0 bytes: it was never written; leave it out or record it again")]
    Empty,
    /// A size of 0 along one side or both.
    #[error("an image of {size} has no pixels: set the source to a size that it supports")]
    NoPixels {
        /// The size that the frame states.
        size: ImageSize,
    },
    /// Neither a JPEG nor a PNG, nor whatever its format says.
    #[error("not an image that Plumb reads: convert it to PNG")]
    NotAnImage,
    /// More pixels than [`MAX_PIXELS`].
    #[error(
        "an image of {size} pixels is over the limit of 120 megapixels: scale it down or correct its header"
    )]
    TooLarge {
        /// What its header says.
        size: ImageSize,
    },
    /// More pixels than its bytes can stand for.
    #[error(
        "an image of {size} pixels in a file of {bytes} bytes cannot be: its header is wrong; leave it out or convert it again"
    )]
    Implausible {
        /// What its header says.
        size: ImageSize,
        /// How many bytes there are.
        bytes: usize,
    },
    /// Its bytes end before its pixels do.
    #[error(
        "the {format} ends too early, after {bytes} bytes: it was cut off; leave it out or copy it again"
    )]
    Truncated {
        /// The file format.
        format: &'static str,
        /// How many bytes there are.
        bytes: usize,
    },
    /// Its bytes contradict the format.
    #[error("the {format} is damaged ({reason}): leave it out or record it again")]
    Malformed {
        /// The file format.
        format: &'static str,
        /// What the decoder met.
        reason: String,
    },
    /// An uncompressed buffer too short for its size.
    #[error(
        "a {size} {format} frame with rows every {stride} bytes needs {needed} bytes, not {bytes}"
    )]
    Buffer {
        /// The frame's size.
        size: ImageSize,
        /// Its pixel format.
        format: &'static str,
        /// Its bytes from row to row.
        stride: usize,
        /// What it needs.
        needed: usize,
        /// What it has.
        bytes: usize,
    },
    /// Something else asked for as depth.
    #[error(
        "a {format} frame cannot be read as depth: give 16-bit PNG or PGM, and check that color and depth are not swapped"
    )]
    NotDepth {
        /// The frame's pixel format.
        format: &'static str,
    },
    /// Depth asked for as an image, or what is compressed as rows.
    #[error("a {format} frame cannot be read as {wanted}")]
    WrongKind {
        /// The frame's pixel format.
        format: &'static str,
        /// What was asked for.
        wanted: &'static str,
    },
}
