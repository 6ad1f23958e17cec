//! PNG files, read for their pixels alone.
//!
//! Ancillary chunks (color profiles, texts) change no pixel of a measurement, may unpack to a
//! thousand times their size, and are left out before a decoder sees the file.

use std::borrow::Cow;
use std::io::Cursor;

use image::{ColorType, DynamicImage, ImageDecoder};

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode_error::DecodeError;
use crate::imaging::frame::PixelFormat;
use crate::imaging::plausible;

/// Length of the signature before the first chunk.
const SIGNATURE: usize = 8;
/// A chunk's length, its name and its checksum.
const CHUNK_FRAME: usize = 4 + 4 + 4;
/// The chunks that make up the pixels. Transparency is read so that it can be dropped.
const OF_PIXELS: [&[u8; 4]; 5] = [b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"];

/// The size that the header states.
///
/// # Errors
/// [`DecodeError`] when it is cut off or cannot be true.
pub(super) fn size(bytes: &[u8]) -> Result<ImageSize, DecodeError> {
    let (Some(width), Some(height)) = (word_at(bytes, 16), word_at(bytes, 20)) else {
        return Err(truncated(bytes));
    };
    plausible::check_size(ImageSize::new(width, height), 1, bytes.len())
}

/// Whether the header states one channel of 16 bits.
pub(super) fn is_gray16(bytes: &[u8]) -> bool {
    bytes.get(24..26) == Some(&[16, 0])
}

/// The pixels; those with an alpha channel as red, green and blue.
///
/// # Errors
/// [`DecodeError`], whatever the bytes.
pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, DecodeError> {
    if PixelFormat::of_file(bytes) != Some(PixelFormat::Png) {
        return Err(DecodeError::NotAnImage);
    }
    let pixels = chunks_of_pixels(bytes);
    size(&pixels)?;
    let failed = |error: image::ImageError| png_error(&error, bytes);
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(plausible::memory_limit(pixels.len()));
    let decoder = image::codecs::png::PngDecoder::with_limits(Cursor::new(&*pixels), limits)
        .map_err(failed)?;
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    let bytes_per_pixel = u64::from(color.bytes_per_pixel());
    plausible::check_size(ImageSize::new(width, height), bytes_per_pixel, pixels.len())?;
    let alpha =
        matches!(color, ColorType::La8 | ColorType::La16 | ColorType::Rgba8 | ColorType::Rgba16);
    let image = DynamicImage::from_decoder(decoder).map_err(failed)?;
    Ok(if alpha { image.into_rgb8().into() } else { image })
}

/// The file without its ancillary chunks; as it is where it has none.
fn chunks_of_pixels(bytes: &[u8]) -> Cow<'_, [u8]> {
    let chunks = || Chunks { bytes, at: SIGNATURE };
    let of_pixels = |chunk: &&[u8]| OF_PIXELS.iter().any(|name| chunk[4..].starts_with(*name));
    if chunks().all(|chunk| of_pixels(&chunk)) {
        return Cow::Borrowed(bytes);
    }
    let mut kept = bytes[..SIGNATURE].to_vec();
    chunks().filter(of_pixels).for_each(|chunk| kept.extend_from_slice(chunk));
    Cow::Owned(kept)
}

/// The chunks, each with its length, name and checksum; the last may be cut off.
struct Chunks<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Iterator for Chunks<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.bytes.get(self.at..).filter(|rest| rest.len() >= 8)?;
        let length = (word_at(rest, 0)? as usize).saturating_add(CHUNK_FRAME).min(rest.len());
        self.at += length;
        Some(&rest[..length])
    }
}

fn word_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn truncated(bytes: &[u8]) -> DecodeError {
    DecodeError::Truncated { format: "PNG", bytes: bytes.len() }
}

fn png_error(error: &image::ImageError, bytes: &[u8]) -> DecodeError {
    let text = error.to_string();
    if matches!(error, image::ImageError::IoError(_)) || text.contains("nexpected end") {
        return truncated(bytes);
    }
    let reason = text.lines().next().unwrap_or_default().to_owned();
    DecodeError::Malformed { format: "PNG", reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(name: &[u8; 4], body: &[u8]) -> Vec<u8> {
        let length = (body.len() as u32).to_be_bytes();
        [&length[..], name, body, &[0; 4]].concat()
    }

    #[test]
    fn ancillary_chunks_are_left_out_and_cost_no_pixel() {
        let gray = image::GrayImage::from_fn(9, 5, |x, y| image::Luma([(20 * x + 7 * y) as u8]));
        let mut file = Cursor::new(Vec::new());
        gray.write_to(&mut file, image::ImageFormat::Png).unwrap();
        let plain = file.into_inner();
        let first_data = plain.windows(4).position(|name| name == b"IDAT").unwrap() - 4;
        // Wrong checksums and contents that do not unpack: nobody reads them.
        let (before, after) = plain.split_at(first_data);
        let extra = [chunk(b"iCCP", b"x\0\0nothing"), chunk(b"zTXt", &[0; 99])].concat();
        let with_extra = [before, &extra, after].concat();
        assert_eq!(&*chunks_of_pixels(&with_extra), plain);
        assert_eq!(decode(&with_extra).unwrap().into_luma8(), gray);
        assert!(matches!(chunks_of_pixels(&plain), Cow::Borrowed(_)));
        for cut in 0..with_extra.len() - 4 {
            assert!(decode(&with_extra[..cut]).is_err(), "at {cut}");
        }
    }
}
