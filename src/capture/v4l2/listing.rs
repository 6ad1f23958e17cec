//! What `plumb devices` lists of Linux video devices.

#[cfg(feature = "nokhwa")]
use std::path::PathBuf;

use crate::capture::device_list::{DeviceListing, ListedDevice};
use crate::capture::v4l2::camera::open_device;
use crate::capture::v4l2::controls::Controls;
use crate::capture::v4l2::device_node::{DeviceNode, kernel_has_video, video_nodes};
use crate::capture::v4l2::holder::holders_of;
use crate::capture::v4l2::{kernel, mode};

/// Every Linux video device that gives images. Each is opened for a moment, which disturbs no
/// stream.
pub fn list_devices() -> DeviceListing {
    let devices: Vec<ListedDevice> = video_nodes().iter().filter_map(listed).collect();
    let missing = devices.is_empty().then(|| {
        let absent = "no camera is plugged in: plug one in, or read in `dmesg` what its driver says";
        let without = "the kernel has no video devices (/sys/class/video4linux is absent): plug a camera in, load its \
                       driver (`sudo modprobe uvcvideo`), or give a container the host's /dev/video*";
        if kernel_has_video() { absent } else { without }.to_owned()
    });
    DeviceListing { backend: "v4l2", devices, missing }
}

/// Whether `/dev/video{number}` may give images: not a node for metadata or output. One that cannot
/// be opened may, as far as can be known.
#[cfg(feature = "nokhwa")]
pub(in crate::capture) fn may_give_images(number: u32) -> bool {
    let Ok(opened) = open_device(&PathBuf::from(format!("/dev/video{number}"))) else {
        return true;
    };
    kernel::capability(&opened).is_ok_and(|capability| capability.streams_video())
}

/// One node; `None` for those that give metadata, take output, or do something else altogether.
fn listed(node: &DeviceNode) -> Option<ListedDevice> {
    let path = node.path.display().to_string();
    let stable: Vec<String> =
        node.stable_paths().iter().map(|path| path.display().to_string()).collect();
    let identity = stable
        .first()
        .cloned()
        .or_else(|| node.serial().map(str::to_owned))
        .unwrap_or_else(|| path.clone());
    let mut device = ListedDevice {
        name: node.name.clone(),
        identity,
        paths: stable.into_iter().chain([path]).collect(),
        serial: node.serial().map(str::to_owned),
        bus: Some(node.bus.clone()),
        firmware: node.usb.as_ref().and_then(|usb| usb.release.clone()),
        in_use_by: holders_of(&node.path, 0),
        ..ListedDevice::default()
    };
    let opened = match open_device(&node.path) {
        Ok(opened) => opened,
        Err(error) => {
            device.problem = Some(error.to_string());
            return Some(device);
        }
    };
    let capability = match kernel::capability(&opened) {
        Ok(capability) => capability,
        Err(error) => {
            device.problem = Some(format!("the driver answers: {error}"));
            return Some(device);
        }
    };
    if !capability.streams_video() {
        device.problem =
            Some("gives its images in several planes, which Plumb does not read".to_owned());
        return capability.is_multiplanar().then_some(device);
    }
    device.driver = Some(capability.driver);
    device.formats = mode::offered(&opened);
    device.controls = Controls::read(&opened).listed(&opened);
    Some(device)
}
