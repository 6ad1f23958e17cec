//! `plumb devices`: lists the cameras that each backend finds, and what is missing where one finds
//! none.

use serde::Serialize;

use crate::capture::device_list::{
    DeviceListing, ListedControl, ListedDevice, ListedFormat, ListedSize,
};
use crate::cli::{Failure, output};
use crate::geometry::pixel::ImageSize;

/// List the cameras that each backend finds, with their formats and stable names
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Lists the devices.
///
/// # Errors
/// When stdout cannot be written to; a backend without cameras states the reason, and is no
/// failure.
pub fn run(args: &Args) -> Result<(), Failure> {
    let listings = crate::capture::list_devices();
    if args.json {
        return output::print_json(&DevicesDocument {
            backends: listings.iter().map(BackendDocument::from).collect(),
        });
    }
    listings.iter().try_for_each(print_listing)
}

fn print_listing(listing: &DeviceListing) -> Result<(), Failure> {
    match &listing.missing {
        Some(missing) => output::print_line(&format!("{}: {missing}", listing.backend))?,
        None => output::print_line(&format!("{}:", listing.backend))?,
    }
    let key = match listing.backend {
        "ros2" => "topic",
        "realsense" => "serial",
        "uvc" => "name",
        _ => "device",
    };
    listing.devices.iter().try_for_each(|device| print_device(key, device))
}

fn print_device(key: &str, device: &ListedDevice) -> Result<(), Failure> {
    output::print_line(&format!("  {}   {key} = \"{}\"", device.name, device.identity))?;
    let facts = [
        (
            "also",
            Some(
                device
                    .paths
                    .iter()
                    .filter(|path| **path != device.identity)
                    .cloned()
                    .collect::<Vec<_>>()
                    .join(" "),
            ),
        ),
        ("serial", device.serial.clone()),
        ("at", device.bus.clone()),
        ("driver", device.driver.clone()),
        ("firmware", device.firmware.clone()),
        ("in use by", device.in_use_by.clone()),
        ("problem", device.problem.clone()),
    ];
    for (name, fact) in facts {
        if let Some(fact) = fact.filter(|fact| !fact.is_empty()) {
            output::print_line(&format!("    {name}: {fact}"))?;
        }
    }
    for format in device.formats.iter().filter(|format| format.read) {
        let sizes: Vec<String> = format.sizes.iter().map(size_in_words).collect();
        output::print_line(&format!("    {}: {}", format.name, sizes.join(", ")))?;
    }
    let unread: Vec<&str> =
        device.formats.iter().filter(|format| !format.read).map(|f| f.name.as_str()).collect();
    if !unread.is_empty() {
        output::print_line(&format!("    formats that Plumb does not read: {}", unread.join(" ")))?;
    }
    let controls: Vec<String> = device.controls.iter().map(control_in_words).collect();
    if controls.is_empty() {
        Ok(())
    } else {
        output::print_line(&format!("    controls: {}", controls.join(", ")))
    }
}

fn size_in_words(size: &ListedSize) -> String {
    let rates: Vec<String> =
        size.fps.iter().map(|fps| format!("{}", (fps * 100.0).round() / 100.0)).collect();
    let rates = if rates.is_empty() { String::new() } else { format!(" @ {}", rates.join("/")) };
    match size.range {
        Some(range) => format!("{} to {}{rates}", range.smallest, size.size),
        None => format!("{}{rates}", size.size),
    }
}

fn control_in_words(control: &ListedControl) -> String {
    let value = control.value.map(|value| format!(" = {value}")).unwrap_or_default();
    format!("{}{value} ({} to {})", control.name, control.minimum, control.maximum)
}

#[derive(Debug, Serialize)]
struct DevicesDocument<'a> {
    backends: Vec<BackendDocument<'a>>,
}

#[derive(Debug, Serialize)]
struct BackendDocument<'a> {
    backend: &'a str,
    missing: Option<&'a str>,
    devices: Vec<DeviceDocument<'a>>,
}

#[derive(Debug, Serialize)]
struct DeviceDocument<'a> {
    name: &'a str,
    device: &'a str,
    paths: &'a [String],
    serial: Option<&'a str>,
    bus: Option<&'a str>,
    driver: Option<&'a str>,
    firmware: Option<&'a str>,
    in_use_by: Option<&'a str>,
    problem: Option<&'a str>,
    formats: Vec<FormatDocument<'a>>,
    controls: Vec<ControlDocument<'a>>,
}

#[derive(Debug, Serialize)]
struct FormatDocument<'a> {
    name: &'a str,
    description: &'a str,
    read: bool,
    sizes: Vec<SizeDocument<'a>>,
}

#[derive(Debug, Serialize)]
struct SizeDocument<'a> {
    size: [u32; 2],
    smallest: Option<[u32; 2]>,
    step: Option<[u32; 2]>,
    fps: &'a [f64],
}

#[derive(Debug, Serialize)]
struct ControlDocument<'a> {
    name: &'a str,
    value: Option<i64>,
    minimum: i64,
    maximum: i64,
    default: i64,
}

impl<'a> From<&'a DeviceListing> for BackendDocument<'a> {
    fn from(listing: &'a DeviceListing) -> Self {
        let devices = listing.devices.iter().map(DeviceDocument::from).collect();
        Self { backend: listing.backend, missing: listing.missing.as_deref(), devices }
    }
}

impl<'a> From<&'a ListedDevice> for DeviceDocument<'a> {
    fn from(device: &'a ListedDevice) -> Self {
        Self {
            name: &device.name,
            device: &device.identity,
            paths: &device.paths,
            serial: device.serial.as_deref(),
            bus: device.bus.as_deref(),
            driver: device.driver.as_deref(),
            firmware: device.firmware.as_deref(),
            in_use_by: device.in_use_by.as_deref(),
            problem: device.problem.as_deref(),
            formats: device.formats.iter().map(FormatDocument::from).collect(),
            controls: device.controls.iter().map(ControlDocument::from).collect(),
        }
    }
}

impl<'a> From<&'a ListedFormat> for FormatDocument<'a> {
    fn from(format: &'a ListedFormat) -> Self {
        let sizes = format.sizes.iter().map(SizeDocument::from).collect();
        Self { name: &format.name, description: &format.description, read: format.read, sizes }
    }
}

impl<'a> From<&'a ListedSize> for SizeDocument<'a> {
    fn from(size: &'a ListedSize) -> Self {
        let pair = |size: ImageSize| [size.width, size.height];
        Self {
            size: pair(size.size),
            smallest: size.range.map(|range| pair(range.smallest)),
            step: size.range.map(|range| pair(range.step)),
            fps: &size.fps,
        }
    }
}

impl<'a> From<&'a ListedControl> for ControlDocument<'a> {
    fn from(control: &'a ListedControl) -> Self {
        let ListedControl { name, value, minimum, maximum, default } = control;
        Self { name, value: *value, minimum: *minimum, maximum: *maximum, default: *default }
    }
}
