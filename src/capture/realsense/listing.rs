//! What `plumb devices` lists of RealSense cameras.

use std::collections::HashSet;

use realsense_rust::context::Context;
use realsense_rust::device::Device;
use realsense_rust::kind::Rs2CameraInfo;

use crate::capture::device_list::{DeviceListing, ListedDevice, ListedFormat, ListedSize};
use crate::capture::realsense::factory::sensor_of;
use crate::capture::realsense::stated::stated;
use crate::geometry::pixel::ImageSize;

/// Every RealSense camera that the library sees.
pub fn list_devices() -> DeviceListing {
    let listing = |devices, missing| DeviceListing { backend: "realsense", devices, missing };
    let context = match Context::new() {
        Ok(context) => context,
        Err(error) => {
            return listing(Vec::new(), Some(format!("librealsense2 does not start: {error}")));
        }
    };
    let devices: Vec<ListedDevice> =
        context.query_devices(HashSet::new()).iter().map(listed).collect();
    let missing = devices.is_empty().then(|| {
        "the library sees no camera: plug one into a USB 3 socket, and install Intel's udev rules if only root sees it"
            .to_owned()
    });
    listing(devices, missing)
}

fn listed(device: &Device) -> ListedDevice {
    let serial = stated(device, Rs2CameraInfo::SerialNumber);
    ListedDevice {
        name: stated(device, Rs2CameraInfo::Name).unwrap_or_default(),
        identity: serial.clone().unwrap_or_default(),
        serial,
        bus: stated(device, Rs2CameraInfo::PhysicalPort),
        driver: stated(device, Rs2CameraInfo::UsbTypeDescriptor)
            .map(|version| format!("USB {version}")),
        firmware: stated(device, Rs2CameraInfo::FirmwareVersion),
        formats: formats_of(device),
        ..ListedDevice::default()
    }
}

/// One entry a sensor and format, with the sizes and rates of each.
fn formats_of(device: &Device) -> Vec<ListedFormat> {
    let mut formats: Vec<ListedFormat> = Vec::new();
    for stream in device.sensors().iter().flat_map(realsense_rust::sensor::Sensor::stream_profiles)
    {
        let (Some(sensor), Ok(intrinsics)) = (sensor_of(&stream), stream.intrinsics()) else {
            continue;
        };
        let name = format!("{} {:?}", sensor.name(), stream.format());
        let size = ImageSize::new(intrinsics.width() as u32, intrinsics.height() as u32);
        let at = formats.iter().position(|format| format.name == name).unwrap_or_else(|| {
            formats.push(ListedFormat {
                name,
                description: String::new(),
                read: true,
                sizes: Vec::new(),
            });
            formats.len() - 1
        });
        let sizes = &mut formats[at].sizes;
        let at = sizes.iter().position(|listed| listed.size == size).unwrap_or_else(|| {
            sizes.push(ListedSize::new(size));
            sizes.len() - 1
        });
        sizes[at].fps.push(f64::from(stream.framerate()));
    }
    formats
}
