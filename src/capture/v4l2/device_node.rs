//! The video nodes of this machine and which device each belongs to, from sysfs: nothing is opened.

use std::fs;
use std::path::{Path, PathBuf};

const CLASS: &str = "/sys/class/video4linux";

/// One `/dev/videoN`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DeviceNode {
    /// `/dev/videoN`.
    pub path: PathBuf,
    /// The device's name as the kernel states it.
    pub name: String,
    /// Which of its device's nodes it is: a USB camera's first gives images, its second metadata.
    pub index: u32,
    /// Where the device hangs in the machine, without the numbers that change when it is plugged in
    /// again.
    pub bus: String,
    /// What a USB device says it is.
    pub usb: Option<UsbIdentity>,
}

/// A USB device's own words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct UsbIdentity {
    /// Vendor and product, as in `046d:0825`.
    pub model: String,
    /// The serial number, where the maker gave it one.
    pub serial: Option<String>,
    /// Firmware, as the maker counts it.
    pub release: Option<String>,
}

impl DeviceNode {
    /// Reads what sysfs says of the node called `node_name` (`video0`).
    fn read(class: &Path, node_name: &str) -> Option<Self> {
        let folder = class.join(node_name);
        let name = attribute(&folder, "name")?;
        // A virtual node belongs to no device: then it is its own place.
        let device =
            fs::canonicalize(folder.join("device")).or_else(|_| fs::canonicalize(&folder)).ok()?;
        let usb_folder = device.ancestors().find(|parent| parent.join("idVendor").is_file());
        let usb = usb_folder.and_then(|folder| {
            let model =
                format!("{}:{}", attribute(folder, "idVendor")?, attribute(folder, "idProduct")?);
            let serial = attribute(folder, "serial").filter(|serial| !serial.is_empty());
            Some(UsbIdentity { model, serial, release: attribute(folder, "bcdDevice") })
        });
        let bus = device.strip_prefix("/sys/devices").unwrap_or(&device).display().to_string();
        let index = attribute(&folder, "index").and_then(|index| index.parse().ok()).unwrap_or(0);
        Some(Self { path: Path::new("/dev").join(node_name), name, index, bus, usb })
    }

    /// The serial number, where there is one.
    pub fn serial(&self) -> Option<&str> {
        self.usb.as_ref().and_then(|usb| usb.serial.as_deref())
    }

    /// The names under `/dev/v4l` that lead here; they stay when numbers change.
    pub fn stable_paths(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        for folder in ["/dev/v4l/by-id", "/dev/v4l/by-path"] {
            let Ok(entries) = fs::read_dir(folder) else { continue };
            let links = entries.flatten().map(|entry| entry.path());
            found.extend(
                links.filter(|link| fs::canonicalize(link).is_ok_and(|node| node == self.path)),
            );
        }
        found.sort();
        found
    }
}

/// Every video node, by number.
pub(super) fn video_nodes() -> Vec<DeviceNode> {
    let class = Path::new(CLASS);
    let Ok(entries) = fs::read_dir(class) else { return Vec::new() };
    let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
    let mut names: Vec<(u32, String)> =
        names.filter_map(|name| Some((name.strip_prefix("video")?.parse().ok()?, name))).collect();
    names.sort();
    names.iter().filter_map(|(_, name)| DeviceNode::read(class, name)).collect()
}

/// Whether the kernel has any video support at all.
pub(super) fn kernel_has_video() -> bool {
    Path::new(CLASS).is_dir()
}

fn attribute(folder: &Path, name: &str) -> Option<String> {
    let text = fs::read(folder.join(name)).ok()?;
    Some(String::from_utf8_lossy(&text).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_usb_cameras_serial_number_is_found_above_its_interface() {
        let sys = tempfile::tempdir().unwrap();
        let usb = sys.path().join("devices/usb1/1-2");
        let interface = usb.join("1-2:1.0");
        fs::create_dir_all(interface.join("video4linux/video4")).unwrap();
        for (name, text) in [("idVendor", "046d\n"), ("idProduct", "0825\n"), ("serial", "A1B2\n")]
        {
            fs::write(usb.join(name), text).unwrap();
        }
        let class = sys.path().join("class");
        fs::create_dir_all(class.join("video4")).unwrap();
        fs::write(class.join("video4/name"), "UVC \u{fffd}Camera\n").unwrap();
        fs::write(class.join("video4/index"), "1\n").unwrap();
        symlink(&interface, class.join("video4/device")).unwrap();
        let node = DeviceNode::read(&class, "video4").unwrap();
        assert_eq!(node.path, Path::new("/dev/video4"));
        assert_eq!((node.serial(), node.index), (Some("A1B2"), 1));
        assert_eq!(node.usb.as_ref().map(|usb| usb.model.as_str()), Some("046d:0825"));
        assert!(node.bus.ends_with("usb1/1-2/1-2:1.0"));
        assert_eq!(DeviceNode::read(&class, "video5"), None);
    }
}
