//! RealSense cameras and their recordings: `kind = "realsense"`, through Intel's own library.
//!
//! The library is needed to build and to run, so that this is the cargo feature `realsense`, off
//! unless asked for. A build without it has the same names, and says what is missing.

mod bag_file;
#[cfg(feature = "realsense")]
mod camera;
#[cfg(feature = "realsense")]
mod factory;
#[cfg(feature = "realsense")]
mod listing;
#[cfg(feature = "realsense")]
mod pixels;
mod settings;
#[cfg(feature = "realsense")]
mod source;
#[cfg(not(feature = "realsense"))]
mod without;

use std::path::PathBuf;

#[cfg(feature = "realsense")]
pub use camera::RealsenseCamera;
#[cfg(feature = "realsense")]
pub use listing::list_devices;
#[cfg(not(feature = "realsense"))]
pub use without::{RealsenseCamera, list_devices};

pub use settings::{Preset, Settings};

use crate::capture::mode::ModeRequest;

/// Which device, and how it is to be set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RealsenseOptions {
    /// Where its frames come from; default: the only device there is.
    pub origin: Origin,
    /// Size and rate of every stream; default: the device's own.
    pub mode: ModeRequest,
    /// Extra device settings; ignored for .bag playback.
    pub settings: Settings,
}

/// A device or a recording of one.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Origin {
    /// The only device there is.
    #[default]
    OnlyDevice,
    /// The device with this serial number.
    Serial(String),
    /// A .bag file that the library recorded.
    Bag(PathBuf),
}
