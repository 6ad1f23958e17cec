//! What a camera gives: a [`Frame`] is one image as it came, a [`FrameSet`] the images taken
//! together.

use std::sync::Arc;

use crate::geometry::pixel::ImageSize;
use crate::imaging::timestamp::{DeviceTime, HostTime};

/// Which of a camera's sensors. A camera with one sensor has it as `Color`, gray or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SensorKind {
    /// The visible image.
    Color,
    /// The infrared image, taken by the depth camera; of a stereo depth camera the left one, from
    /// which depth is measured.
    Infrared,
    /// The right infrared image of a stereo depth camera.
    Infrared2,
    /// Distance, or disparity, per pixel.
    Depth,
}

impl SensorKind {
    /// Every sensor, in the order of documents.
    pub const ALL: [Self; 4] = [Self::Color, Self::Infrared, Self::Infrared2, Self::Depth];

    /// The left and the right image of a stereo depth camera.
    pub const STEREO_PAIR: [Self; 2] = [Self::Infrared, Self::Infrared2];

    /// Its name in topics, documents and folders.
    pub fn name(self) -> &'static str {
        match self {
            Self::Color => "color",
            Self::Infrared => "infrared",
            Self::Infrared2 => "infrared2",
            Self::Depth => "depth",
        }
    }

    /// Whether it measures light, and not distance.
    pub fn is_image(self) -> bool {
        self != Self::Depth
    }

    /// Whether its image is the one that depth is measured in.
    pub fn is_of_depth(self) -> bool {
        self == Self::Infrared
    }

    /// What ROS calls the optical frame (x right, y down, z forward: REP 103) of this sensor of
    /// `camera`; a camera's own is its color sensor's.
    pub fn optical_frame(self, camera: &str) -> String {
        match self {
            Self::Color => format!("{camera}_optical_frame"),
            other => format!("{camera}_{}_optical_frame", other.name()),
        }
    }

    /// The sensor with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sensor| sensor.name() == name)
    }
}

/// How a frame's bytes encode its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// A JPEG file (also a UVC camera's MJPG frame).
    Jpeg,
    /// A PNG file: 8-bit gray or color; for depth 16-bit gray.
    Png,
    /// 8-bit gray rows.
    Mono8,
    /// 16-bit little-endian gray rows that use the whole range.
    Mono16,
    /// Interleaved Y U Y V.
    Yuyv,
    /// Interleaved U Y V Y.
    Uyvy,
    /// Rows of Y, then half as many rows of interleaved U V, all with the same stride.
    Nv12,
    /// 16-bit little-endian depth or disparity.
    Depth16,
    /// Interleaved 8-bit red, green, blue.
    Rgb8,
    /// Interleaved 8-bit blue, green, red.
    Bgr8,
}

/// One image of one sensor, as it came: nothing is decoded before someone needs it.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Which sensor took it.
    pub sensor: SensorKind,
    /// Its size in pixels.
    pub size: ImageSize,
    /// How `bytes` encode it.
    pub format: PixelFormat,
    /// Bytes from one row to the next, for uncompressed formats; 0 for files.
    pub stride: usize,
    /// The encoded pixels, shared between preview, detector and recorder.
    pub bytes: Arc<[u8]>,
}

/// The frames that a device took together.
#[derive(Debug, Clone)]
pub struct FrameSet {
    /// Counts the device's frame sets; a gap is a lost one.
    pub sequence: u64,
    /// When the host received it.
    pub host_time: HostTime,
    /// When the device took it, where it says so.
    pub device_time: Option<DeviceTime>,
    /// A name where the source has names (a file's path).
    pub name: Option<String>,
    /// One frame per sensor that delivered.
    pub frames: Vec<Frame>,
}

impl FrameSet {
    /// The frame of `sensor`, if it is in this set.
    pub fn frame(&self, sensor: SensorKind) -> Option<&Frame> {
        self.frames.iter().find(|frame| frame.sensor == sensor)
    }
}
