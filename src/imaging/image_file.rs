//! An image's file as a frame: JPEG and PNG stay as they are until someone needs their pixels.

use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode::{MAX_PIXELS, file_size};
use crate::imaging::frame::{Frame, PixelFormat, SensorKind};
use crate::imaging::gray::GrayView;
use crate::imaging::plausible::{check_size, memory_limit};

/// The endings of files that are taken for images, in any case of letters.
pub const EXTENSIONS: [&str; 10] =
    ["jpg", "jpeg", "png", "pgm", "ppm", "pnm", "bmp", "tif", "tiff", "webp"];

/// Whether `path` is named like an image.
pub fn is_image(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension))
}

/// A gray PNG of `image`, without loss.
pub fn png_from_luma(image: GrayView<'_>) -> Vec<u8> {
    let pixels: Vec<u8> = (0..image.height()).flat_map(|y| image.row(y)).copied().collect();
    let (mut file, size) = (Vec::new(), image.size());
    let encoder = image::codecs::png::PngEncoder::new(&mut file);
    let (width, height, color) = (size.width, size.height, image::ExtendedColorType::L8);
    let written = image::ImageEncoder::write_image(encoder, &pixels, width, height, color);
    debug_assert!(written.is_ok(), "a PNG is written to memory");
    file
}

/// The frame that an image's file holds. JPEG and PNG are kept as they came; a binary PGM or PPM,
/// BMP, TIFF and WebP are unpacked to mono8, rgb8, or, with 16 bits, to mono16 or depth. A file that cannot
/// be read as any of them becomes a frame all the same, of size 0×0, and decoding it says what is
/// wrong: a damaged image is one bad frame, not the end of a recording.
pub fn frame_from_file(sensor: SensorKind, bytes: Vec<u8>) -> Frame {
    let as_it_came = |format, size, bytes: Vec<u8>| Frame {
        sensor,
        size,
        format,
        stride: 0,
        bytes: Arc::from(bytes),
    };
    if matches!(bytes.get(..2), Some(b"P5" | b"P6")) {
        let unreadable = |bytes| {
            let format =
                if sensor == SensorKind::Depth { PixelFormat::Depth16 } else { PixelFormat::Mono8 };
            as_it_came(format, ImageSize::new(0, 0), bytes)
        };
        return frame_from_pnm(sensor, &bytes).unwrap_or_else(|| unreadable(bytes));
    }
    if let Some(frame) = frame_from_unpacked(sensor, &bytes) {
        return frame;
    }
    let size = file_size(&bytes).unwrap_or(ImageSize::new(0, 0));
    as_it_came(PixelFormat::of_file(&bytes).unwrap_or(PixelFormat::Jpeg), size, bytes)
}

/// A BMP, TIFF or WebP: formats that no camera sends, but in which people keep images.
fn frame_from_unpacked(sensor: SensorKind, bytes: &[u8]) -> Option<Frame> {
    let format = image::guess_format(bytes).ok()?;
    if !matches!(format, ImageFormat::Bmp | ImageFormat::Tiff | ImageFormat::WebP) {
        return None;
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(memory_limit(bytes.len()));
    reader.limits(limits);
    let decoder = reader.into_decoder().ok()?;
    let (width, height) = decoder.dimensions();
    let bytes_per_pixel = u64::from(decoder.color_type().bytes_per_pixel());
    let size = check_size(ImageSize::new(width, height), bytes_per_pixel, bytes.len()).ok()?;
    let image = DynamicImage::from_decoder(decoder).ok()?;
    let (format, pixels) = match image {
        DynamicImage::ImageLuma16(deep) => {
            (deep_format(sensor), deep.into_raw().into_iter().flat_map(u16::to_le_bytes).collect())
        }
        image if image.color().has_color() => (PixelFormat::Rgb8, image.into_rgb8().into_raw()),
        image => (PixelFormat::Mono8, image.into_luma8().into_raw()),
    };
    let stride = size.width as usize * format.bytes_per_pixel()?;
    Some(Frame { sensor, size, format, stride, bytes: Arc::from(pixels) })
}

/// What 16-bit gray of `sensor` means.
fn deep_format(sensor: SensorKind) -> PixelFormat {
    if sensor == SensorKind::Depth { PixelFormat::Depth16 } else { PixelFormat::Mono16 }
}

/// A binary PGM (P5) or PPM (P6). Brightnesses are scaled by the maximum that it states, unless that
/// is all of 16 bits, of which few sensors fill all; depths are kept as they are: they are numbers.
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
        (1, true) if sensor == SensorKind::Depth || maximum == u32::from(u16::MAX) => {
            (deep_format(sensor), pixels.chunks_exact(2).flat_map(|two| [two[1], two[0]]).collect())
        }
        (1, true) => (PixelFormat::Mono8, brightnesses(pixels, maximum)),
        (_, false) => (PixelFormat::Rgb8, pixels.to_vec()),
        (_, true) => (PixelFormat::Rgb8, brightnesses(pixels, maximum)),
    };
    let size = ImageSize::new(width, height);
    let stride = width as usize * format.bytes_per_pixel()?;
    Some(Frame { sensor, size, format, stride, bytes: Arc::from(pixels) })
}

/// Big-endian 16-bit values as brightnesses from 0 to 255, where `maximum` is white.
fn brightnesses(pixels: &[u8], maximum: u32) -> Vec<u8> {
    let brightness = |two: &[u8]| {
        let value = u32::from(u16::from_be_bytes([two[0], two[1]]));
        ((value * 255 + maximum / 2) / maximum).min(255) as u8
    };
    pixels.chunks_exact(2).map(brightness).collect()
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
        let gray =
            frame_from_file(SensorKind::Color, b"P5 # made by hand\n2 1 255\n\x07\xff".to_vec());
        assert_eq!(
            (gray.format, gray.size, &*gray.bytes),
            (PixelFormat::Mono8, ImageSize::new(2, 1), &[7, 255][..])
        );
        let deep = b"P5 2 1 4095\n\x01\x02\xff\xfe".to_vec();
        let depth = frame_from_file(SensorKind::Depth, deep.clone());
        assert_eq!(
            (depth.format, depth.stride, &*depth.bytes),
            (PixelFormat::Depth16, 4, &[2, 1, 0xfe, 0xff][..])
        );
        let image = frame_from_file(SensorKind::Infrared, deep);
        assert_eq!((image.format, &*image.bytes), (PixelFormat::Mono8, &[16, 0xff][..]));
        let lower_bits =
            frame_from_file(SensorKind::Color, b"P5 2 1 65535\n\x01\x02\x0f\xfe".to_vec());
        assert_eq!(
            (lower_bits.format, lower_bits.stride, &*lower_bits.bytes),
            (PixelFormat::Mono16, 4, &[2, 1, 0xfe, 0x0f][..])
        );
    }

    #[test]
    fn bmp_tiff_and_webp_are_unpacked() {
        let gray = DynamicImage::ImageLuma8(image::GrayImage::from_fn(3, 2, |x, y| {
            image::Luma([(x * 40 + y * 9) as u8])
        }));
        for format in [ImageFormat::Bmp, ImageFormat::Tiff, ImageFormat::WebP] {
            let mut file = Cursor::new(Vec::new());
            gray.write_to(&mut file, format).unwrap();
            let whole = file.into_inner();
            let frame = frame_from_file(SensorKind::Color, whole.clone());
            let mut luma = crate::imaging::gray::GrayImage::default();
            crate::imaging::decode::luma(&frame, &mut luma).unwrap();
            let row: Vec<u8> =
                gray.as_luma8().unwrap().rows().nth(1).unwrap().map(|pixel| pixel.0[0]).collect();
            assert_eq!(luma.view().row(1), row);
            let cut = frame_from_file(SensorKind::Color, whole[..whole.len() / 2].to_vec());
            assert!(crate::imaging::decode::luma(&cut, &mut luma).is_err(), "{format:?}");
        }
        let mut file = Cursor::new(Vec::new());
        DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(2, 1, vec![258, 65_534]).unwrap())
            .write_to(&mut file, ImageFormat::Tiff)
            .unwrap();
        let file = file.into_inner();
        for (sensor, format) in
            [(SensorKind::Depth, PixelFormat::Depth16), (SensorKind::Infrared, PixelFormat::Mono16)]
        {
            let frame = frame_from_file(sensor, file.clone());
            assert_eq!(
                (frame.format, frame.stride, &*frame.bytes),
                (format, 4, &[2, 1, 0xfe, 0xff][..])
            );
        }
    }

    #[test]
    fn what_is_no_image_is_a_frame_that_says_so_when_decoded() {
        let huge = b"P5 99999 99999 255\n".to_vec();
        for bytes in [
            Vec::new(),
            b"hello".to_vec(),
            b"P5 2 2 255\n\x01".to_vec(),
            huge,
            vec![0xff, 0xd8, 0xff],
        ] {
            let frame = frame_from_file(SensorKind::Color, bytes);
            assert_eq!(frame.size, ImageSize::new(0, 0));
            let mut luma = crate::imaging::gray::GrayImage::default();
            let line = crate::imaging::decode::luma(&frame, &mut luma).unwrap_err().to_string();
            assert!(!line.is_empty() && !line.contains('\n'), "{line}");
            assert_eq!(frame.bytes.starts_with(b"P5"), line.contains("PGM"), "{line}");
        }
    }
}
