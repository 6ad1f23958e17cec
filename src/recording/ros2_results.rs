//! What Plumb says on the graph of ROS 2, as messages in CDR, and what it is answered.

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::rectification::RectifiedCamera;
use crate::imaging::frame::SensorKind;
use crate::recording::fields::Fields;
use crate::recording::ros2_messages::{self, Cdr};

/// Where a message that begins with a `std_msgs/Header` has its stamp: after the four bytes that
/// state the encoding.
const STAMP: std::ops::Range<usize> = 4..12;

/// Where a frame is in its parent.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameTransform {
    /// The parent's name.
    pub parent: String,
    /// The frame's name.
    pub child: String,
    /// From the frame to its parent.
    pub parent_from_child: Pose,
}

/// How much a diagnosis matters, as `diagnostic_msgs/DiagnosticStatus` counts it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum DiagnosisLevel {
    /// All is well.
    Ok = 0,
    /// It goes on, and a person should know.
    Warn = 1,
    /// It does not go on.
    Error = 2,
}

/// How something does: `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnosis {
    /// How much it matters.
    pub level: DiagnosisLevel,
    /// What it is of.
    pub name: String,
    /// The diagnosis in one line.
    pub message: String,
    /// Which hardware.
    pub hardware_id: String,
    /// What it rests on.
    pub values: Vec<(&'static str, String)>,
}

/// The name of the optical frame of a camera's sensor (REP 103: x right, y down, z forward).
pub fn optical_frame(camera: &str, sensor: SensorKind) -> String {
    ros2_messages::frame_id(camera, sensor)
}

/// A camera's or rig's name as part of names of ROS, which have no `-`.
pub fn ros_name(name: &str) -> String {
    name.replace('-', "_")
}

/// The name under which a sensor's topics are, as in `/front/depth`.
pub fn sensor_namespace(camera: &str, sensor: SensorKind) -> String {
    ros2_messages::namespace(camera, sensor)
}

/// `sensor_msgs/msg/CameraInfo`, which is also the request of `sensor_msgs/srv/SetCameraInfo`, of a
/// camera with its rectification; `None` for a lens that ROS cannot hold exactly.
pub fn camera_info(
    frame_id: &str,
    lens: &Lens,
    size: ImageSize,
    rectified: &RectifiedCamera,
    utc_ns: i64,
) -> Option<Vec<u8>> {
    if lens.matrix.has_skew() {
        return None;
    }
    ros2_messages::camera_info_in(frame_id, lens, size, rectified, utc_ns)
}

/// The same message with another stamp in its header.
pub fn restamped(message: &[u8], utc_ns: i64) -> Vec<u8> {
    let stamp = ros2_messages::stamp(utc_ns).map(u32::to_le_bytes).concat();
    let mut message = message.to_vec();
    if let Some(stated) = message.get_mut(STAMP) {
        stated.copy_from_slice(&stamp);
    }
    message
}

/// `tf2_msgs/msg/TFMessage`.
pub fn static_transforms(transforms: &[FrameTransform], utc_ns: i64) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.u32(transforms.len() as u32);
    for FrameTransform { parent, child, parent_from_child } in transforms {
        cdr.header(utc_ns, parent);
        cdr.text(child);
        let rotation = parent_from_child.rotation();
        parent_from_child.translation().iter().for_each(|value| cdr.f64(*value));
        [rotation.i, rotation.j, rotation.k, rotation.w].iter().for_each(|value| cdr.f64(*value));
    }
    cdr.0
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
pub fn diagnostics(diagnoses: &[Diagnosis], utc_ns: i64) -> Vec<u8> {
    let mut cdr = Cdr::with_header(utc_ns, "");
    cdr.u32(diagnoses.len() as u32);
    for Diagnosis { level, name, message, hardware_id, values } in diagnoses {
        cdr.0.push(*level as u8);
        cdr.text(name);
        cdr.text(message);
        cdr.text(hardware_id);
        cdr.u32(values.len() as u32);
        for (key, value) in values {
            cdr.text(key);
            cdr.text(value);
        }
    }
    cdr.0
}

/// `std_msgs/msg/String`.
pub fn text(text: &str) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.text(text);
    cdr.0
}

/// The answer of `std_srvs/srv/Trigger`.
pub fn reply(success: bool, message: &str) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.0.push(u8::from(success));
    cdr.text(message);
    cdr.0
}

/// The answer of `sensor_msgs/srv/SetCameraInfo`: whether it was taken, and what was said; `None`
/// for what is none.
pub fn read_reply(message: &[u8]) -> Option<(bool, String)> {
    let mut fields = Fields::cdr(message).ok()?;
    Some((fields.u8().ok()? != 0, fields.text().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_stamp_and_nothing_else() {
        let at = |utc_ns| static_header(utc_ns);
        assert_eq!(restamped(&at(7), 1_700_000_000_123_456_789), at(1_700_000_000_123_456_789));
        assert_eq!(restamped(b"short", 1), b"short");
    }

    fn static_header(utc_ns: i64) -> Vec<u8> {
        Cdr::with_header(utc_ns, "front_optical_frame").0
    }

    #[test]
    fn answers_are_read_as_they_are_written() {
        assert_eq!(read_reply(&reply(true, "kept")), Some((true, "kept".to_owned())));
        assert_eq!(read_reply(&reply(false, "")), Some((false, String::new())));
        assert_eq!(read_reply(b"\0\x01\0\0\x01"), None);
        assert_eq!(text("ab"), b"\0\x01\0\0\x03\0\0\0ab\0");
    }
}
