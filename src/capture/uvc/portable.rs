//! Cameras through `nokhwa`, whose wait for a frame has no end: a thread of its own waits, and is
//! left behind when its camera never answers again.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::Duration;

use nokhwa::utils::{
    ApiBackend, CameraFormat, CameraIndex, CameraInfo, FrameFormat, RequestedFormat,
    RequestedFormatType, Resolution,
};
use nokhwa::{Buffer, NokhwaError};

use crate::capture::device_list::{DeviceListing, ListedDevice};
use crate::capture::host_clock::now;
use crate::capture::mode::ModeRequest;
use crate::capture::uvc::options::{Selector, UvcOptions};
use crate::capture::{CaptureError, FrameSource, Losses, SourceDescription, SourceOpener};
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};

const DEFAULT_FPS: u32 = 30;
const DEFAULT_SIZE: Resolution = Resolution { width_x: 640, height_y: 480 };
/// How long a camera may take to open.
const OPENING: Duration = Duration::from_secs(10);
/// Frames between the waiting thread and the reader; more would only be old ones.
const QUEUE: usize = 2;
const FORMATS: [(FrameFormat, &str, PixelFormat); 6] = [
    (FrameFormat::GRAY, "GREY", PixelFormat::Mono8),
    (FrameFormat::NV12, "NV12", PixelFormat::Nv12),
    (FrameFormat::YUYV, "YUYV", PixelFormat::Yuyv),
    (FrameFormat::MJPEG, "MJPG", PixelFormat::Jpeg),
    (FrameFormat::RAWRGB, "RGB3", PixelFormat::Rgb8),
    (FrameFormat::RAWBGR, "BGR3", PixelFormat::Bgr8),
];

/// A camera that may come and go.
#[derive(Debug)]
pub struct UvcCamera {
    options: UvcOptions,
    next_sequence: Arc<AtomicU64>,
}

impl UvcCamera {
    /// A camera that is not opened yet.
    pub fn new(options: UvcOptions) -> Self {
        Self { options, next_sequence: Arc::default() }
    }
}

impl SourceOpener for UvcCamera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        let info = find(&self.options.selector)?;
        let name = info.human_name();
        let format = requested(&self.options.mode)?;
        let shared = Arc::new(SharedFrames::default());
        let (frames, received) = sync_channel(QUEUE);
        let (opened, opening) = sync_channel(1);
        let waiting = Waiting { frames, shared: Arc::clone(&shared), name: name.clone() };
        let index = info.index().clone();
        let started = thread::Builder::new()
            .name(format!("uvc-{index}"))
            .spawn(move || waiting.run(index, format, &opened));
        started.map_err(|error| CaptureError::Failed {
            reason: format!("no thread for {name}: {error}"),
        })?;
        let silent = |_| lost(&name, "it does not open within 10 s; plug it in again".to_owned());
        let mode = opening.recv_timeout(OPENING).map_err(silent)??;
        let next_sequence = Arc::clone(&self.next_sequence);
        Ok(Box::new(UvcSource { name, mode, received, shared, next_sequence }))
    }
}

/// What the waiting thread and the reader share.
#[derive(Debug, Default)]
struct SharedFrames {
    stop: AtomicBool,
    missed: AtomicU64,
    damaged: AtomicU64,
}

/// The side that waits for the camera.
struct Waiting {
    frames: SyncSender<Result<Frame, CaptureError>>,
    shared: Arc<SharedFrames>,
    name: String,
}

impl Waiting {
    fn run(
        self,
        index: CameraIndex,
        format: RequestedFormat<'static>,
        opened: &SyncSender<Result<CameraFormat, CaptureError>>,
    ) {
        let camera = nokhwa::Camera::new(index, format)
            .and_then(|mut camera| camera.open_stream().map(|()| camera));
        let mut camera = match camera {
            Ok(camera) => camera,
            Err(error) => {
                // Whoever asked may have stopped waiting.
                let _ = opened.send(Err(lost(&self.name, in_words(&error))));
                return;
            }
        };
        let _ = opened.send(Ok(camera.camera_format()));
        while !self.shared.stop.load(Ordering::Relaxed) {
            let outcome = camera.frame().map_err(|error| lost(&self.name, in_words(&error)));
            let last = outcome.is_err();
            let frame = match outcome.map(|buffer| frame_of(&buffer)) {
                Ok(None) => {
                    self.shared.damaged.fetch_add(1, Ordering::Relaxed);
                    continue;
                }
                Ok(Some(frame)) => Ok(frame),
                Err(error) => Err(error),
            };
            match self.frames.try_send(frame) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) => {
                    self.shared.missed.fetch_add(1, Ordering::Relaxed);
                }
                Err(TrySendError::Disconnected(_)) => return,
            }
            if last {
                return;
            }
        }
    }
}

/// The side that is read.
struct UvcSource {
    name: String,
    mode: CameraFormat,
    received: Receiver<Result<Frame, CaptureError>>,
    shared: Arc<SharedFrames>,
    next_sequence: Arc<AtomicU64>,
}

impl FrameSource for UvcSource {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        let frame = self.received.recv_timeout(timeout).map_err(|error| match error {
            RecvTimeoutError::Timeout => CaptureError::TimedOut { waited: timeout },
            RecvTimeoutError::Disconnected => lost(&self.name, "it stopped".to_owned()),
        })??;
        let sequence = self.next_sequence.fetch_add(1, Ordering::Relaxed);
        Ok(FrameSet {
            sequence,
            host_time: now(),
            device_time: None,
            name: None,
            frames: vec![frame],
        })
    }

    fn description(&self) -> SourceDescription {
        SourceDescription {
            kind: "uvc",
            identity: self.name.clone(),
            fps: Some(f64::from(self.mode.frame_rate())),
            model: Some(self.name.clone()),
            mode: Some(format!("{}, {}", self.name, self.mode)),
            ..SourceDescription::default()
        }
    }

    fn losses(&self) -> Losses {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Losses { missed: count(&self.shared.missed), damaged: count(&self.shared.damaged) }
    }
}

impl Drop for UvcSource {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

/// Every camera that the system lists.
pub fn list_devices() -> DeviceListing {
    let listing = |devices, missing| DeviceListing { backend: "uvc", devices, missing };
    match nokhwa::query(ApiBackend::Auto) {
        Ok(cameras) if cameras.is_empty() => {
            listing(Vec::new(), Some("no camera is plugged in".to_owned()))
        }
        Ok(cameras) => listing(cameras.iter().map(listed).collect(), None),
        Err(error) => listing(Vec::new(), Some(in_words(&error))),
    }
}

fn listed(camera: &CameraInfo) -> ListedDevice {
    ListedDevice {
        name: camera.human_name(),
        identity: camera.human_name(),
        paths: vec![camera.index().to_string()],
        driver: Some(camera.description().to_owned()),
        ..ListedDevice::default()
    }
}

fn find(selector: &Selector) -> Result<CameraInfo, CaptureError> {
    let wanted = match selector {
        Selector::Index(index) => format!("camera {index}"),
        Selector::Name(name) => name.clone(),
    };
    let cameras =
        nokhwa::query(ApiBackend::Auto).map_err(|error| lost(&wanted, in_words(&error)))?;
    let names: Vec<String> = cameras.iter().map(CameraInfo::human_name).collect();
    let meant = |camera: &CameraInfo| match selector {
        Selector::Index(index) => *camera.index() == CameraIndex::Index(*index),
        Selector::Name(name) => camera.human_name() == *name,
    };
    let absent = || match names.is_empty() {
        true => "no camera is plugged in".to_owned(),
        false => format!("it is not plugged in; there are {}", names.join(", ")),
    };
    cameras.into_iter().find(meant).ok_or_else(|| lost(&wanted, absent()))
}

fn requested(mode: &ModeRequest) -> Result<RequestedFormat<'static>, CaptureError> {
    const ALL: [FrameFormat; 6] = [
        FrameFormat::GRAY,
        FrameFormat::NV12,
        FrameFormat::YUYV,
        FrameFormat::MJPEG,
        FrameFormat::RAWRGB,
        FrameFormat::RAWBGR,
    ];
    let size = mode.size.map_or(DEFAULT_SIZE, |size| Resolution::new(size.width, size.height));
    let fps = mode.fps.map_or(DEFAULT_FPS, |fps| fps.round() as u32);
    let Some(name) = &mode.format else {
        let requested = CameraFormat::new(size, FrameFormat::MJPEG, fps);
        return Ok(RequestedFormat::with_formats(RequestedFormatType::Closest(requested), &ALL));
    };
    let known = FORMATS.iter().find(|(_, known, _)| known.eq_ignore_ascii_case(name));
    let names: Vec<&str> = FORMATS.iter().map(|(_, name, _)| *name).collect();
    let unknown = || CaptureError::Failed {
        reason: format!("no format {name}; write one of {}", names.join(", ")),
    };
    let (format, ..) = known.ok_or_else(unknown)?;
    let requested = CameraFormat::new(size, *format, fps);
    Ok(RequestedFormat::with_formats(RequestedFormatType::Closest(requested), &ALL))
}

/// A buffer as a frame; `None` when it holds less than it should, or a format that is not read.
fn frame_of(buffer: &Buffer) -> Option<Frame> {
    let (.., format) =
        *FORMATS.iter().find(|(format, ..)| *format == buffer.source_frame_format())?;
    let resolution = buffer.resolution();
    let size = ImageSize::new(resolution.width(), resolution.height());
    let stride = format.bytes_per_pixel().unwrap_or(0) * size.width as usize;
    let bytes = buffer.buffer();
    let whole = if format == PixelFormat::Jpeg {
        bytes.starts_with(&[0xff, 0xd8])
    } else {
        bytes.len() >= stride * size.height as usize
    };
    whole.then(|| Frame {
        sensor: SensorKind::Color,
        size,
        format,
        stride,
        bytes: Arc::from(bytes),
    })
}

fn lost(device: &str, reason: String) -> CaptureError {
    CaptureError::Lost { device: device.to_owned(), reason }
}

fn in_words(error: &NokhwaError) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
