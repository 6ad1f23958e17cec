//! What a device states about itself.

use realsense_rust::device::Device;
use realsense_rust::kind::Rs2CameraInfo;

/// What a device states about itself.
pub(super) fn stated(device: &Device, what: Rs2CameraInfo) -> Option<String> {
    device.info(what).map(|text| text.to_string_lossy().into_owned())
}
