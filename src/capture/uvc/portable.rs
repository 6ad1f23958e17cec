//! Cameras through `nokhwa`, whose wait for a frame has no end: a thread of its own waits, and is
//! left behind when its camera never answers again.

use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use nokhwa::utils::{
    ApiBackend, CameraFormat, CameraIndex, CameraInfo, RequestedFormat, RequestedFormatType,
};
#[cfg(target_os = "linux")]
use nokhwa::utils::{FrameFormat, Resolution};
use nokhwa::{Buffer, Camera, NokhwaError};

use crate::capture::device_list::{DeviceListing, ListedDevice};
use crate::capture::host_clock::now;
use crate::capture::mode::ModeRequest;
use crate::capture::uvc::options::{Selector, UvcOptions};
#[cfg(target_os = "linux")]
use crate::capture::uvc::portable_mode::KNOWN_ON_LINUX;
use crate::capture::uvc::portable_mode::{ALL, NATIVE, choose, in_words, pixel_format, size_of};
#[cfg(target_os = "linux")]
use crate::capture::v4l2;
use crate::capture::{CaptureError, FrameSource, Losses, SourceDescription, SourceOpener};
#[cfg(target_os = "linux")]
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::jpeg_length;
use crate::locks::lock;

/// How long a camera may take to open.
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);
/// How long a wait for a frame may take to end once nobody wants the frame: it ends with the frame,
/// and cameras give several a second.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);
/// Frames between the waiting thread and the reader; more would only be old ones.
const QUEUED_FRAMES: usize = 2;

/// A camera that may come and go.
#[derive(Debug)]
pub(super) struct PortableCamera {
    options: UvcOptions,
    next_sequence: Arc<AtomicU64>,
    last_wait: Option<Wait>,
}

impl PortableCamera {
    /// A camera that is not opened yet.
    pub(super) fn new(options: UvcOptions) -> Self {
        Self { options, next_sequence: Arc::default(), last_wait: None }
    }

    /// A camera that stopped answering holds its thread: no second one is begun, so that a camera
    /// never has more than one.
    fn end_last_wait(&mut self, name: &str) -> Result<(), CaptureError> {
        if self.last_wait.as_ref().is_none_or(Wait::ends) {
            return Ok(());
        }
        let reason = "it still does not answer; unplug it and plug it in again".to_owned();
        Err(lost(name, reason))
    }
}

impl SourceOpener for PortableCamera {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, CaptureError> {
        let info = find(&self.options.selector)?;
        let name = info.human_name();
        self.end_last_wait(&name)?;
        let shared = Arc::new(SharedFrames::default());
        let (frames, received) = sync_channel(QUEUED_FRAMES);
        let (opened, opening) = sync_channel(1);
        let (running, ended) = sync_channel(0);
        let waiting = Waiting {
            frames,
            shared: Arc::clone(&shared),
            name: name.clone(),
            mode: self.options.mode.clone(),
            _running: running,
        };
        let index = info.index().clone();
        let started = thread::Builder::new()
            .name(format!("uvc-{index}"))
            .spawn(move || waiting.run(index, &opened));
        started.map_err(|error| CaptureError::Failed {
            reason: format!("no thread for {name}: {error}"),
        })?;
        let wait = Wait(Arc::new(Mutex::new(ended)));
        self.last_wait = Some(wait.clone());
        let silent = |_| lost(&name, "it does not open within 10 s; plug it in again".to_owned());
        let mode = opening.recv_timeout(OPEN_TIMEOUT).map_err(silent)??;
        let words = in_words(mode, &self.options.mode);
        let next_sequence = Arc::clone(&self.next_sequence);
        Ok(Box::new(PortableSource { name, mode, words, received, shared, wait, next_sequence }))
    }
}

/// The thread that waits for a camera: a channel that closes when it has ended, and with it the
/// camera is free.
#[derive(Debug, Clone)]
struct Wait(Arc<Mutex<Receiver<Infallible>>>);

impl Wait {
    /// Whether it ends in time.
    fn ends(&self) -> bool {
        let ended = lock(&self.0);
        ended.recv_timeout(CLOSE_TIMEOUT) != Err(RecvTimeoutError::Timeout)
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
    mode: ModeRequest,
    _running: SyncSender<Infallible>,
}

impl Waiting {
    fn run(self, index: CameraIndex, opened: &SyncSender<Result<CameraFormat, CaptureError>>) {
        let (mut camera, mode) = match self.open(index) {
            Ok(opened) => opened,
            Err(error) => {
                // Whoever asked may have stopped waiting.
                let _ = opened.send(Err(error));
                return;
            }
        };
        let _ = opened.send(Ok(mode));
        while !self.shared.stop.load(Ordering::Relaxed) {
            let outcome = camera.frame().map_err(|error| lost(&self.name, meaning(&error)));
            let last = outcome.is_err();
            let frame = match outcome.map(|buffer| frame_of(&buffer, mode)) {
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

    /// Opens the camera with the first mode that it has, then sets the mode that is wanted of those
    /// it lists: nokhwa's own choice takes one format only.
    fn open(&self, index: CameraIndex) -> Result<(Camera, CameraFormat), CaptureError> {
        let lost = |error: NokhwaError| lost(&self.name, meaning(&error));
        // It opens no camera that stands at a format it does not know, as another program left it.
        #[cfg(target_os = "linux")]
        let number = index.as_index().map_err(lost)?;
        #[cfg(target_os = "linux")]
        v4l2::set_to_one_of(number, &KNOWN_ON_LINUX);
        let any = RequestedFormat::with_formats(RequestedFormatType::None, &ALL);
        let mut camera = Camera::new(index, any).map_err(lost)?;
        let mut offered = camera.compatible_camera_formats().map_err(lost)?;
        #[cfg(target_os = "linux")]
        offered.extend(v4l2::gray_modes(number).into_iter().map(|(size, fps)| gray(size, fps)));
        let mode = choose(&offered, &self.mode).map_err(|problem| CaptureError::Failed {
            reason: format!("{}: {problem}", self.name),
        })?;
        match mode.format() {
            #[cfg(target_os = "linux")]
            FrameFormat::GRAY => v4l2::set_gray(number, size_of(mode), mode.frame_rate())
                .map_err(|error| self::lost(&self.name, format!("no gray images: {error}")))?,
            _ if camera.camera_format() == mode => {}
            format => {
                let exactly = RequestedFormatType::Exact(mode);
                let formats = [format];
                let request = RequestedFormat::with_formats(exactly, &formats);
                camera.set_camera_requset(request).map_err(lost)?;
            }
        }
        camera.open_stream().map_err(lost)?;
        Ok((camera, mode))
    }
}

/// The side that is read.
struct PortableSource {
    name: String,
    mode: CameraFormat,
    words: String,
    received: Receiver<Result<Frame, CaptureError>>,
    shared: Arc<SharedFrames>,
    wait: Wait,
    next_sequence: Arc<AtomicU64>,
}

impl FrameSource for PortableSource {
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
            mode: Some(format!("{}, {}", self.name, self.words)),
            ..SourceDescription::default()
        }
    }

    fn losses(&self) -> Losses {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Losses { missed: count(&self.shared.missed), damaged: count(&self.shared.damaged) }
    }
}

impl Drop for PortableSource {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // Whoever opens the camera next finds it free, but for one that does not answer.
        self.wait.ends();
    }
}

/// Every camera that the system lists.
pub(super) fn list_devices() -> DeviceListing {
    let listing = |devices, missing| DeviceListing { backend: "uvc", devices, missing };
    match cameras() {
        Ok(cameras) if cameras.is_empty() => {
            listing(Vec::new(), Some("no camera is plugged in".to_owned()))
        }
        Ok(cameras) => listing(cameras.iter().map(listed).collect(), None),
        Err(error) => listing(Vec::new(), Some(meaning(&error))),
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

/// The cameras by their number. On Linux a USB camera has a second node of the same name, for
/// metadata, which is no camera.
fn cameras() -> Result<Vec<CameraInfo>, NokhwaError> {
    let mut cameras = nokhwa::query(ApiBackend::Auto)?;
    cameras.sort_by_key(|camera| camera.index().clone());
    #[cfg(target_os = "linux")]
    cameras.retain(|camera| camera.index().as_index().is_ok_and(v4l2::may_give_images));
    Ok(cameras)
}

fn find(selector: &Selector) -> Result<CameraInfo, CaptureError> {
    let wanted = match selector {
        Selector::Index(index) => format!("camera {index}"),
        Selector::Name(name) => name.clone(),
    };
    let cameras = cameras().map_err(|error| lost(&wanted, meaning(&error)))?;
    let names: Vec<String> = cameras.iter().map(CameraInfo::human_name).collect();
    let meant = |camera: &CameraInfo| match selector {
        Selector::Index(index) => *camera.index() == CameraIndex::Index(*index),
        Selector::Name(name) => camera.human_name() == *name,
    };
    let absent = || match names.is_empty() {
        true => "no camera is plugged in".to_owned(),
        false => format!("it is not plugged in; connected: {}", names.join(", ")),
    };
    cameras.into_iter().find(meant).ok_or_else(|| lost(&wanted, absent()))
}

/// A buffer as a frame of the mode that was set; `None` when it holds less than it should, or a
/// format that is not read. On Linux nokhwa hands over the driver's whole buffer: a JPEG is
/// followed by what earlier, larger ones left there. What it says of the buffer is not read: it
/// does not know gray images there.
fn frame_of(buffer: &Buffer, mode: CameraFormat) -> Option<Frame> {
    let format = pixel_format(mode.format())?;
    let size = size_of(mode);
    let stride = format.bytes_per_pixel().unwrap_or(0) * size.width as usize;
    let bytes = buffer.buffer();
    let length = match format {
        PixelFormat::Jpeg => jpeg_length(bytes)?,
        PixelFormat::Nv12 => stride * size.height as usize * 3 / 2,
        _ => stride * size.height as usize,
    };
    let bytes = Arc::from(bytes.get(..length)?);
    Some(Frame { sensor: SensorKind::Color, size, format, stride, bytes })
}

/// A mode of gray images, of this size and rate.
#[cfg(target_os = "linux")]
fn gray(size: ImageSize, fps: u32) -> CameraFormat {
    CameraFormat::new(Resolution::new(size.width, size.height), FrameFormat::GRAY, fps)
}

fn lost(device: &str, reason: String) -> CaptureError {
    CaptureError::Lost { device: device.to_owned(), reason }
}

/// An error of the library as one line, and what to do where the system's word for it is known.
fn meaning(error: &NokhwaError) -> String {
    let words = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    let has = |part: &str| words.contains(part);
    if has("resource busy") {
        return "in use by another program; close that first".to_owned();
    }
    if has("No such device") || has("No such file") {
        return "it was unplugged".to_owned();
    }
    // As the library writes it.
    if has("Failed to Fufill") {
        return format!("nokhwa knows none of its formats{NATIVE}");
    }
    words
}
