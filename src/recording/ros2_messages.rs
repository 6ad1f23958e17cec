//! Frames as ROS 2 messages: the topics and types that drivers publish, in CDR.
//!
//! The color sensor of camera `front` is `/front/image_raw` in `front_optical_frame` (REP 103),
//! its others `/front/depth/image_rect_raw`, `/front/infra1/image_rect_raw` and so on.

use crate::geometry::depth_camera::DepthReading;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::rectification::RectifiedCamera;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::{Frame, PixelFormat, SensorKind};

pub(super) const IMAGE: &str = "sensor_msgs/msg/Image";
pub(super) const COMPRESSED_IMAGE: &str = "sensor_msgs/msg/CompressedImage";
pub(super) const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";

/// What image_transport puts before a compressed depth image: its format (0, which it also writes
/// for depths of 16 bits, stored as they are) and two numbers of the other encoding.
const COMPRESSED_DEPTH_HEADER: [u8; 12] = [0; 12];

/// A message, and where it goes.
#[derive(Debug, Clone)]
pub(super) struct Ros2Message {
    pub topic: String,
    pub type_name: &'static str,
    pub bytes: Vec<u8>,
}

/// The frame of `camera` as a message, taken at `utc_ns`.
pub(super) fn image(frame: &Frame, camera: &str, utc_ns: i64) -> Option<Ros2Message> {
    let base = format!("{}/{}", namespace(camera, frame.sensor), image_name(frame.sensor));
    let mut cdr = Cdr::with_header(utc_ns, &frame_id(camera, frame.sensor));
    if let PixelFormat::Jpeg | PixelFormat::Png = frame.format {
        let is_depth = frame.sensor == SensorKind::Depth && frame.format == PixelFormat::Png;
        let topic = format!("{base}/{}", if is_depth { "compressedDepth" } else { "compressed" });
        if is_depth {
            cdr.text("16UC1; compressedDepth png");
            cdr.bytes(&[&COMPRESSED_DEPTH_HEADER, &*frame.bytes]);
        } else {
            cdr.text(frame.format.name());
            cdr.bytes(&[&frame.bytes]);
        }
        return Some(Ros2Message { topic, type_name: COMPRESSED_IMAGE, bytes: cdr.0 });
    }
    cdr.u32(frame.size.height);
    cdr.u32(frame.size.width);
    cdr.text(encoding(frame.format));
    cdr.0.push(0);
    cdr.u32(u32::try_from(frame.stride).ok()?);
    cdr.bytes(&[&frame.bytes]);
    Some(Ros2Message { topic: base, type_name: IMAGE, bytes: cdr.0 })
}

/// The depth image of `camera` as 32FC1, in meters; what is no distance is NaN (REP 118). `None` for
/// what is no depth image.
pub(super) fn depth_in_meters(
    frame: &Frame,
    camera: &str,
    utc_ns: i64,
    reading: DepthReading,
    invalid: Option<u16>,
) -> Option<Ros2Message> {
    let depth = DepthImage::from_frame(frame).ok()?;
    let meters = |value: &u16| {
        let inverse = reading.inverse_depth(f64::from(*value));
        inverse
            .filter(|_| Some(*value) != invalid)
            .map_or(f32::NAN, |inverse| (1.0 / inverse) as f32)
    };
    let data: Vec<u8> = depth.readings().iter().flat_map(|v| meters(v).to_le_bytes()).collect();
    let size = depth.size();
    let mut cdr = Cdr::with_header(utc_ns, &frame_id(camera, frame.sensor));
    cdr.u32(size.height);
    cdr.u32(size.width);
    cdr.text("32FC1");
    cdr.0.push(0);
    cdr.u32(size.width.checked_mul(4)?);
    cdr.bytes(&[&data]);
    let topic = format!("{}/{}", namespace(camera, frame.sensor), image_name(frame.sensor));
    Some(Ros2Message { topic, type_name: IMAGE, bytes: cdr.0 })
}

/// What is stated of a sensor's lens, as `camera_info`; `None` for a model that ROS has not. How
/// its images are rectified is not stated: P has the camera matrix.
pub(super) fn camera_info(
    camera: &str,
    sensor: SensorKind,
    lens: &Lens,
    size: ImageSize,
    utc_ns: i64,
) -> Option<Ros2Message> {
    let rectified = RectifiedCamera::alone(&lens.matrix);
    let bytes = camera_info_in(&frame_id(camera, sensor), lens, size, &rectified, utc_ns)?;
    let topic = format!("{}/camera_info", namespace(camera, sensor));
    Some(Ros2Message { topic, type_name: CAMERA_INFO, bytes })
}

/// The same in any frame, with the camera's rectification.
pub(super) fn camera_info_in(
    frame_id: &str,
    lens: &Lens,
    size: ImageSize,
    rectified: &RectifiedCamera,
    utc_ns: i64,
) -> Option<Vec<u8>> {
    let m = lens.matrix;
    let known = lens.model().facts().camera_info?;
    let distortion = lens.distortion.padded_coefficients(known.coefficients);
    let mut cdr = Cdr::with_header(utc_ns, frame_id);
    cdr.u32(size.height);
    cdr.u32(size.width);
    cdr.text(known.ros);
    cdr.u32(distortion.len() as u32);
    distortion.iter().for_each(|d| cdr.f64(*d));
    let matrix = [m.fx, m.skew, m.cx, 0.0, m.fy, m.cy, 0.0, 0.0, 1.0];
    // Row by row.
    let rotation = rectified.rectified_from_camera.transpose();
    let projection = rectified.projection.transpose();
    for value in matrix.iter().chain(rotation.iter()).chain(projection.iter()) {
        cdr.f64(*value);
    }
    // No binning, and the region of interest is the whole image.
    (0..6).for_each(|_| cdr.u32(0));
    cdr.0.push(0);
    Some(cdr.0)
}

pub(super) fn namespace(camera: &str, sensor: SensorKind) -> String {
    match sensor {
        SensorKind::Color => format!("/{camera}"),
        SensorKind::Infrared => format!("/{camera}/infra1"),
        SensorKind::Infrared2 => format!("/{camera}/infra2"),
        SensorKind::Depth => format!("/{camera}/depth"),
    }
}

fn image_name(sensor: SensorKind) -> &'static str {
    if sensor == SensorKind::Color { "image_raw" } else { "image_rect_raw" }
}

pub(super) fn frame_id(camera: &str, sensor: SensorKind) -> String {
    sensor.optical_frame(camera)
}

/// The name in `sensor_msgs/image_encodings.hpp`.
fn encoding(format: PixelFormat) -> &'static str {
    match format {
        PixelFormat::Yuyv => "yuv422_yuy2",
        PixelFormat::Uyvy => "yuv422",
        other => other.name(),
    }
}

/// The definition of a type with those that it is made of, as `ros2msg` schemas hold them.
pub(super) fn definition(type_name: &str) -> String {
    let own = match type_name {
        IMAGE => {
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n"
        }
        COMPRESSED_IMAGE => "std_msgs/Header header\nstring format\nuint8[] data\n",
        _ => {
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi\n"
        }
    };
    let part = |name: &str, fields: &str| format!("{}\nMSG: {name}\n{fields}", "=".repeat(80));
    let mut text = own.to_owned()
        + &part("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n")
        + &part("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
    if type_name == CAMERA_INFO {
        let fields =
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n";
        text += &part("sensor_msgs/RegionOfInterest", fields);
    }
    text
}

/// A `builtin_interfaces/Time`: seconds and nanoseconds.
pub(super) fn stamp(utc_ns: i64) -> [u32; 2] {
    let utc_ns = utc_ns.max(0);
    let seconds = u32::try_from(utc_ns / 1_000_000_000).unwrap_or(u32::MAX);
    [seconds, (utc_ns % 1_000_000_000) as u32]
}

/// A message in little-endian CDR.
pub(super) struct Cdr(pub(super) Vec<u8>);

impl Cdr {
    /// Begins with the four bytes that state the encoding.
    pub(super) fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    /// Begins with a `std_msgs/Header`.
    pub(super) fn with_header(utc_ns: i64, frame_id: &str) -> Self {
        let mut cdr = Self::new();
        cdr.header(utc_ns, frame_id);
        cdr
    }

    /// A `std_msgs/Header`.
    pub(super) fn header(&mut self, utc_ns: i64, frame_id: &str) {
        stamp(utc_ns).iter().for_each(|value| self.u32(*value));
        self.text(frame_id);
    }

    /// Numbers begin at a multiple of their length, counted after the first four bytes.
    fn align(&mut self, length: usize) {
        let end = 4 + (self.0.len() - 4).next_multiple_of(length);
        self.0.resize(end, 0);
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    pub(super) fn bytes(&mut self, parts: &[&[u8]]) {
        self.u32(parts.iter().map(|part| part.len()).sum::<usize>() as u32);
        parts.iter().for_each(|part| self.0.extend_from_slice(part));
    }
}
