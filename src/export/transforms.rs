//! Where the sensors are, for ROS: fixed joints of a URDF, or static transforms.

use crate::export::number::decimal;
use crate::export::sensors::Sensor;
use crate::geometry::pose::Pose;

/// A URDF whose root is the first sensor's optical frame, with a fixed joint to each other's. A
/// robot's own URDF takes the joints over. Angles are URDF's: about the fixed x, y and z axes, in
/// this order.
pub(super) fn urdf(camera: &str, sensors: &[Sensor<'_>]) -> String {
    let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"{camera}\">\n");
    for sensor in sensors {
        text += &format!("  <link name=\"{}\"/>\n", sensor.optical_frame(camera));
    }
    for (parent, child, parent_from_child) in pairs(camera, sensors) {
        let shift = parent_from_child.translation();
        let (roll, pitch, yaw) = parent_from_child.rotation().euler_angles();
        let spaced = |values: [f64; 3]| values.map(decimal).join(" ");
        text += &format!(
            "  <joint name=\"{child}_joint\" type=\"fixed\">\n    <parent link=\"{parent}\"/>\n    \
             <child link=\"{child}\"/>\n    <origin xyz=\"{}\" rpy=\"{}\"/>\n  </joint>\n",
            spaced(shift.into()),
            spaced([roll, pitch, yaw]),
        );
    }
    text + "</robot>\n"
}

/// A YAML list of `geometry_msgs/TransformStamped`, from the first sensor's optical frame to each
/// other's.
pub(super) fn stamped(camera: &str, sensors: &[Sensor<'_>]) -> String {
    let mut text = String::new();
    for (parent, child, parent_from_child) in pairs(camera, sensors) {
        let (shift, turn) = (parent_from_child.translation(), parent_from_child.rotation());
        let named = |names: &[&str], values: &[f64]| {
            let pairs = names
                .iter()
                .zip(values)
                .map(|(name, value)| format!("{name}: {}", decimal(*value)));
            pairs.collect::<Vec<_>>().join(", ")
        };
        text += &format!(
            "- header: {{frame_id: \"{parent}\"}}\n  child_frame_id: \"{child}\"\n  transform:\n    \
             translation: {{{}}}\n    rotation: {{{}}}\n",
            named(&["x", "y", "z"], shift.as_slice()),
            named(&["x", "y", "z", "w"], &[turn.i, turn.j, turn.k, turn.w]),
        );
    }
    text
}

fn pairs<'a>(
    camera: &'a str,
    sensors: &'a [Sensor<'_>],
) -> impl Iterator<Item = (String, String, Pose)> + 'a {
    let parent = sensors.first().map(|sensor| sensor.optical_frame(camera)).unwrap_or_default();
    let placed = sensors.iter().skip(1);
    placed.filter_map(move |sensor| {
        Some((parent.clone(), sensor.optical_frame(camera), sensor.first_from_sensor?))
    })
}
