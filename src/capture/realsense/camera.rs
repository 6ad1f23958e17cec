//! A configured RealSense camera: opened by serial number, again and again.

use std::collections::HashSet;
use std::ffi::CString;
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use realsense_rust::config::Config;
use realsense_rust::context::Context;
use realsense_rust::device::Device;
use realsense_rust::kind::{Rs2CameraInfo, Rs2Format, Rs2Option, Rs2StreamKind};
use realsense_rust::pipeline::{ActivePipeline, InactivePipeline};
use realsense_rust::sensor::Sensor;
use realsense_rust::stream_profile::StreamProfile;

use crate::capture::realsense::bag_file::check_bag;
use crate::capture::realsense::factory::sensor_of;
use crate::capture::realsense::options::{Origin, RealsenseOptions};
use crate::capture::realsense::settings::Settings;
use crate::capture::realsense::source::{OpenedPipeline, RealsenseSource};
use crate::capture::realsense::stated::stated;
use crate::capture::{CaptureError, FrameSource, SourceOpener};
use crate::imaging::frame::SensorKind;
use crate::locks::lock;

/// Frames a second where none are asked for.
const DEFAULT_FPS: usize = 30;
/// Consecutive openings without a frame after which the device is reset.
const OPENINGS_BEFORE_RESET: u32 = 3;

/// A RealSense camera, which may be unplugged and plugged in again.
#[derive(Debug)]
pub struct RealsenseCamera {
    options: RealsenseOptions,
    /// The library's, where the program has one; else each opening makes its own.
    context: Option<Arc<Mutex<Context>>>,
    /// The device that was opened first, where none was named.
    serial: Option<String>,
    next_sequence: Arc<AtomicU64>,
    /// Consecutive openings without a frame.
    barren: Arc<AtomicU32>,
}

impl RealsenseCamera {
    /// A camera that is not opened yet.
    pub fn new(options: RealsenseOptions) -> Self {
        Self {
            options,
            context: None,
            serial: None,
            next_sequence: Arc::default(),
            barren: Arc::default(),
        }
    }

    /// A camera among those that `context` lists: a program's own context also has the software
    /// devices that it added.
    pub fn in_context(options: RealsenseOptions, context: Arc<Mutex<Context>>) -> Self {
        Self { context: Some(context), ..Self::new(options) }
    }

    fn open_source(&mut self) -> Result<RealsenseSource, CaptureError> {
        let shared = match &self.context {
            Some(context) => Arc::clone(context),
            None => {
                let new = Context::new()
                    .map_err(|error| failed(&format!("librealsense2 does not start: {error}")))?;
                Arc::new(Mutex::new(new))
            }
        };
        let (pipeline, name) = self.started(&lock(&shared))?;
        self.barren.fetch_add(1, Ordering::Relaxed);
        let is_bag = matches!(self.options.origin, Origin::Bag(_));
        if !is_bag {
            set(pipeline.profile().device(), self.options.settings)
                .map_err(|problem| failed(&format!("{name}: {problem}")))?;
        }
        let (next_sequence, barren) = (Arc::clone(&self.next_sequence), Arc::clone(&self.barren));
        Ok(RealsenseSource::new(OpenedPipeline {
            context: shared,
            pipeline,
            name,
            is_bag,
            next_sequence,
            barren,
        }))
    }

    fn started(&mut self, context: &Context) -> Result<(ActivePipeline, String), CaptureError> {
        let (config, name) = match self.options.origin.clone() {
            Origin::Bag(path) => (bag_config(&path)?, path.display().to_string()),
            Origin::Serial(serial) => self.device_config(context, Some(serial))?,
            Origin::OnlyDevice => self.device_config(context, self.serial.clone())?,
        };
        let pipeline =
            InactivePipeline::try_from(context).map_err(|error| failed(&error.to_string()))?;
        let unresolved = |error| match &self.options.origin {
            Origin::Bag(_) => failed(&format!("{name}: the library cannot play it: {error}")),
            _ => CaptureError::Lost {
                device: name.clone(),
                reason: format!("it does not start: {error}; is another program using it?"),
            },
        };
        Ok((pipeline.start(Some(config)).map_err(unresolved)?, name))
    }

    /// How to start the device with this serial number, or the only one.
    fn device_config(
        &mut self,
        context: &Context,
        serial: Option<String>,
    ) -> Result<(Config, String), CaptureError> {
        let wanted = serial.clone().unwrap_or_else(|| "the RealSense camera".to_owned());
        let lost = |reason: String| CaptureError::Lost { device: wanted.clone(), reason };
        let mut devices = context.query_devices(HashSet::new());
        let serials: Vec<String> =
            devices.iter().filter_map(|d| stated(d, Rs2CameraInfo::SerialNumber)).collect();
        let Some(serial) = serial.or_else(|| serials.first().cloned()) else {
            return Err(lost("no RealSense camera is plugged in".to_owned()));
        };
        if self.options.origin == Origin::OnlyDevice && self.serial.is_none() && serials.len() > 1 {
            let problem = format!(
                "several RealSense cameras are plugged in: write serial = one of {}",
                serials.join(", ")
            );
            return Err(failed(&problem));
        }
        let Some(at) = serials.iter().position(|found| *found == serial) else {
            let others = if serials.is_empty() {
                "no RealSense camera".to_owned()
            } else {
                serials.join(", ")
            };
            return Err(lost(format!("it is not plugged in; connected: {others}")));
        };
        if self.barren.load(Ordering::Relaxed) >= OPENINGS_BEFORE_RESET {
            self.barren.store(0, Ordering::Relaxed);
            devices.swap_remove(at).hardware_reset();
            return Err(lost(format!(
                "it was opened {OPENINGS_BEFORE_RESET} times without delivering a frame, and was reset"
            )));
        }
        let config =
            self.stream_config(&devices[at], &serial).map_err(|problem| failed(&problem))?;
        self.serial = Some(serial.clone());
        Ok((config, serial))
    }

    /// Every stream that the device has and that we read, one each of color, depth, left and right
    /// infrared.
    fn stream_config(&self, device: &Device, serial: &str) -> Result<Config, String> {
        let (width, height) = self
            .options
            .mode
            .size
            .map_or((0, 0), |size| (size.width as usize, size.height as usize));
        let fps = self.options.mode.fps.map_or(DEFAULT_FPS, |fps| fps.round() as usize);
        let number =
            CString::new(serial).map_err(|_| format!("{serial:?} is not a valid serial number"))?;
        let offered: Vec<StreamProfile> =
            device.sensors().iter().flat_map(Sensor::stream_profiles).collect();
        let mut config = Config::new();
        config.enable_device_from_serial(&number).map_err(|error| error.to_string())?;
        for sensor in SensorKind::ALL {
            let format = format_of(sensor);
            let has = |stream: &&StreamProfile| {
                sensor_of(stream) == Some(sensor) && stream.format() == format
            };
            let Some(stream) = offered.iter().find(has) else { continue };
            let index = (stream.kind() == Rs2StreamKind::Infrared).then(|| stream.index());
            config
                .enable_stream(stream.kind(), index, width, height, format, fps)
                .map_err(|error| format!("{serial}: {}: {error}", sensor.name()))?;
        }
        Ok(config)
    }
}

/// The profile requested of a sensor's stream.
fn format_of(sensor: SensorKind) -> Rs2Format {
    match sensor {
        SensorKind::Color => Rs2Format::Rgb8,
        SensorKind::Infrared | SensorKind::Infrared2 => Rs2Format::Y8,
        SensorKind::Depth => Rs2Format::Z16,
    }
}

impl SourceOpener for RealsenseCamera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        Ok(Box::new(self.open_source()?))
    }
}

fn bag_config(path: &Path) -> Result<Config, CaptureError> {
    check_bag(path)?;
    let mut config = Config::new();
    let enabled = config.enable_device_from_file(path, false).map(|_| ());
    enabled.map_err(|error| failed(&format!("{}: {error}", path.display())))?;
    Ok(config)
}

/// Applies the settings, each to the sensor of the device that supports it.
fn set(device: &Device, settings: Settings) -> Result<(), String> {
    let preset = settings
        .preset
        .map(|preset| (Rs2Option::VisualPreset, "preset", f32::from(preset.number())));
    let emitter =
        settings.emitter.map(|on| (Rs2Option::EmitterEnabled, "emitter", f32::from(u8::from(on))));
    for (option, key, value) in [preset, emitter].into_iter().flatten() {
        let takes =
            |sensor: &Sensor| sensor.supports_option(option) && !sensor.is_option_read_only(option);
        let mut sensor = device
            .sensors()
            .into_iter()
            .find(takes)
            .ok_or_else(|| format!("this device has no {key}: remove `{key}`"))?;
        sensor
            .set_option(option, value)
            .map_err(|error| format!("`{key}` cannot be set: {error}"))?;
    }
    Ok(())
}

fn failed(reason: &str) -> CaptureError {
    CaptureError::Failed { reason: reason.to_owned() }
}
