//! A picture's file as a frame: JPEG and PNG stay as they are until someone needs their pixels.

use std::path::Path;
use std::sync::Arc;

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode::{MAX_PIXELS, file_size};
use crate::imaging::frame::{Frame, PixelFormat, SensorKind};

/// The endings of files that are taken for pictures, in any case of letters.
pub const EXTENSIONS: [&str; 6] = ["jpg", "jpeg", "png", "pgm", "ppm", "pnm"];

/// Whether `path` is named like a picture.
pub fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension))
}

/// The frame that a picture's file holds. JPEG and PNG are kept as they came; a binary PGM or PPM is unpacked to mono8,
/// rgb8, or, with 16 bits, to depth. A file that cannot be read as any of them becomes a frame all the same, of size 0×0, and
/// decoding it tells what is wrong: a damaged picture is one bad frame, not the end of a recording.
pub fn frame_from_file(sensor: SensorKind, bytes: Vec<u8>) -> Frame {
    let as_it_came = |format, size, bytes: Vec<u8>| Frame { sensor, size, format, stride: 0, bytes: Arc::from(bytes) };
    if bytes.first() == Some(&b'P')
        && let Some(frame) = frame_from_pnm(sensor, &bytes)
    {
        return frame;
    }
    let size = file_size(&bytes).unwrap_or(ImageSize::new(0, 0));
    as_it_came(PixelFormat::of_file(&bytes).unwrap_or(PixelFormat::Jpeg), size, bytes)
}

/// A binary PGM (P5) or PPM (P6). Its values are kept as they are, whatever its maximum says: depth is a number, not a
/// brightness.
fn frame_from_pnm(sensor: SensorKind, bytes: &[u8]) -> Option<Frame> {
    let channels = match bytes.get(..2)? {
        b"P5" => 1,
        b"P6" => 3,
        _ => return None,
    };
    let (fields, pixels) = pnm_header(&bytes[2..])?;
    let [width, height, maximum] = fields;
    let deep = maximum > 255;
    let area = u64::from(width) * u64::from(height);
    let length = area as usize * channels * if deep { 2 } else { 1 };
    if area == 0 || area > MAX_PIXELS || maximum > 65_535 || pixels.len() < length {
        return None;
    }
    let pixels = &pixels[..length];
    let (format, pixels) = match (channels, deep) {
        (1, false) => (PixelFormat::Mono8, pixels.to_vec()),
        (1, true) if sensor == SensorKind::Depth => {
            (PixelFormat::Depth16, pixels.chunks_exact(2).flat_map(|two| [two[1], two[0]]).collect())
        }
        (1, true) => (PixelFormat::Mono8, pixels.iter().step_by(2).copied().collect()),
        (_, false) => (PixelFormat::Rgb8, pixels.to_vec()),
        (_, true) => (PixelFormat::Rgb8, pixels.iter().step_by(2).copied().collect()),
    };
    let size = ImageSize::new(width, height);
    let stride = width as usize * format.bytes_per_pixel()?;
    Some(Frame { sensor, size, format, stride, bytes: Arc::from(pixels) })
}

/// Width, height and maximum of a PNM header after its magic number, and what follows it.
fn pnm_header(bytes: &[u8]) -> Option<([u32; 3], &[u8])> {
    let mut rest = bytes;
    let mut fields = [0; 3];
    for field in &mut fields {
        loop {
            rest = rest.trim_ascii_start();
            if rest.first() != Some(&b'#') {
                break;
            }
            rest = &rest[rest.iter().position(|byte| *byte == b'\n')?..];
        }
        let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
        *field = std::str::from_utf8(&rest[..digits]).ok()?.parse().ok()?;
        rest = &rest[digits..];
    }
    rest.first()?.is_ascii_whitespace().then(|| (fields, &rest[1..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn portable_maps_are_unpacked() {
        let grey = frame_from_file(SensorKind::Color, b"P5 # made by hand\n2 1 255\n\x07\xff".to_vec());
        assert_eq!((grey.format, grey.size, &*grey.bytes), (PixelFormat::Mono8, ImageSize::new(2, 1), &[7, 255][..]));
        let deep = b"P5 2 1 4095\n\x01\x02\xff\xfe".to_vec();
        let depth = frame_from_file(SensorKind::Depth, deep.clone());
        assert_eq!((depth.format, depth.stride, &*depth.bytes), (PixelFormat::Depth16, 4, &[2, 1, 0xfe, 0xff][..]));
        let picture = frame_from_file(SensorKind::Infrared, deep);
        assert_eq!((picture.format, &*picture.bytes), (PixelFormat::Mono8, &[1, 0xff][..]));
    }

    #[test]
    fn what_is_no_picture_is_a_frame_that_says_so_when_decoded() {
        let huge = b"P5 99999 99999 255\n".to_vec();
        for bytes in [Vec::new(), b"hello".to_vec(), b"P5 2 2 255\n\x01".to_vec(), huge, vec![0xff, 0xd8, 0xff]] {
            let frame = frame_from_file(SensorKind::Color, bytes);
            assert_eq!(frame.size, ImageSize::new(0, 0));
            let mut luma = crate::imaging::gray::GrayImage::default();
            let line = crate::imaging::decode::luma(&frame, &mut luma).unwrap_err().to_string();
            assert!(!line.is_empty() && !line.contains('\n'), "{line}");
        }
    }
}
