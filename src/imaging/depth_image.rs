//! Depth images: 16-bit readings per pixel, as the device gave them.

use crate::geometry::pixel::ImageSize;
use crate::imaging::decode::{DecodeError, check_bytes, check_size};
use crate::imaging::frame::{Frame, PixelFormat};
use crate::imaging::pixel_format::buffer_length;
use crate::imaging::png;

/// An image of readings: distance or disparity, in the device's own unit.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DepthImage {
    width: usize,
    readings: Vec<u16>,
}

impl DepthImage {
    /// `readings` row by row; `None` unless there are width × height of them.
    pub fn new(size: ImageSize, readings: Vec<u16>) -> Option<Self> {
        let expected = size.width as usize * size.height as usize;
        (expected > 0 && readings.len() == expected)
            .then_some(Self { width: size.width as usize, readings })
    }

    /// The readings of a frame: 16-bit PNG, or rows of 16 bits.
    ///
    /// # Errors
    /// [`DecodeError`] for what is no 16-bit image, or a damaged one.
    pub fn from_frame(frame: &Frame) -> Result<Self, DecodeError> {
        check_bytes(frame)?;
        let wrong = DecodeError::NotDepth { format: frame.format.name() };
        match frame.format {
            PixelFormat::Png => match png::decode(&frame.bytes)? {
                image::DynamicImage::ImageLuma16(image) => {
                    let size = ImageSize::new(image.width(), image.height());
                    Self::new(size, image.into_raw()).ok_or(DecodeError::Empty)
                }
                _ => Err(wrong),
            },
            PixelFormat::Depth16 | PixelFormat::Mono16 => Self::from_rows(frame),
            _ => Err(wrong),
        }
    }

    fn from_rows(frame: &Frame) -> Result<Self, DecodeError> {
        let Frame { size, stride, .. } = *frame;
        check_size(size)?;
        let (needed, bytes) = (buffer_length(size, stride, 2), frame.bytes.len());
        let row_bytes = 2 * size.width as usize;
        if bytes < needed || stride < row_bytes {
            return Err(DecodeError::Buffer {
                size,
                format: frame.format.name(),
                stride,
                needed,
                bytes,
            });
        }
        let rows =
            (0..size.height as usize).map(|y| &frame.bytes[y * stride..y * stride + row_bytes]);
        let readings = rows
            .flat_map(|row| row.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]])));
        Self::new(size, readings.collect()).ok_or(DecodeError::Empty)
    }

    /// The image as a 16-bit gray PNG file.
    pub fn to_png(&self) -> Vec<u8> {
        let size = self.size();
        let bytes: Vec<u8> =
            self.readings.iter().flat_map(|reading| reading.to_ne_bytes()).collect();
        let mut file = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut file);
        let written = image::ImageEncoder::write_image(
            encoder,
            &bytes,
            size.width,
            size.height,
            image::ExtendedColorType::L16,
        );
        debug_assert!(written.is_ok(), "a PNG is written to memory");
        file
    }

    /// Its size.
    pub fn size(&self) -> ImageSize {
        let height = self.readings.len().checked_div(self.width).unwrap_or(0);
        ImageSize::new(self.width as u32, height as u32)
    }

    /// One row.
    pub fn row(&self, y: usize) -> &[u16] {
        &self.readings[y * self.width..(y + 1) * self.width]
    }

    /// All readings, row by row.
    pub fn readings(&self) -> &[u16] {
        &self.readings
    }

    /// The reading that every pixel has, where all have the same.
    pub fn only_reading(&self) -> Option<u16> {
        let first = *self.readings.first()?;
        self.readings.iter().all(|reading| *reading == first).then_some(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::frame::SensorKind;
    use crate::imaging::image_file::frame_from_file;

    #[test]
    fn a_png_keeps_every_reading() {
        let readings: Vec<u16> = (0..12).map(|k| k * 5461).collect();
        let image = DepthImage::new(ImageSize::new(4, 3), readings).unwrap();
        let frame = frame_from_file(SensorKind::Depth, image.to_png());
        assert_eq!(DepthImage::from_frame(&frame).unwrap(), image);
    }

    #[test]
    fn what_is_not_depth_is_refused_in_one_line() {
        let gray = frame_from_file(SensorKind::Depth, b"P5 2 1 255\n\x07\xff".to_vec());
        let mut short =
            frame_from_file(SensorKind::Depth, b"P5 2 1 4095\n\x01\x02\xff\xfe".to_vec());
        assert_eq!(DepthImage::from_frame(&short).unwrap().readings(), [0x0102, 0xfffe]);
        short.bytes = short.bytes[..3].into();
        // Only what is whole and no depth may be color in its place.
        for (frame, may_be_color) in [(gray, true), (short, false)] {
            let line = DepthImage::from_frame(&frame).unwrap_err().to_string();
            assert!(!line.is_empty() && !line.contains('\n'), "{line}");
            assert_eq!(line.contains("not swapped"), may_be_color, "{line}");
        }
    }
}
