//! On Linux a USB camera is a V4L2 device.

use crate::capture::device_list::DeviceListing;
use crate::capture::uvc::options::{Selector, UvcOptions};
use crate::capture::{CaptureError, FrameSource, SourceOpener, v4l2};

/// A USB camera that may come and go.
#[derive(Debug)]
pub struct UvcCamera {
    camera: v4l2::V4l2Camera,
}

impl UvcCamera {
    /// A camera that is not opened yet.
    pub fn new(options: UvcOptions) -> Self {
        let device = match options.selector {
            Selector::Index(index) => format!("/dev/video{index}"),
            Selector::Name(name) => name,
        };
        let options =
            v4l2::V4l2Options { device: device.into(), mode: options.mode, ..Default::default() };
        Self { camera: v4l2::V4l2Camera::new(options) }
    }
}

impl SourceOpener for UvcCamera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        self.camera.open()
    }
}

/// None of its own: they are listed as V4L2 devices.
pub fn list_devices() -> DeviceListing {
    let missing = "on Linux these are the cameras of v4l2: index = N is /dev/videoN, name = \"…\" is the name above";
    DeviceListing { backend: "uvc", devices: Vec::new(), missing: Some(missing.to_owned()) }
}
