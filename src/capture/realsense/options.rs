//! Which device, and how it is to be set.

use std::path::PathBuf;

use crate::capture::mode::ModeRequest;
use crate::capture::realsense::settings::Settings;

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
