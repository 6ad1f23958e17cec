//! From a frame's bytes to luma, colors or depth; and luma to JPEG.
//!
//! Nothing is allocated before the header's size is known to be sane: at most [`MAX_PIXELS`] per
//! image.

use image::{DynamicImage, RgbImage};

pub use crate::imaging::decode_error::{DecodeError, MAX_PIXELS};

use crate::geometry::pixel::ImageSize;
use crate::imaging::deep_gray::{bits_to_drop, upper_8_bits};
use crate::imaging::frame::{Frame, PixelFormat};
use crate::imaging::gray::{Gray16Image, GrayImage, GrayView};
use crate::imaging::jpeg;
use crate::imaging::pixel_format::{
    buffer_length, luma_row_from_bgr, luma_row_from_rgb, luma_row_from_uyvy, luma_row_from_yuyv,
    rgb_row_from_nv12, rgb_row_from_uyvy, rgb_row_from_yuyv,
};
use crate::imaging::{plausible, png};

/// The size that a JPEG's or PNG's header states, without decoding it.
///
/// # Errors
/// [`DecodeError`] when it has none, or is over [`MAX_PIXELS`].
pub fn file_size(bytes: &[u8]) -> Result<ImageSize, DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    match PixelFormat::of_file(bytes) {
        Some(PixelFormat::Jpeg) => jpeg_size(bytes, jpeg::JpegHeader::read(bytes)?),
        Some(PixelFormat::Png) => png::size(bytes),
        _ => Err(DecodeError::NotAnImage),
    }
}

/// The 8-bit luma of a frame, into `luma`, whose buffer is used again.
///
/// JPEG: its Y alone, nothing else is decoded. Colors: BT.601, as OpenCV's `cvtColor`. 16-bit
/// gray: the upper 8 of the bits in use, as many sensors fill only the lower 10 to 14.
///
/// # Errors
/// [`DecodeError`], never a panic, whatever the bytes; `luma` then holds nothing of use.
pub fn luma(frame: &Frame, luma: &mut GrayImage) -> Result<(), DecodeError> {
    check_bytes(frame)?;
    match frame.format {
        PixelFormat::Jpeg => jpeg_luma(&frame.bytes, luma),
        PixelFormat::Png => luma_from_image(&png::decode(&frame.bytes)?, luma),
        PixelFormat::Mono8 | PixelFormat::Nv12 => {
            luma_from_rows(frame, luma, |row, out| out.copy_from_slice(row))
        }
        PixelFormat::Mono16 => {
            let dropped = bits_to_drop_of(frame)?;
            luma_from_rows(frame, luma, |row, out| {
                gray16_values(row)
                    .zip(out)
                    .for_each(|(value, out)| *out = upper_8_bits(value, dropped));
            })
        }
        PixelFormat::Uyvy => luma_from_rows(frame, luma, luma_row_from_uyvy),
        PixelFormat::Yuyv => luma_from_rows(frame, luma, luma_row_from_yuyv),
        PixelFormat::Rgb8 => luma_from_rows(frame, luma, luma_row_from_rgb),
        PixelFormat::Bgr8 => luma_from_rows(frame, luma, luma_row_from_bgr),
        PixelFormat::Depth16 => {
            Err(DecodeError::WrongKind { format: frame.format.name(), wanted: "an image" })
        }
    }
}

/// A frame's colors; a gray frame's as three equal channels.
///
/// # Errors
/// As [`luma`].
pub fn rgb(frame: &Frame) -> Result<RgbImage, DecodeError> {
    check_bytes(frame)?;
    match frame.format {
        PixelFormat::Jpeg => {
            let header = jpeg::JpegHeader::read(&frame.bytes)?;
            let size = jpeg_size(&frame.bytes, header)?;
            rgb_image(size, jpeg::rgb(&frame.bytes, header)?)
        }
        PixelFormat::Png => Ok(png::decode(&frame.bytes)?.into_rgb8()),
        PixelFormat::Mono8 => rgb_from_rows(frame, |row, out| {
            for (value, pixel) in row.iter().zip(out.chunks_exact_mut(3)) {
                pixel.fill(*value);
            }
        }),
        PixelFormat::Mono16 => {
            let dropped = bits_to_drop_of(frame)?;
            rgb_from_rows(frame, |row, out| {
                for (value, pixel) in gray16_values(row).zip(out.chunks_exact_mut(3)) {
                    pixel.fill(upper_8_bits(value, dropped));
                }
            })
        }
        PixelFormat::Yuyv => rgb_from_rows(frame, rgb_row_from_yuyv),
        PixelFormat::Uyvy => rgb_from_rows(frame, rgb_row_from_uyvy),
        PixelFormat::Nv12 => rgb_from_nv12(frame),
        PixelFormat::Rgb8 => rgb_from_rows(frame, |row, out| out.copy_from_slice(row)),
        PixelFormat::Bgr8 => rgb_from_rows(frame, |row, out| {
            for (bgr, pixel) in row.chunks_exact(3).zip(out.chunks_exact_mut(3)) {
                pixel.copy_from_slice(&[bgr[2], bgr[1], bgr[0]]);
            }
        }),
        PixelFormat::Depth16 => {
            Err(DecodeError::WrongKind { format: frame.format.name(), wanted: "an image" })
        }
    }
}

/// The values of a gray frame of 16 bits; `None` for one of another kind.
///
/// # Errors
/// As [`luma`].
pub fn gray16(frame: &Frame) -> Result<Option<Gray16Image>, DecodeError> {
    match frame.format {
        PixelFormat::Png if png::is_gray16(&frame.bytes) => Ok(match png::decode(&frame.bytes)? {
            DynamicImage::ImageLuma16(image) => Some(image),
            _ => None,
        }),
        PixelFormat::Mono16 => {
            let values = rows_of(frame)?.flat_map(gray16_values).collect();
            Ok(Gray16Image::from_raw(frame.size.width, frame.size.height, values))
        }
        _ => Ok(None),
    }
}

/// A gray JPEG of `image` with `quality` 1 to 100: the same bytes on every machine.
pub fn encode_jpeg(image: GrayView<'_>, quality: u8) -> Vec<u8> {
    let pixels: Vec<u8> = (0..image.height()).flat_map(|y| image.row(y)).copied().collect();
    encode(&pixels, image.size(), image::ExtendedColorType::L8, quality)
}

/// A color JPEG of `image` with `quality` 1 to 100.
pub fn encode_jpeg_rgb(image: &RgbImage, quality: u8) -> Vec<u8> {
    let size = ImageSize::new(image.width(), image.height());
    encode(image.as_raw(), size, image::ExtendedColorType::Rgb8, quality)
}

fn encode(pixels: &[u8], size: ImageSize, color: image::ExtendedColorType, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder =
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality.clamp(1, 100));
    // Writing to memory cannot fail; what remains is a size of 0 or over 65535, for which there is
    // no JPEG.
    if encoder.encode(pixels, size.width, size.height, color).is_err() {
        bytes.clear();
    }
    bytes
}

/// Refuses a frame without bytes, and a portable map that could not be unpacked.
pub(super) fn check_bytes(frame: &Frame) -> Result<(), DecodeError> {
    if frame.bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    let is_map = frame.bytes.starts_with(b"P5") || frame.bytes.starts_with(b"P6");
    if is_map && frame.size == ImageSize::new(0, 0) {
        let format = "portable map (PGM or PPM)";
        return Err(DecodeError::Truncated { format, bytes: frame.bytes.len() });
    }
    Ok(())
}

/// Refuses a size without pixels, of which rows would have no end, and one that is too large.
pub(super) fn check_size(size: ImageSize) -> Result<ImageSize, DecodeError> {
    if size.width == 0 || size.height == 0 {
        return Err(DecodeError::NoPixels { size });
    }
    if u64::from(size.width) * u64::from(size.height) > MAX_PIXELS {
        return Err(DecodeError::TooLarge { size });
    }
    Ok(size)
}

/// A JPEG's size, if its bytes can hold it.
fn jpeg_size(bytes: &[u8], header: jpeg::JpegHeader) -> Result<ImageSize, DecodeError> {
    plausible::check_size(header.size, 3, bytes.len())
}

fn jpeg_luma(bytes: &[u8], luma: &mut GrayImage) -> Result<(), DecodeError> {
    let header = jpeg::JpegHeader::read(bytes)?;
    let size = jpeg_size(bytes, header)?;
    let mut pixels = std::mem::take(luma).into_pixels();
    jpeg::luma(bytes, header, &mut pixels)?;
    *luma = GrayImage::from_pixels(size.width as usize, size.height as usize, pixels)
        .unwrap_or_default();
    Ok(())
}

fn luma_from_image(image: &DynamicImage, luma: &mut GrayImage) -> Result<(), DecodeError> {
    luma.reshape(image.width() as usize, image.height() as usize);
    match image {
        DynamicImage::ImageLuma8(gray) => luma.pixels_mut().copy_from_slice(gray),
        DynamicImage::ImageLuma16(gray) => {
            let dropped = bits_to_drop(gray.iter().copied());
            for (value, out) in gray.iter().zip(luma.pixels_mut()) {
                *out = upper_8_bits(*value, dropped);
            }
        }
        DynamicImage::ImageRgb8(rgb) => luma_row_from_rgb(rgb, luma.pixels_mut()),
        other => luma_row_from_rgb(&other.to_rgb8(), luma.pixels_mut()),
    }
    Ok(())
}

/// The values of a row of 16-bit little-endian gray.
fn gray16_values(row: &[u8]) -> impl Iterator<Item = u16> {
    row.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
}

fn bits_to_drop_of(frame: &Frame) -> Result<u32, DecodeError> {
    Ok(bits_to_drop(rows_of(frame)?.flat_map(gray16_values)))
}

fn luma_from_rows(
    frame: &Frame,
    luma: &mut GrayImage,
    convert: impl Fn(&[u8], &mut [u8]),
) -> Result<(), DecodeError> {
    let rows = rows_of(frame)?;
    luma.reshape(frame.size.width as usize, frame.size.height as usize);
    let width = luma.width().max(1);
    for (row, out) in rows.zip(luma.pixels_mut().chunks_exact_mut(width)) {
        convert(row, out);
    }
    Ok(())
}

fn rgb_from_rows(
    frame: &Frame,
    convert: impl Fn(&[u8], &mut [u8]),
) -> Result<RgbImage, DecodeError> {
    let rows = rows_of(frame)?;
    let width = frame.size.width as usize;
    let mut pixels = vec![0; width * frame.size.height as usize * 3];
    for (row, out) in rows.zip(pixels.chunks_exact_mut((width * 3).max(1))) {
        convert(row, out);
    }
    rgb_image(frame.size, pixels)
}

fn rgb_from_nv12(frame: &Frame) -> Result<RgbImage, DecodeError> {
    let (width, height) = (frame.size.width as usize, frame.size.height as usize);
    let mut pixels = vec![0; width * height * 3];
    for (y, (row, out)) in
        rows_of(frame)?.zip(pixels.chunks_exact_mut((width * 3).max(1))).enumerate()
    {
        let chroma = &frame.bytes[(height + y / 2) * frame.stride..];
        rgb_row_from_nv12(row, &chroma[..width.next_multiple_of(2)], out);
    }
    rgb_image(frame.size, pixels)
}

fn rgb_image(size: ImageSize, pixels: Vec<u8>) -> Result<RgbImage, DecodeError> {
    RgbImage::from_raw(size.width, size.height, pixels).ok_or(DecodeError::TooLarge { size })
}

/// The rows of an uncompressed frame, without their padding.
pub(super) fn rows_of(frame: &Frame) -> Result<impl Iterator<Item = &[u8]>, DecodeError> {
    let wrong_kind =
        DecodeError::WrongKind { format: frame.format.name(), wanted: "uncompressed rows" };
    let bytes_per_pixel = frame.format.bytes_per_pixel().ok_or(wrong_kind)?;
    check_size(frame.size)?;
    let row = frame.size.width as usize * bytes_per_pixel;
    let needed = match frame.format {
        PixelFormat::Nv12 => {
            let (width, height) = (frame.size.width.next_multiple_of(2), frame.size.height);
            buffer_length(ImageSize::new(width, height + height.div_ceil(2)), frame.stride, 1)
        }
        _ => buffer_length(frame.size, frame.stride, bytes_per_pixel),
    };
    if frame.stride < row || frame.bytes.len() < needed {
        let (size, format, stride, bytes) =
            (frame.size, frame.format.name(), frame.stride, frame.bytes.len());
        return Err(DecodeError::Buffer { size, format, stride, needed, bytes });
    }
    Ok((0..frame.size.height as usize)
        .map(move |y| &frame.bytes[y * frame.stride..y * frame.stride + row]))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::sync::Arc;

    use super::*;
    use crate::imaging::frame::SensorKind;

    fn frame(format: PixelFormat, size: ImageSize, stride: usize, bytes: &[u8]) -> Frame {
        Frame { sensor: SensorKind::Color, size, format, stride, bytes: Arc::from(bytes) }
    }

    fn file(format: PixelFormat, bytes: &[u8]) -> Frame {
        frame(format, file_size(bytes).unwrap_or(ImageSize::new(0, 0)), 0, bytes)
    }

    fn luma_of(frame: &Frame) -> Result<GrayImage, DecodeError> {
        let mut image = GrayImage::default();
        luma(frame, &mut image).map(|()| image)
    }

    fn ramp(width: usize, height: usize) -> GrayImage {
        let pixels = (0..width * height)
            .map(|k| (40 + 2 * (k % width) + 3 * (k / width)).min(250) as u8)
            .collect();
        GrayImage::from_pixels(width, height, pixels).unwrap()
    }

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn jpeg_round_trip_in_gray_and_color() {
        for (width, height) in [(1, 1), (7, 5), (8, 8), (33, 17), (64, 48)] {
            let image = ramp(width, height);
            let gray = luma_of(&file(PixelFormat::Jpeg, &encode_jpeg(image.view(), 95))).unwrap();
            assert_eq!(gray.size(), image.size());
            let rgb_in = RgbImage::from_fn(width as u32, height as u32, |x, y| {
                let v = image.row(y as usize)[x as usize];
                image::Rgb([v, v, v])
            });
            let colored = file(PixelFormat::Jpeg, &encode_jpeg_rgb(&rgb_in, 95));
            let from_color = luma_of(&colored).unwrap();
            let rgb_out = rgb(&colored).unwrap();
            for (k, value) in image.pixels().iter().enumerate() {
                assert!(gray.pixels()[k].abs_diff(*value) <= 3, "{width}x{height} at {k}");
                assert!(from_color.pixels()[k].abs_diff(*value) <= 3, "{width}x{height} at {k}");
                assert!(rgb_out.as_raw()[3 * k].abs_diff(*value) <= 4, "{width}x{height} at {k}");
            }
        }
    }

    #[test]
    fn an_image_has_the_same_luma_whichever_way_it_comes() {
        let rgb_in =
            RgbImage::from_fn(6, 2, |x, y| image::Rgb([(40 * x) as u8, (90 * y) as u8, 200]));
        let expected: Vec<u8> = rgb_in
            .pixels()
            .map(|p| crate::imaging::pixel_format::luma_from_rgb(p[0], p[1], p[2]))
            .collect();
        let as_png = luma_of(&file(PixelFormat::Png, &png(&rgb_in.clone().into()))).unwrap();
        assert_eq!(as_png.pixels(), expected);
        let with_alpha = DynamicImage::from(rgb_in.clone()).into_rgba8();
        assert_eq!(
            luma_of(&file(PixelFormat::Png, &png(&with_alpha.into()))).unwrap().pixels(),
            expected
        );
        let raw = frame(PixelFormat::Rgb8, ImageSize::new(6, 2), 18, rgb_in.as_raw());
        assert_eq!(luma_of(&raw).unwrap().pixels(), expected);
        let deep = image::ImageBuffer::<image::Luma<u16>, _>::from_vec(2, 1, vec![0x1234, 0xff00])
            .unwrap();
        let deep = file(PixelFormat::Png, &png(&deep.into()));
        assert_eq!(luma_of(&deep).unwrap().pixels(), [0x12, 0xff]);
        assert_eq!(gray16(&deep).unwrap().unwrap().as_raw(), &[0x1234, 0xff00]);
        assert_eq!(gray16(&raw), Ok(None));
    }

    /// Four thousand million rows of nothing, in one byte.
    #[test]
    fn a_frame_without_pixels_is_refused_at_once() {
        for (width, height) in [(0, u32::MAX), (u32::MAX, 0), (0, 0)] {
            for format in [PixelFormat::Mono8, PixelFormat::Mono16, PixelFormat::Nv12] {
                let empty = frame(format, ImageSize::new(width, height), 0, &[1]);
                assert!(matches!(luma_of(&empty), Err(DecodeError::NoPixels { .. })), "{format:?}");
            }
            let depth = frame(PixelFormat::Depth16, ImageSize::new(width, height), 0, &[1]);
            let refused = crate::imaging::depth_image::DepthImage::from_frame(&depth);
            assert!(matches!(refused, Err(DecodeError::NoPixels { .. })));
        }
    }

    #[test]
    fn padding_between_rows_is_left_out() {
        let bytes = [10, 128, 20, 128, 99, 99, 30, 128, 40, 128];
        let yuyv = luma_of(&frame(PixelFormat::Yuyv, ImageSize::new(2, 2), 6, &bytes)).unwrap();
        assert_eq!(yuyv.pixels(), [10, 20, 30, 40]);
        let mono = luma_of(&frame(PixelFormat::Mono8, ImageSize::new(4, 2), 6, &bytes)).unwrap();
        assert_eq!(mono.pixels(), [10, 128, 20, 128, 30, 128, 40, 128]);
        let uyvy = luma_of(&frame(PixelFormat::Uyvy, ImageSize::new(2, 2), 6, &bytes)).unwrap();
        assert_eq!(uyvy.pixels(), [128, 128, 128, 128]);
        let mono16 = luma_of(&frame(PixelFormat::Mono16, ImageSize::new(2, 2), 6, &bytes)).unwrap();
        assert_eq!(mono16.pixels(), [128, 128, 128, 128]);
        let deep = gray16(&frame(PixelFormat::Mono16, ImageSize::new(2, 2), 6, &bytes)).unwrap();
        assert_eq!(deep.unwrap().as_raw(), &[0x800a, 0x8014, 0x801e, 0x8028]);
        let rgb_out = rgb(&frame(PixelFormat::Yuyv, ImageSize::new(2, 2), 6, &bytes)).unwrap();
        assert_eq!(rgb_out.as_raw(), &[10, 10, 10, 20, 20, 20, 30, 30, 30, 40, 40, 40]);
    }

    #[test]
    fn the_two_planes_of_nv12_are_read_in_place() {
        let bytes = [10, 20, 30, 0, 40, 50, 60, 0, 128, 128, 128, 128];
        let nv12 = frame(PixelFormat::Nv12, ImageSize::new(3, 2), 4, &bytes);
        assert_eq!(luma_of(&nv12).unwrap().pixels(), [10, 20, 30, 40, 50, 60]);
        let gray: Vec<u8> = [10, 20, 30, 40, 50, 60].iter().flat_map(|value| [*value; 3]).collect();
        assert_eq!(rgb(&nv12).unwrap().as_raw(), &gray);
        assert!(matches!(
            luma_of(&Frame { size: ImageSize::new(3, 3), ..nv12 }),
            Err(DecodeError::Buffer { .. })
        ));
    }

    #[test]
    fn a_file_cut_anywhere_is_refused_and_never_panics() {
        let jpeg = encode_jpeg(ramp(64, 48).view(), 90);
        for cut in 0..jpeg.len() - 3 {
            let error = luma_of(&file(PixelFormat::Jpeg, &jpeg[..cut])).unwrap_err();
            assert!(!error.to_string().contains('\n'), "{error}");
        }
        let png = png(&ramp_rgb().into());
        for cut in 0..png.len() - 13 {
            assert!(
                luma_of(&file(PixelFormat::Png, &png[..cut])).is_err(),
                "at {cut} of {}",
                png.len()
            );
        }
    }

    fn ramp_rgb() -> RgbImage {
        RgbImage::from_fn(20, 15, |x, y| {
            image::Rgb([(x * 12) as u8, (y * 16) as u8, (x * y) as u8])
        })
    }

    #[test]
    fn any_byte_may_be_wrong_without_a_panic() {
        for whole in [encode_jpeg(ramp(24, 16).view(), 80), png(&ramp_rgb().into())] {
            for at in 0..whole.len() {
                for value in [0, 0xff, whole[at] ^ 0x10] {
                    let mut bytes = whole.clone();
                    bytes[at] = value;
                    let format = PixelFormat::of_file(&bytes).unwrap_or(PixelFormat::Jpeg);
                    let _ = luma_of(&file(format, &bytes));
                    let _ = rgb(&file(format, &bytes));
                }
            }
        }
    }

    #[test]
    fn a_header_that_promises_too_much_is_refused_before_anything_is_allocated() {
        let mut jpeg = encode_jpeg(ramp(8, 8).view(), 90);
        let at = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
        jpeg[at + 5..at + 9].copy_from_slice(&[0x37, 0x1b, 0x37, 0x1b]);
        let mut png = png(&ramp_rgb().into());
        png[16..24].copy_from_slice(&[0, 0, 0x37, 0x1b, 0, 0, 0x37, 0x1b]);
        for (format, bytes) in [(PixelFormat::Jpeg, &jpeg), (PixelFormat::Png, &png)] {
            let error = luma_of(&file(format, bytes)).unwrap_err();
            assert_eq!(error, DecodeError::TooLarge { size: ImageSize::new(14107, 14107) });
        }
    }

    #[test]
    fn buffers_that_are_too_short_are_refused() {
        let size = ImageSize::new(4, 2);
        for (format, stride, length) in [
            (PixelFormat::Mono8, 4, 7),
            (PixelFormat::Mono8, 3, 8),
            (PixelFormat::Yuyv, 8, 15),
            (PixelFormat::Mono16, 8, 15),
            (PixelFormat::Nv12, 4, 11),
            (PixelFormat::Rgb8, 12, 23),
        ] {
            let error = luma_of(&frame(format, size, stride, &vec![0; length])).unwrap_err();
            assert!(matches!(error, DecodeError::Buffer { .. }), "{error}");
        }
        let depth = frame(PixelFormat::Depth16, size, 8, &[0; 16]);
        assert!(matches!(luma_of(&depth), Err(DecodeError::WrongKind { .. })));
    }
}
