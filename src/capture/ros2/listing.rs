//! The topics of images in the domain of the environment.

use std::collections::BTreeMap;
use std::thread;

use crate::capture::device_list::{DeviceListing, ListedDevice};
use crate::capture::ros2::camera::DISCOVERY;
use crate::dds::{Domain, Participant};

/// What publishes images now; takes as long as opening waits for a publisher.
pub fn list_devices() -> DeviceListing {
    let domain = Domain::of_environment(None);
    let nothing = |missing: String| DeviceListing {
        backend: "ros2",
        devices: Vec::new(),
        missing: Some(missing),
    };
    let participant = match Participant::join(domain) {
        Ok(participant) => participant,
        Err(error) => return nothing(error.to_string()),
    };
    thread::sleep(DISCOVERY);
    let mut types: BTreeMap<String, String> = BTreeMap::new();
    for topic in participant.published() {
        if topic.type_name.ends_with("Image") {
            types.insert(topic.name, topic.type_name);
        }
    }
    if types.is_empty() {
        let id = domain.id;
        return nothing(format!(
            "no topic of images in domain {id}; start the driver, or set ROS_DOMAIN_ID"
        ));
    }
    let device = |(topic, type_name): (String, String)| ListedDevice {
        name: type_name,
        identity: topic,
        bus: Some(format!("domain {}", domain.id)),
        ..ListedDevice::default()
    };
    let devices = types.into_iter().map(device).collect();
    DeviceListing { backend: "ros2", devices, missing: None }
}
