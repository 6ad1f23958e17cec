//! The stream of frame sets of a started device or recording.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use realsense_rust::context::Context;
use realsense_rust::frame::{
    ColorFrame, CompositeFrame, DepthFrame, FrameEx, ImageFrame, InfraredFrame,
};
use realsense_rust::kind::{Rs2CameraInfo, Rs2Format, Rs2Option};
use realsense_rust::pipeline::{ActivePipeline, FrameWaitError};
use realsense_rust::sensor::Sensor;

use crate::capture::frame_counter::FrameCounter;
use crate::capture::host_clock::now;
use crate::capture::realsense::factory::{factory_calibration, sensor_of};
use crate::capture::realsense::pixels::pixels_of;
use crate::capture::realsense::stated::stated;
use crate::capture::{CaptureError, FrameSource, Losses, SourceDescription};
use crate::geometry::pixel::ImageSize;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat};
use crate::imaging::timestamp::DeviceTime;

/// A recording that has been silent for so long is over: the library does not report its end.
const END_OF_BAG_SILENCE: Duration = Duration::from_millis(1300);

/// A started pipeline.
#[derive(Debug)]
pub(super) struct OpenedPipeline {
    pub context: Arc<Mutex<Context>>,
    pub pipeline: ActivePipeline,
    /// The serial number, or the file.
    pub name: String,
    pub is_bag: bool,
    pub next_sequence: Arc<AtomicU64>,
    pub barren: Arc<AtomicU32>,
}

/// A streaming device or recording.
pub(super) struct RealsenseSource {
    /// `None` only while it is being closed.
    pipeline: Option<ActivePipeline>,
    description: SourceDescription,
    is_bag: bool,
    next_sequence: Arc<AtomicU64>,
    barren: Arc<AtomicU32>,
    counter: FrameCounter,
    losses: Losses,
    heard: Instant,
    /// Options changed for a session, with what they were.
    before_session: Vec<(Rs2Option, f32)>,
    /// Outlives the pipeline, which belongs to it.
    _context: Arc<Mutex<Context>>,
}

impl RealsenseSource {
    pub fn new(opened: OpenedPipeline) -> Self {
        let description = describe(&opened);
        let OpenedPipeline { context, pipeline, is_bag, next_sequence, barren, .. } = opened;
        Self {
            pipeline: Some(pipeline),
            description,
            is_bag,
            counter: FrameCounter::new(next_sequence.load(Ordering::Relaxed)),
            next_sequence,
            barren,
            losses: Losses::default(),
            heard: Instant::now(),
            before_session: Vec::new(),
            _context: context,
        }
    }

    fn frame_set(&mut self, composite: &CompositeFrame) -> Option<FrameSet> {
        let color = composite.frames_of_type::<ColorFrame>();
        let infrared = composite.frames_of_type::<InfraredFrame>();
        let depth = composite.frames_of_type::<DepthFrame>();
        let mut frames: Vec<Frame> = color.iter().filter_map(frame_of).collect();
        frames.extend(infrared.iter().filter_map(frame_of));
        frames.extend(depth.iter().filter_map(frame_of));
        // The slowest to come of the frames taken together: its count has no gap that the others
        // don't have.
        let clock = depth
            .first()
            .map(moment)
            .or(color.first().map(moment))
            .or(infrared.first().map(moment));
        let (number, device_time) = clock.filter(|_| !frames.is_empty())?;
        self.losses.missed += self.counter.count(number);
        let sequence = self.counter.next() - 1;
        self.next_sequence.store(self.counter.next(), Ordering::Relaxed);
        self.barren.store(0, Ordering::Relaxed);
        Some(FrameSet {
            sequence,
            host_time: now(),
            device_time: Some(device_time),
            name: None,
            frames,
        })
    }

    fn silent(&self, timeout: Duration) -> CaptureError {
        if self.is_bag && self.heard.elapsed() >= END_OF_BAG_SILENCE {
            return CaptureError::Ended;
        }
        CaptureError::TimedOut { waited: timeout }
    }

    /// The device's sensors that have `option` and let it be set.
    fn sensors_with(&self, option: Rs2Option) -> Vec<Sensor> {
        let sensors =
            self.pipeline.iter().flat_map(|pipeline| pipeline.profile().device().sensors());
        sensors
            .filter(|sensor| sensor.supports_option(option) && !sensor.is_option_read_only(option))
            .collect()
    }

    fn change(&mut self, option: Rs2Option, value: f32) -> bool {
        for mut sensor in self.sensors_with(option) {
            let Some(old) = sensor.get_option(option) else { continue };
            if sensor.set_option(option, value).is_ok() {
                self.before_session.push((option, old));
                return true;
            }
        }
        false
    }
}

impl FrameSource for RealsenseSource {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let Some(pipeline) = &mut self.pipeline else { return Err(self.silent(timeout)) };
            match pipeline.wait(Some(left)) {
                Ok(composite) => {
                    self.heard = Instant::now();
                    if let Some(set) = self.frame_set(&composite) {
                        return Ok(set);
                    }
                    self.losses.damaged += 1;
                }
                Err(FrameWaitError::DidTimeoutBeforeFrameArrival) => {
                    return Err(self.silent(timeout));
                }
                Err(error) => {
                    let device = self.description.identity.clone();
                    return Err(CaptureError::Lost { device, reason: error.to_string() });
                }
            }
            if Instant::now() >= deadline {
                return Err(self.silent(timeout));
            }
        }
    }

    fn description(&self) -> SourceDescription {
        self.description.clone()
    }

    fn losses(&self) -> Losses {
        self.losses
    }

    /// The emitter's dots hide the board from the infrared sensor: it is on in every other frame
    /// where the device can do that, so that depth goes on, and off where it cannot.
    fn calibrating(&mut self, on: bool) -> Result<(), CaptureError> {
        if on {
            let _ = self.change(Rs2Option::EmitterOnOff, 1.0)
                || self.change(Rs2Option::EmitterEnabled, 0.0);
        } else {
            for (option, value) in std::mem::take(&mut self.before_session) {
                for mut sensor in self.sensors_with(option) {
                    // A device that is gone has nothing to be given back.
                    let _ = sensor.set_option(option, value);
                }
            }
        }
        Ok(())
    }
}

impl Drop for RealsenseSource {
    fn drop(&mut self) {
        let _ = self.calibrating(false);
        if let Some(pipeline) = self.pipeline.take() {
            drop(pipeline.stop());
        }
    }
}

fn describe(opened: &OpenedPipeline) -> SourceDescription {
    let profile = opened.pipeline.profile();
    let device = profile.device();
    let streams = profile.streams();
    let factory: FactoryCalibration = factory_calibration(device, streams);
    let stated = |what| stated(device, what);
    let modes = streams.iter().filter_map(|stream| {
        let sensor = sensor_of(stream)?;
        let size = factory.sensor(sensor)?.image_size;
        Some(format!(
            "{} {size} {:?} at {} frames a second",
            sensor.name(),
            stream.format(),
            stream.framerate()
        ))
    });
    let temperature =
        device.sensors().iter().find_map(|sensor| sensor.get_option(Rs2Option::AsicTemperature));
    let mut facts: Vec<String> = modes.collect();
    facts.extend(
        stated(Rs2CameraInfo::FirmwareVersion).map(|version| format!("firmware {version}")),
    );
    facts.extend(temperature.map(|degrees| format!("{degrees:.0} °C")));
    SourceDescription {
        kind: "realsense",
        identity: opened.name.clone(),
        fps: streams.iter().map(|stream| f64::from(stream.framerate())).reduce(f64::min),
        model: stated(Rs2CameraInfo::Name),
        serial: stated(Rs2CameraInfo::SerialNumber),
        bus: if opened.is_bag {
            Some(opened.name.clone())
        } else {
            stated(Rs2CameraInfo::PhysicalPort)
        },
        mode: Some(facts.join(", ")),
        factory,
        ..SourceDescription::default()
    }
}

fn moment<K>(frame: &ImageFrame<K>) -> (u64, DeviceTime)
where
    ImageFrame<K>: FrameEx,
{
    // The library counts milliseconds.
    (frame.frame_number(), DeviceTime { monotonic_ns: (frame.timestamp() * 1e6) as i64 })
}

/// A frame of a sensor and a format that are read; `None` for others.
fn frame_of<K>(frame: &ImageFrame<K>) -> Option<Frame>
where
    ImageFrame<K>: FrameEx,
{
    let stream = frame.stream_profile();
    let format = match stream.format() {
        Rs2Format::Z16 => PixelFormat::Depth16,
        Rs2Format::Y8 => PixelFormat::Mono8,
        Rs2Format::Y16 => PixelFormat::Mono16,
        Rs2Format::Rgb8 => PixelFormat::Rgb8,
        Rs2Format::Bgr8 => PixelFormat::Bgr8,
        Rs2Format::Yuyv => PixelFormat::Yuyv,
        Rs2Format::Uyvy => PixelFormat::Uyvy,
        _ => return None,
    };
    let size = ImageSize::new(frame.width() as u32, frame.height() as u32);
    Some(Frame {
        sensor: sensor_of(stream)?,
        size,
        format,
        stride: frame.stride(),
        bytes: pixels_of(frame),
    })
}
