//! Where the sensors are, for ROS: fixed joints of a URDF, or static transforms.

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, Event};

use crate::calibration::result::Calibration;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::number::decimal;
use crate::export::sensors::{Sensor, placed_sensors};
use crate::export::{ExportError, ExportOptions, Format};
use crate::geometry::pose::Pose;

pub(super) const URDF: FormatFacts = FormatFacts {
    name: "urdf",
    description: "Sensor poses as URDF with fixed joints",
    media_type: "application/xml",
    file_name: FileName::WithSuffix(".urdf"),
    holds_all: true,
    write: write_urdf,
};

pub(super) const TF: FormatFacts = FormatFacts {
    name: "tf",
    description: "Sensor poses as ROS static transforms (YAML)",
    media_type: "application/yaml",
    file_name: FileName::WithSuffix("-tf.yaml"),
    holds_all: true,
    write: write_tf,
};

fn write_urdf(calibration: &Calibration, _: &ExportOptions) -> Result<Formatted, ExportError> {
    let format = Format::Urdf;
    let (placed, note) = placed_sensors(calibration, format)?;
    let camera = camera_name(calibration);
    let text = urdf(camera, &placed)
        .map_err(|error| ExportError::Text { format, reason: error.to_string() })?;
    Ok(Formatted::one_file(camera, text, note))
}

fn write_tf(calibration: &Calibration, _: &ExportOptions) -> Result<Formatted, ExportError> {
    let (placed, note) = placed_sensors(calibration, Format::Tf)?;
    let camera = camera_name(calibration);
    Ok(Formatted::one_file(camera, stamped(camera, &placed), note))
}

/// A URDF whose root is the first sensor's optical frame, with a fixed joint to each other's. A
/// robot's own URDF takes the joints over. Angles are URDF's: about the fixed x, y and z axes, in
/// this order.
fn urdf(camera: &str, sensors: &[Sensor<'_>]) -> std::io::Result<String> {
    let mut xml = Writer::new_with_indent(Vec::new(), b' ', 2);
    xml.write_event(Event::Decl(BytesDecl::new("1.0", None, None)))?;
    xml.create_element("robot").with_attribute(("name", camera)).write_inner_content(|xml| {
        for sensor in sensors {
            let name = sensor.optical_frame(camera);
            xml.create_element("link").with_attribute(("name", name.as_str())).write_empty()?;
        }
        for joint in joints(camera, sensors) {
            write_joint(xml, joint)?;
        }
        Ok(())
    })?;
    let mut text = xml.into_inner();
    text.push(b'\n');
    String::from_utf8(text).map_err(std::io::Error::other)
}

fn write_joint(
    xml: &mut Writer<Vec<u8>>,
    FixedJoint { parent, child, parent_from_child }: FixedJoint,
) -> std::io::Result<()> {
    let spaced = |values: [f64; 3]| values.map(decimal).join(" ");
    let xyz = spaced(parent_from_child.translation().into());
    let (roll, pitch, yaw) = parent_from_child.rotation().euler_angles();
    let rpy = spaced([roll, pitch, yaw]);
    let name = format!("{child}_joint");
    let attributes = [("name", name.as_str()), ("type", "fixed")];
    xml.create_element("joint").with_attributes(attributes).write_inner_content(|xml| {
        xml.create_element("parent").with_attribute(("link", parent.as_str())).write_empty()?;
        xml.create_element("child").with_attribute(("link", child.as_str())).write_empty()?;
        let origin = [("xyz", xyz.as_str()), ("rpy", rpy.as_str())];
        xml.create_element("origin").with_attributes(origin).write_empty()?;
        Ok(())
    })?;
    Ok(())
}

/// A YAML list of `geometry_msgs/TransformStamped`, from the first sensor's optical frame to each
/// other's.
fn stamped(camera: &str, sensors: &[Sensor<'_>]) -> String {
    let mut text = String::new();
    for FixedJoint { parent, child, parent_from_child } in joints(camera, sensors) {
        let (translation, rotation) =
            (parent_from_child.translation(), parent_from_child.rotation());
        let named = |names: &[&str], values: &[f64]| {
            let pairs = names
                .iter()
                .zip(values)
                .map(|(name, value)| format!("{name}: {}", decimal(*value)));
            pairs.collect::<Vec<_>>().join(", ")
        };
        text += &format!(
            "- header: {{frame_id: {}}}\n  child_frame_id: {}\n  transform:\n    \
             translation: {{{}}}\n    rotation: {{{}}}\n",
            serde_json::Value::from(parent),
            serde_json::Value::from(child),
            named(&["x", "y", "z"], translation.as_slice()),
            named(&["x", "y", "z", "w"], &[rotation.i, rotation.j, rotation.k, rotation.w]),
        );
    }
    text
}

/// A fixed transform between the optical frames of two sensors.
struct FixedJoint {
    parent: String,
    child: String,
    parent_from_child: Pose,
}

/// From the first sensor to each other whose pose is known.
fn joints<'a>(camera: &'a str, sensors: &'a [Sensor<'_>]) -> impl Iterator<Item = FixedJoint> + 'a {
    let parent = sensors.first().map(|sensor| sensor.optical_frame(camera)).unwrap_or_default();
    sensors.iter().skip(1).filter_map(move |sensor| {
        let (parent, child) = (parent.clone(), sensor.optical_frame(camera));
        Some(FixedJoint { parent, child, parent_from_child: sensor.first_from_sensor? })
    })
}
