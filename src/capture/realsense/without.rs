//! A build without RealSense support: it says so.

use crate::capture::device_list::DeviceListing;
use crate::capture::realsense::bag_file::check_bag;
use crate::capture::realsense::options::{Origin, RealsenseOptions};
use crate::capture::{CaptureError, FrameSource, SourceOpener};

/// A RealSense camera that cannot be opened.
#[derive(Debug)]
pub struct RealsenseCamera {
    options: RealsenseOptions,
}

impl RealsenseCamera {
    /// As configured.
    pub fn new(options: RealsenseOptions) -> Self {
        Self { options }
    }
}

impl SourceOpener for RealsenseCamera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        if let Origin::Bag(path) = &self.options.origin {
            check_bag(path)?;
        }
        let reason = "this build has no RealSense support: install Intel's librealsense2 and build with \
                      `cargo build --features realsense`";
        Err(CaptureError::Failed { reason: reason.to_owned() })
    }
}

/// None, and why.
pub fn list_devices() -> DeviceListing {
    let missing = "not in this build: install Intel's librealsense2 and build with `cargo build --features realsense`";
    DeviceListing { backend: "realsense", devices: Vec::new(), missing: Some(missing.to_owned()) }
}
