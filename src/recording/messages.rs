//! Frames as Foxglove messages: which schema, which topic, which encoding.

use foxglove::bytes::Bytes;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, Quaternion, RawImage, Timestamp, Vector3,
};
use foxglove::{Decode, Encode};

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Distortion, Lens, LensModel};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::decode::file_size;
use crate::imaging::frame::{Frame, PixelFormat, SensorKind};

pub(super) const COMPRESSED_IMAGE: &str = "foxglove.CompressedImage";
pub(super) const RAW_IMAGE: &str = "foxglove.RawImage";
pub(super) const CAMERA_CALIBRATION: &str = "foxglove.CameraCalibration";
pub(super) const FRAME_TRANSFORM: &str = "foxglove.FrameTransform";

/// A message that can be written: its schema's name and descriptor, and its bytes.
#[derive(Debug, Clone)]
pub(super) struct Encoded {
    pub schema: &'static str,
    pub descriptor: Vec<u8>,
    pub bytes: Vec<u8>,
}

/// What a topic carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Topic {
    /// `/<camera>/<sensor>`: its frames.
    Frames { camera: String, sensor: SensorKind },
    /// `/<camera>/<sensor>/calibration`: what the device says of its lens.
    Calibration { camera: String, sensor: SensorKind },
    /// `/<camera>/<sensor>/transform`: where the device says that it is from color.
    Transform { camera: String, sensor: SensorKind },
}

impl Topic {
    /// What the topic `name` carries; `None` for any that Plumb does not know.
    pub(super) fn parse(name: &str) -> Option<Self> {
        let name = name.strip_prefix('/').unwrap_or(name);
        // Names become part of one-line messages.
        if name.contains(char::is_control) {
            return None;
        }
        let of = |name: &str| {
            let (camera, sensor) = name.rsplit_once('/')?;
            Some((camera.to_owned(), SensorKind::from_name(sensor)?))
        };
        if let Some(name) = name.strip_suffix("/calibration") {
            let (camera, sensor) = of(name)?;
            return Some(Self::Calibration { camera, sensor });
        }
        if let Some(name) = name.strip_suffix("/transform") {
            let (camera, sensor) = of(name)?;
            return Some(Self::Transform { camera, sensor });
        }
        let (camera, sensor) = of(name)?;
        Some(Self::Frames { camera, sensor })
    }

    /// Its name.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Frames { camera, sensor } => format!("/{camera}/{}", sensor.name()),
            Self::Calibration { camera, sensor } => {
                format!("/{camera}/{}/calibration", sensor.name())
            }
            Self::Transform { camera, sensor } => {
                format!("/{camera}/{}/transform", sensor.name())
            }
        }
    }

    /// Whose it is.
    pub(super) fn camera(&self) -> &str {
        match self {
            Self::Frames { camera, .. }
            | Self::Calibration { camera, .. }
            | Self::Transform { camera, .. } => camera,
        }
    }
}

/// The frame's message, taken at `utc_ns`.
pub(super) fn encode_frame(frame: &Frame, frame_id: &str, utc_ns: i64) -> Option<Encoded> {
    let timestamp = Some(timestamp(utc_ns));
    let data = Bytes::copy_from_slice(&frame.bytes);
    let frame_id = frame_id.to_owned();
    match frame.format {
        PixelFormat::Jpeg | PixelFormat::Png => encoded(
            COMPRESSED_IMAGE,
            &CompressedImage { timestamp, frame_id, data, format: frame.format.name().into() },
        ),
        _ => {
            let ImageSize { width, height } = frame.size;
            let (encoding, step) =
                (frame.format.name().to_owned(), u32::try_from(frame.stride).ok()?);
            encoded(
                RAW_IMAGE,
                &RawImage { timestamp, frame_id, width, height, encoding, step, data },
            )
        }
    }
}

/// The message that says what a device states of its lens.
pub(super) fn encode_lens(
    lens: &Lens,
    size: ImageSize,
    frame_id: &str,
    utc_ns: i64,
) -> Option<Encoded> {
    let m = lens.matrix;
    let known = lens.model().facts().camera_info?;
    let distortion_model = known.foxglove;
    let d = lens.distortion.padded_coefficients(known.coefficients);
    let message = CameraCalibration {
        timestamp: Some(timestamp(utc_ns)),
        frame_id: frame_id.to_owned(),
        width: size.width,
        height: size.height,
        distortion_model: distortion_model.to_owned(),
        d,
        k: vec![m.fx, m.skew, m.cx, 0.0, m.fy, m.cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![m.fx, m.skew, m.cx, 0.0, 0.0, m.fy, m.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    };
    encoded(CAMERA_CALIBRATION, &message)
}

/// The message that says where a device states a sensor to be from its color sensor.
pub(super) fn encode_pose(
    color_from_sensor: &Pose,
    [color_frame_id, sensor_frame_id]: [String; 2],
    utc_ns: i64,
) -> Option<Encoded> {
    let (t, q) = (color_from_sensor.translation(), color_from_sensor.rotation().into_inner());
    let message = FrameTransform {
        timestamp: Some(timestamp(utc_ns)),
        parent_frame_id: color_frame_id,
        child_frame_id: sensor_frame_id,
        translation: Some(Vector3 { x: t.x, y: t.y, z: t.z }),
        rotation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    };
    encoded(FRAME_TRANSFORM, &message)
}

/// The pose of a sensor in color's frame that a transform states; `None` if it states none.
pub(super) fn decode_pose(bytes: &[u8]) -> Option<Pose> {
    let message = FrameTransform::decode(bytes).ok()?;
    let (t, q) = (message.translation?, message.rotation?);
    let quaternion = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z);
    let translation = nalgebra::Vector3::new(t.x, t.y, t.z);
    let is_pose = (0.9..1.1).contains(&quaternion.norm()) && translation.norm().is_finite();
    is_pose.then(|| Pose::new(nalgebra::UnitQuaternion::from_quaternion(quaternion), translation))
}

/// Why a message of Foxglove has no image that is read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum FoxgloveImageError {
    /// Its bytes are no such message.
    #[error("{detail}")]
    Message { detail: String },
    /// A compressed image that is neither JPEG nor PNG.
    #[error("images compressed as {format:?}, not jpeg or png")]
    UnknownCompression { format: String },
    /// Pixels in an encoding that is not read.
    #[error(
        "raw images encoded as {encoding:?}, not mono8, mono16, yuyv, uyvy, nv12, rgb8, bgr8 or 16UC1"
    )]
    UnknownEncoding { encoding: String },
    /// No message with an image.
    #[error("messages of schema {schema:?}, not {COMPRESSED_IMAGE} or {RAW_IMAGE}")]
    UnknownSchema { schema: String },
}

/// The frame that a message of `schema` holds.
pub(super) fn decode_frame(
    schema: &str,
    sensor: SensorKind,
    bytes: &[u8],
) -> Result<Frame, FoxgloveImageError> {
    match schema {
        COMPRESSED_IMAGE => {
            let message = CompressedImage::decode(bytes)
                .map_err(|error| FoxgloveImageError::Message { detail: error.to_string() })?;
            let format = match message.format.to_ascii_lowercase().as_str() {
                "png" => PixelFormat::Png,
                text if text.contains("jpeg") || text.contains("jpg") => PixelFormat::Jpeg,
                other => {
                    let format = other.to_owned();
                    return Err(FoxgloveImageError::UnknownCompression { format });
                }
            };
            let size = file_size(&message.data).unwrap_or(ImageSize::new(0, 0));
            Ok(Frame { sensor, size, format, stride: 0, bytes: message.data.as_ref().into() })
        }
        RAW_IMAGE => {
            let message = RawImage::decode(bytes)
                .map_err(|error| FoxgloveImageError::Message { detail: error.to_string() })?;
            let format = match message.encoding.as_str() {
                "mono8" | "8UC1" => PixelFormat::Mono8,
                "yuyv" | "yuv422_yuy2" => PixelFormat::Yuyv,
                "uyvy" | "yuv422" => PixelFormat::Uyvy,
                "nv12" => PixelFormat::Nv12,
                "rgb8" => PixelFormat::Rgb8,
                "bgr8" => PixelFormat::Bgr8,
                "mono16" if sensor != SensorKind::Depth => PixelFormat::Mono16,
                "16UC1" | "mono16" => PixelFormat::Depth16,
                other => {
                    let encoding = other.to_owned();
                    return Err(FoxgloveImageError::UnknownEncoding { encoding });
                }
            };
            let size = ImageSize::new(message.width, message.height);
            Ok(Frame {
                sensor,
                size,
                format,
                stride: message.step as usize,
                bytes: message.data.as_ref().into(),
            })
        }
        other => Err(FoxgloveImageError::UnknownSchema { schema: other.to_owned() }),
    }
}

/// The lens that a camera calibration message states; `None` if it states none that Plumb has.
pub(super) fn decode_lens(bytes: &[u8]) -> Option<(ImageSize, Lens)> {
    let message = CameraCalibration::decode(bytes).ok()?;
    let matrix: [f64; 9] = message.k.as_slice().try_into().ok()?;
    let lens = lens_from_ros(&message.distortion_model, &message.d, &matrix)?;
    Some((ImageSize::new(message.width, message.height), lens))
}

/// The lens of a `distortion_model` with its coefficients and the matrix K row by row, as ROS and
/// Foxglove state it; `None` if no model of Plumb's says the same. Coefficients that are left out
/// are 0.
pub(super) fn lens_from_ros(
    distortion_model: &str,
    stated_coefficients: &[f64],
    matrix: &[f64; 9],
) -> Option<Lens> {
    let [fx, skew, cx, _, fy, cy, ..] = *matrix;
    let is_zero = |coefficients: &[f64]| coefficients.iter().all(|d| *d == 0.0);
    let matrix = CameraMatrix { fx, fy, cx, cy, skew };
    let lens = match LensModel::from_camera_info(distortion_model) {
        Some(model) => {
            let count = model.coefficient_names().len();
            let stated =
                stated_coefficients.iter().copied().chain(std::iter::repeat(0.0)).take(count);
            let stated: Vec<f64> = stated.collect();
            let distortion = Distortion::from_coefficients(model, &stated)?;
            let beyond = stated_coefficients.get(count..).unwrap_or_default();
            is_zero(beyond).then_some(Lens { matrix, distortion })
        }
        None => is_zero(stated_coefficients).then(|| Lens::pinhole(matrix)),
    };
    let is_finite = |lens: &Lens| lens.parameters().iter().all(|value| value.is_finite());
    lens.filter(|lens| fx > 0.0 && fy > 0.0 && is_finite(lens))
}

fn encoded<T: Encode>(schema: &'static str, message: &T) -> Option<Encoded> {
    let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or_default());
    message.encode(&mut bytes).ok()?;
    Some(Encoded { schema, descriptor: T::get_schema()?.data.into_owned(), bytes })
}

fn timestamp(utc_ns: i64) -> Timestamp {
    let utc_ns = utc_ns.max(0);
    let seconds = u32::try_from(utc_ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, (utc_ns % 1_000_000_000) as u32).unwrap_or(Timestamp::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;

    #[test]
    fn topics_are_the_contract_s() {
        for name in
            ["/front/color", "/a/b/depth", "/front/infrared/calibration", "/front/depth/transform"]
        {
            assert_eq!(Topic::parse(name).unwrap().name(), name);
        }
        for name in ["/front/hue", "/color", "", "/front/color/info", "/fr\nont/color"] {
            assert_eq!(Topic::parse(name), None, "{name}");
        }
    }

    #[test]
    fn a_frame_of_every_format_survives() {
        use PixelFormat::{Bgr8, Depth16, Jpeg, Mono8, Mono16, Nv12, Png, Rgb8, Uyvy, Yuyv};
        for format in [Jpeg, Png, Mono8, Mono16, Yuyv, Uyvy, Nv12, Rgb8, Bgr8, Depth16] {
            let file = format.bytes_per_pixel().is_none();
            let size = if file { ImageSize::new(0, 0) } else { ImageSize::new(4, 2) };
            let stride = format.bytes_per_pixel().map_or(0, |bytes| 4 * bytes);
            let frame = Frame {
                sensor: SensorKind::Infrared,
                size,
                format,
                stride,
                bytes: [7; 24].as_slice().into(),
            };
            let message = encode_frame(&frame, "front_infrared", 1).unwrap();
            let back = decode_frame(message.schema, SensorKind::Infrared, &message.bytes).unwrap();
            assert_eq!(format!("{back:?}"), format!("{frame:?}"));
        }
    }

    #[test]
    fn a_lens_survives() {
        let matrix = CameraMatrix { fx: 500.0, fy: 501.0, cx: 320.0, cy: 239.0, skew: 0.1 };
        for model in [LensModel::Brown, LensModel::Rational, LensModel::KannalaBrandt] {
            let mut parameters = vec![500.0, 501.0, 320.0, 239.0, 0.1];
            parameters.extend((0..model.coefficient_names().len()).map(|k| 0.01 * k as f64));
            let lens = Lens::from_parameters(model, &parameters).unwrap();
            let message = encode_lens(&lens, ImageSize::new(640, 480), "front_color", 5).unwrap();
            assert_eq!(decode_lens(&message.bytes), Some((ImageSize::new(640, 480), lens)));
        }
        let pinhole = encode_lens(&Lens::pinhole(matrix), ImageSize::new(8, 6), "", 0).unwrap();
        assert_eq!(decode_lens(&pinhole.bytes).unwrap().1.matrix, matrix);
        assert_eq!(decode_lens(b"no message"), None);
    }

    #[test]
    fn a_pose_survives() {
        let rotation = nalgebra::UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3);
        let color_from_depth = Pose::new(rotation, nalgebra::Vector3::new(0.025, -0.001, 0.002));
        let frames = || ["front_color".to_owned(), "front_depth".to_owned()];
        let message = encode_pose(&color_from_depth, frames(), 5).unwrap();
        let back = decode_pose(&message.bytes).unwrap();
        assert_eq!(back.translation(), color_from_depth.translation());
        assert!(back.angle_to(&color_from_depth) < 1e-7);
        assert_eq!(decode_pose(b"no message"), None);
    }
}
