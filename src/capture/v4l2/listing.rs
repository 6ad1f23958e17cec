//! What `plumb devices` lists of Linux video devices.

#[cfg(feature = "nokhwa")]
use std::path::PathBuf;

#[cfg(feature = "nokhwa")]
use v4l::video::Capture;

use crate::capture::device_list::{DeviceListing, ListedDevice};
#[cfg(feature = "nokhwa")]
use crate::capture::mode::ModeRequest;
use crate::capture::v4l2::camera::open_device;
use crate::capture::v4l2::controls::Controls;
use crate::capture::v4l2::device_node::{DeviceNode, kernel_has_video, video_nodes};
use crate::capture::v4l2::holder::holders_of;
use crate::capture::v4l2::{kernel, mode};
#[cfg(feature = "nokhwa")]
use crate::geometry::pixel::ImageSize;

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

/// Sets `/dev/video{number}` to the first of `formats` (four-character codes) that it has, unless
/// it stands at one of them already. What fails is left to whoever opens it then.
#[cfg(feature = "nokhwa")]
pub(in crate::capture) fn set_to_one_of(number: u32, formats: &[&str]) {
    let Ok(device) = open_device(&PathBuf::from(format!("/dev/video{number}"))) else { return };
    let Ok(present) = device.format() else { return };
    let is_known = |code: &str| formats.contains(&code);
    if present.fourcc.str().is_ok_and(is_known) {
        return;
    }
    let offered = mode::offered(&device);
    if let Some(format) = offered.into_iter().find(|format| is_known(&format.name)) {
        let size = Some(ImageSize::new(present.width, present.height));
        let request = ModeRequest { size, format: Some(format.name), fps: None };
        // Refused, it stays as it is, and opening says why.
        let _ = mode::set_mode(&device, &request);
    }
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
            Some("delivers multi-planar images, which Plumb does not support".to_owned());
        return capability.is_multiplanar().then_some(device);
    }
    device.driver = Some(capability.driver);
    device.formats = mode::offered(&opened);
    device.controls = Controls::read(&opened).listed(&opened);
    Some(device)
}
