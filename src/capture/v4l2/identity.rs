//! Which device a configuration means, and which of the nodes there are now is that device.

use std::fs;
use std::path::Path;

use crate::capture::v4l2::device_node::DeviceNode;

/// What stays the same when a device is unplugged and plugged in again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DeviceIdentity {
    name: String,
    index: u32,
    model: Option<String>,
    serial: Option<String>,
    bus: String,
}

impl DeviceIdentity {
    /// The identity of the device behind `node`.
    pub fn of(node: &DeviceNode) -> Self {
        Self {
            name: node.name.clone(),
            index: node.index,
            model: node.usb.as_ref().map(|usb| usb.model.clone()),
            serial: node.serial().map(str::to_owned),
            bus: node.bus.clone(),
        }
    }

    /// The node that this device has now: by serial number; one without, where it was; one that was
    /// moved to another socket, if it is the only one of its kind.
    pub fn find<'n>(&self, nodes: &'n [DeviceNode]) -> Option<&'n DeviceNode> {
        let same_kind = |node: &&DeviceNode| {
            let model = node.usb.as_ref().map(|usb| &usb.model);
            node.name == self.name && node.index == self.index && model == self.model.as_ref()
        };
        let kin: Vec<&DeviceNode> = nodes.iter().filter(same_kind).collect();
        if let Some(serial) = &self.serial {
            return kin.into_iter().find(|node| node.serial() == Some(serial));
        }
        let at_its_place = kin.iter().find(|node| node.bus == self.bus).copied();
        at_its_place.or(if let [only] = kin[..] { Some(only) } else { None })
    }

    /// Its name and what distinguishes it from others of its kind.
    pub fn words(&self) -> String {
        match &self.serial {
            Some(serial) => format!("{} (serial {serial})", self.name),
            None => format!("{} (at {})", self.name, self.bus),
        }
    }
}

/// The node that `device` means: a path, a serial number, or a device's name or place as `plumb
/// devices` lists them.
pub(super) fn find_by_request<'n>(
    device: &Path,
    nodes: &'n [DeviceNode],
) -> Option<&'n DeviceNode> {
    if device.is_absolute() {
        let node = fs::canonicalize(device).ok()?;
        return nodes.iter().find(|known| known.path == node);
    }
    let wanted = device.to_str()?;
    let named = |node: &&DeviceNode| {
        node.serial() == Some(wanted) || node.name == wanted || node.bus == wanted
    };
    nodes.iter().filter(named).min_by_key(|node| node.index)
}

/// Whether `device` names an identity by itself, so that it may be followed blindly.
pub(super) fn is_stable(device: &Path) -> bool {
    device.starts_with("/dev/v4l") || !device.starts_with("/dev")
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::capture::v4l2::device_node::UsbIdentity;

    fn node(number: u32, name: &str, serial: Option<&str>, bus: &str) -> DeviceNode {
        let model = "046d:0825".to_owned();
        let usb = Some(UsbIdentity { model, serial: serial.map(str::to_owned), release: None });
        DeviceNode {
            path: PathBuf::from(format!("/dev/video{number}")),
            name: name.into(),
            index: 0,
            bus: bus.into(),
            usb,
        }
    }

    #[test]
    fn a_device_is_found_again_under_another_number() {
        let identity = DeviceIdentity::of(&node(0, "cam", Some("A"), "usb1/1-1"));
        let now = [node(0, "cam", Some("B"), "usb1/1-1"), node(3, "cam", Some("A"), "usb1/1-4")];
        assert_eq!(identity.find(&now), Some(&now[1]));
        assert_eq!(
            identity.find(&now[..1]),
            None,
            "another camera in its socket is another camera"
        );
    }

    #[test]
    fn without_a_serial_number_the_place_decides_and_then_the_kind() {
        let identity = DeviceIdentity::of(&node(0, "cam", None, "usb1/1-1"));
        let two = [node(0, "cam", None, "usb1/1-2"), node(1, "cam", None, "usb1/1-1")];
        assert_eq!(identity.find(&two), Some(&two[1]));
        assert_eq!(identity.find(&two[..1]), Some(&two[0]), "moved, and the only one");
        let others = [node(0, "cam", None, "usb1/1-2"), node(1, "cam", None, "usb1/1-3")];
        assert_eq!(identity.find(&others), None, "either could be it");
        assert_eq!(identity.find(&[node(0, "other", None, "usb1/1-1")]), None);
    }

    #[test]
    fn a_request_may_be_a_serial_number_a_name_or_a_place() {
        let nodes = [node(0, "cam", Some("A"), "usb1/1-1"), node(2, "eye", Some("B"), "usb1/1-2")];
        for wanted in ["B", "eye", "usb1/1-2"] {
            assert_eq!(find_by_request(Path::new(wanted), &nodes), Some(&nodes[1]));
        }
        assert_eq!(find_by_request(Path::new("C"), &nodes), None);
        assert!(is_stable(Path::new("B")) && is_stable(Path::new("/dev/v4l/by-id/x")));
        assert!(!is_stable(Path::new("/dev/video0")));
    }
}
