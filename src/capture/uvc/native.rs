//! On Linux a USB camera is a V4L2 device.

#[cfg(not(feature = "nokhwa"))]
use crate::capture::device_list::DeviceListing;
use crate::capture::uvc::options::{Selector, UvcOptions};
use crate::capture::v4l2;

/// The camera as the V4L2 source reads it.
pub(super) fn camera(options: UvcOptions) -> v4l2::V4l2Camera {
    let device = match options.selector {
        Selector::Index(index) => format!("/dev/video{index}"),
        Selector::Name(name) => name,
    };
    v4l2::V4l2Camera::new(v4l2::V4l2Options {
        device: device.into(),
        mode: options.mode,
        ..Default::default()
    })
}

/// None of its own: they are listed as V4L2 devices.
#[cfg(not(feature = "nokhwa"))]
pub(super) fn list_devices() -> DeviceListing {
    let missing = "on Linux these are the cameras of v4l2: index = N is /dev/videoN, name = \"…\" is the name above";
    DeviceListing { backend: "uvc", devices: Vec::new(), missing: Some(missing.to_owned()) }
}
