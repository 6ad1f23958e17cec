//! What each backend sees on this machine, and what is missing where it sees nothing.

use crate::geometry::pixel::ImageSize;

/// What one backend sees.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceListing {
    /// The kind of source, as in the configuration.
    pub backend: &'static str,
    /// The devices, in the system's order.
    pub devices: Vec<ListedDevice>,
    /// Why there are none, or fewer than there could be, and what to do about it.
    pub missing: Option<String>,
}

/// One device.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ListedDevice {
    /// Its own name.
    pub name: String,
    /// What to write in the configuration so that it is always found again.
    pub identity: String,
    /// Every other name that leads to it, stable ones first.
    pub paths: Vec<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// Where it is plugged in.
    pub bus: Option<String>,
    /// Its driver.
    pub driver: Option<String>,
    /// Its firmware.
    pub firmware: Option<String>,
    /// The processes that have it open.
    pub in_use_by: Option<String>,
    /// What it can be set to.
    pub formats: Vec<ListedFormat>,
    /// Its controls.
    pub controls: Vec<ListedControl>,
    /// Why it cannot be used, and what to do about it.
    pub problem: Option<String>,
}

/// A pixel format of a device.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedFormat {
    /// Its four-character code, as in `MJPG`.
    pub name: String,
    /// The driver's words for it.
    pub description: String,
    /// Whether Plumb reads it.
    pub read: bool,
    /// The sizes it comes in.
    pub sizes: Vec<ListedSize>,
}

/// A size, or a range of sizes.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedSize {
    /// The size; of a range, the largest.
    pub size: ImageSize,
    /// The rest of the range.
    pub range: Option<SizeRange>,
    /// Frames a second, highest first; of a continuous range its two ends.
    pub fps: Vec<f64>,
}

impl ListedSize {
    /// One size, with no rates known.
    pub fn new(size: ImageSize) -> Self {
        Self { size, range: None, fps: Vec::new() }
    }
}

/// Where a range of sizes begins, and its steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SizeRange {
    /// The smallest size.
    pub smallest: ImageSize,
    /// From one size to the next.
    pub step: ImageSize,
}

/// A control of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedControl {
    /// Its name, as `controls = { … }` takes it.
    pub name: String,
    /// Its present value.
    pub value: Option<i64>,
    /// Its smallest value.
    pub minimum: i64,
    /// Its largest value.
    pub maximum: i64,
    /// The value it starts with.
    pub default: i64,
}
