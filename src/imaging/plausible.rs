//! How large an image a file can hold: a header of a few bytes must not ask for gigabytes.
//!
//! A camera's images have noise, and so at least a bit for every few pixels. Rendered ones have
//! none: theirs may be of [`PIXELS_AT_LEAST`] pixels however small the file is.

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode_error::{DecodeError, MAX_PIXELS};

/// Pixels that a file of any length may hold.
const PIXELS_AT_LEAST: u64 = 16_000_000;
/// Pixels that each further byte may stand for. A JPEG of one brightness has 85 a byte.
const MOST_PIXELS_PER_BYTE: u64 = 128;
/// Decoded bytes that a file of any length may take: 8 megapixels of 16 bits in four channels.
const MEMORY_AT_LEAST: u64 = 64 << 20;
/// Decoded bytes that each further byte of the file may take.
const MOST_MEMORY_PER_BYTE: u64 = 64;

/// The `size` that a header states, if an image of it with `bytes_per_pixel` when decoded fits into
/// `file_bytes`.
///
/// # Errors
/// [`DecodeError::TooLarge`] and [`DecodeError::Implausible`].
pub(super) fn check_size(
    size: ImageSize,
    bytes_per_pixel: u64,
    file_bytes: usize,
) -> Result<ImageSize, DecodeError> {
    let pixels = u64::from(size.width) * u64::from(size.height);
    if pixels > MAX_PIXELS {
        return Err(DecodeError::TooLarge { size });
    }
    let file = file_bytes as u64;
    let fits = pixels <= PIXELS_AT_LEAST + MOST_PIXELS_PER_BYTE.saturating_mul(file)
        && pixels * bytes_per_pixel <= memory_limit(file_bytes);
    if fits { Ok(size) } else { Err(DecodeError::Implausible { size, bytes: file_bytes }) }
}

/// The most bytes that a file of `file_bytes` may take when it is decoded.
pub(super) fn memory_limit(file_bytes: usize) -> u64 {
    MEMORY_AT_LEAST + MOST_MEMORY_PER_BYTE.saturating_mul(file_bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cameras_and_renderers_write_fits_and_a_bomb_does_not() {
        let photograph = check_size(ImageSize::new(12_000, 10_000), 3, 20_000_000);
        let rendered = check_size(ImageSize::new(4096, 3000), 3, 40_000);
        let one_brightness = check_size(ImageSize::new(8000, 6000), 1, 48_000_000 / 85);
        assert!(photograph.is_ok() && rendered.is_ok() && one_brightness.is_ok());
        let bomb = check_size(ImageSize::new(12_000, 10_000), 1, 120_000).unwrap_err();
        assert!(matches!(bomb, DecodeError::Implausible { bytes: 120_000, .. }));
        let deep = check_size(ImageSize::new(5000, 3000), 8, 60_000);
        assert!(matches!(deep, Err(DecodeError::Implausible { .. })));
    }
}
