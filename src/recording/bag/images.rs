//! `sensor_msgs/Image` and `sensor_msgs/CompressedImage` as frames.

use crate::geometry::pixel::ImageSize;
use crate::imaging::bayer::{BayerPattern, rgb_from_bayer};
use crate::imaging::decode::file_size;
use crate::imaging::deep_gray::{bits_to_drop, upper_8_bits};
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::{Frame, PixelFormat, SensorKind};
use crate::recording::bag::image_error::RosImageError;
use crate::recording::bag::storage::{BagTopic, RosHeader};
use crate::recording::bag::topics::{ImageTopic, Transport};
use crate::recording::fields::{Fields, TooShort};

/// What image_transport puts before a compressed depth image: a format and two floats.
const DEPTH_HEADER_BYTES: usize = 12;

/// The frame that a message holds.
pub(super) fn read(
    topic: &BagTopic,
    image: ImageTopic,
    message: &[u8],
) -> Result<(RosHeader, Frame), RosImageError> {
    let short = |fault| RosImageError::Message { message_type: topic.message_type.clone(), fault };
    let mut fields = topic.layout.fields(message).map_err(short)?;
    let header = RosHeader::read(topic.layout, &mut fields).map_err(short)?;
    let frame = match image.transport {
        Transport::Raw => {
            let raw = RawImage::read(&mut fields).map_err(short)?;
            raw.frame(image)?
        }
        Transport::Compressed | Transport::CompressedDepth => {
            let format = fields.text().map_err(short)?;
            let data = fields.bytes().map_err(short)?;
            compressed(image, &format, data)?
        }
    };
    Ok((header, frame))
}

/// The fields of `sensor_msgs/Image` after its header.
struct RawImage<'a> {
    size: ImageSize,
    encoding: String,
    big_endian: bool,
    step: usize,
    data: &'a [u8],
}

impl<'a> RawImage<'a> {
    fn read(fields: &mut Fields<'a>) -> Result<Self, TooShort> {
        let (height, width) = (fields.u32()?, fields.u32()?);
        Ok(Self {
            size: ImageSize::new(width, height),
            encoding: fields.text()?,
            big_endian: fields.u8()? != 0,
            step: fields.length()?,
            data: fields.bytes()?,
        })
    }

    fn frame(&self, image: ImageTopic) -> Result<Frame, RosImageError> {
        let depth = image.sensor == SensorKind::Depth || !image.named;
        let as_it_is = |format| Ok(self.with(image.sensor, format, self.step, self.data.into()));
        match self.encoding.as_str() {
            "mono8" | "8UC1" => as_it_is(PixelFormat::Mono8),
            "rgb8" => as_it_is(PixelFormat::Rgb8),
            "bgr8" | "8UC3" => as_it_is(PixelFormat::Bgr8),
            "yuv422_yuy2" | "yuyv" => as_it_is(PixelFormat::Yuyv),
            "yuv422" | "uyvy" => as_it_is(PixelFormat::Uyvy),
            "nv12" => as_it_is(PixelFormat::Nv12),
            "rgba8" => self.without_alpha(image.sensor, PixelFormat::Rgb8),
            "bgra8" | "8UC4" => self.without_alpha(image.sensor, PixelFormat::Bgr8),
            "mono16" if image.sensor != SensorKind::Depth => {
                Ok(self.sixteen_bits(image.sensor, PixelFormat::Mono16))
            }
            "16UC1" | "mono16" if depth => {
                Ok(self.sixteen_bits(SensorKind::Depth, PixelFormat::Depth16))
            }
            "16UC1" => Ok(self.sixteen_bits(image.sensor, PixelFormat::Mono16)),
            "32FC1" if depth => self.meters(),
            other => match BayerPattern::from_name(other) {
                Some((pattern, bytes_per_pixel)) => {
                    self.bayer(image.sensor, pattern, bytes_per_pixel)
                }
                None => Err(RosImageError::UnknownEncoding { encoding: other.to_owned() }),
            },
        }
    }

    fn with(
        &self,
        sensor: SensorKind,
        format: PixelFormat,
        stride: usize,
        bytes: Vec<u8>,
    ) -> Frame {
        Frame { sensor, size: self.size, format, stride, bytes: bytes.into() }
    }

    /// The rows, each of width × `bytes_per_pixel` bytes.
    fn rows(
        &self,
        bytes_per_pixel: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>, RosImageError> {
        if self.size.width == 0 || self.size.height == 0 {
            let encoding = self.encoding.clone();
            return Err(RosImageError::NoPixels { encoding, size: self.size });
        }
        let row = self.size.width as usize * bytes_per_pixel;
        let height = self.size.height as usize;
        let needed = height
            .checked_sub(1)
            .map_or(Some(0), |rows| self.step.checked_mul(rows)?.checked_add(row));
        if self.step < row || needed.is_none_or(|needed| needed > self.data.len()) {
            return Err(RosImageError::TooFewBytes {
                size: self.size,
                encoding: self.encoding.clone(),
                step_bytes: self.step,
                data_bytes: self.data.len(),
            });
        }
        let (data, step) = (self.data, self.step);
        Ok((0..height).map(move |y| &data[y * step..y * step + row]))
    }

    fn without_alpha(
        &self,
        sensor: SensorKind,
        format: PixelFormat,
    ) -> Result<Frame, RosImageError> {
        let of_row =
            |row: &'a [u8]| row.chunks_exact(4).flat_map(|pixel| pixel[..3].iter().copied());
        let bytes = self.rows(4)?.flat_map(of_row).collect();
        Ok(self.with(sensor, format, self.size.width as usize * 3, bytes))
    }

    fn sixteen_bits(&self, sensor: SensorKind, format: PixelFormat) -> Frame {
        let mut bytes = self.data.to_vec();
        if self.big_endian {
            bytes.chunks_exact_mut(2).for_each(|pair| pair.swap(0, 1));
        }
        self.with(sensor, format, self.step, bytes)
    }

    /// Depth in meters as 16-bit millimeters; what is no distance is 0, no reading.
    fn meters(&self) -> Result<Frame, RosImageError> {
        let of_pixel = |four: &[u8]| {
            let bytes: [u8; 4] = std::array::from_fn(|k| four[k]);
            let meters =
                if self.big_endian { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) };
            millimeters(f64::from(meters)).to_le_bytes()
        };
        let bytes = self.rows(4)?.flat_map(|row| row.chunks_exact(4).flat_map(of_pixel)).collect();
        Ok(self.with(SensorKind::Depth, PixelFormat::Depth16, self.size.width as usize * 2, bytes))
    }

    fn bayer(
        &self,
        sensor: SensorKind,
        pattern: BayerPattern,
        bytes_per_pixel: usize,
    ) -> Result<Frame, RosImageError> {
        let mosaic: Vec<u8> = if bytes_per_pixel == 1 {
            self.rows(1)?.flatten().copied().collect()
        } else {
            let upper = usize::from(!self.big_endian);
            let value = |two: &[u8]| u16::from_be_bytes([two[upper], two[1 - upper]]);
            let values: Vec<u16> =
                self.rows(2)?.flat_map(|row| row.chunks_exact(2).map(value)).collect();
            let dropped = bits_to_drop(values.iter().copied());
            values.into_iter().map(|value| upper_8_bits(value, dropped)).collect()
        };
        let rgb = rgb_from_bayer(&mosaic, self.size, pattern);
        Ok(self.with(sensor, PixelFormat::Rgb8, self.size.width as usize * 3, rgb))
    }
}

fn millimeters(meters: f64) -> u16 {
    let millimeters = (meters * 1000.0).round();
    if millimeters >= 1.0 && millimeters <= f64::from(u16::MAX) { millimeters as u16 } else { 0 }
}

fn compressed(image: ImageTopic, format: &str, data: &[u8]) -> Result<Frame, RosImageError> {
    let of_depth =
        image.transport == Transport::CompressedDepth || format.contains("compressedDepth");
    if of_depth {
        return compressed_depth(format, data);
    }
    let pixels = PixelFormat::of_file(data)
        .ok_or_else(|| RosImageError::UnknownCompression { format: format.to_owned() })?;
    let size = file_size(data).unwrap_or(ImageSize::new(0, 0));
    let is_deep = pixels == PixelFormat::Png && format.starts_with("16UC1") && !image.named;
    let sensor = if is_deep { SensorKind::Depth } else { image.sensor };
    Ok(Frame { sensor, size, format: pixels, stride: 0, bytes: data.into() })
}

/// What compressed_depth_image_transport sends: after its header a PNG of millimeters, or for
/// 32FC1 of inverse depths, meters = a / (value - b) with a and b from the header.
fn compressed_depth(format: &str, data: &[u8]) -> Result<Frame, RosImageError> {
    let not_png = || RosImageError::DepthWithoutPng { format: format.to_owned() };
    let png = data.get(DEPTH_HEADER_BYTES..).ok_or_else(not_png)?;
    if PixelFormat::of_file(png) != Some(PixelFormat::Png) {
        return Err(not_png());
    }
    let size = file_size(png).unwrap_or(ImageSize::new(0, 0));
    let mut frame = Frame {
        sensor: SensorKind::Depth,
        size,
        format: PixelFormat::Png,
        stride: 0,
        bytes: png.into(),
    };
    if format.starts_with("32FC1") {
        let coefficient =
            |at: usize| f64::from(f32::from_le_bytes(std::array::from_fn(|k| data[at + k])));
        let (a, b) = (coefficient(4), coefficient(8));
        let image = DepthImage::from_frame(&frame)?;
        let meters = |value: &u16| if *value == 0 { 0.0 } else { a / (f64::from(*value) - b) };
        let bytes: Vec<u8> = image
            .readings()
            .iter()
            .flat_map(|value| millimeters(meters(value)).to_le_bytes())
            .collect();
        (frame.format, frame.stride, frame.bytes) =
            (PixelFormat::Depth16, size.width as usize * 2, bytes.into());
    }
    Ok(frame)
}
