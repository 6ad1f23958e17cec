//! Names: `/front/image_raw` is `rt/front/image_raw` in DDS, and `sensor_msgs/msg/Image`
//! `sensor_msgs::msg::dds_::Image_` (ROS 2 design, "Topic and Service name mapping to DDS").

/// DDS's name of the ROS topic `name`.
pub(super) fn dds_topic(name: &str) -> String {
    format!("rt/{}", name.trim_start_matches('/'))
}

/// The ROS name of a DDS topic, if it is one of a ROS topic and no service's.
pub(super) fn ros_topic(name: &str) -> Option<String> {
    name.strip_prefix("rt/").map(|name| format!("/{name}"))
}

/// DDS's name of the ROS type `name`, as in `sensor_msgs/msg/Image`.
pub(super) fn dds_type(name: &str) -> String {
    match name.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => name.to_owned(),
    }
}

/// The ROS name of a DDS type; one that is none of ROS stays as it is.
pub fn ros_type(name: &str) -> String {
    let plain = name.strip_suffix('_').and_then(|name| name.rsplit_once("::dds_::"));
    plain.map_or_else(
        || name.to_owned(),
        |(package, name)| format!("{}/{name}", package.replace("::", "/")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_ros_and_of_dds() {
        assert_eq!(dds_topic("/front/image_raw"), "rt/front/image_raw");
        assert_eq!(ros_topic("rt/front/image_raw").as_deref(), Some("/front/image_raw"));
        assert_eq!(ros_topic("rq/front/set_camera_infoRequest"), None);
        let image = "sensor_msgs::msg::dds_::Image_";
        assert_eq!(dds_type("sensor_msgs/msg/Image"), image);
        assert_eq!(ros_type(image), "sensor_msgs/msg/Image");
        assert_eq!(ros_type("Circle"), "Circle");
    }
}
