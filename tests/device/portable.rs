//! The same cameras through `nokhwa`: `backend = "nokhwa"`.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use plumb::capture::mode::ModeRequest;
use plumb::capture::uvc::{self, Backend, Selector, UvcOptions};
use plumb::capture::{CaptureError, FrameSource, Pace, Replay, ReplayOptions, SourceOpener};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::frame::PixelFormat;
use plumb::imaging::gray::GrayImage;
use serde_json::Value;

use crate::guest::{PATIENCE, PLUMB, VIVID, footprint, frames_until_error, luma_of};
use crate::usb::{SERIAL, listed};
use crate::usb_camera::{CameraModel, UsbCamera};
use crate::walk::WALK;

/// As `uvcvideo` names the camera of `usb_camera`.
const NAME: &str = "Software camera";

fn portable(selector: Selector, format: &str, size: (u32, u32)) -> Box<dyn SourceOpener> {
    let size = Some(ImageSize::new(size.0, size.1));
    let mode = ModeRequest { size, format: Some(format.to_owned()), fps: None };
    uvc::camera(UvcOptions { selector, mode, backend: Backend::Nokhwa })
}

fn named(format: &str) -> Box<dyn SourceOpener> {
    portable(Selector::Name(NAME.to_owned()), format, (640, 480))
}

fn refusal(camera: &mut dyn SourceOpener) -> CaptureError {
    camera.open().map(|_| ()).unwrap_err()
}

/// What opening a camera that was unplugged says once the kernel has taken its node away; until
/// then it is lost too.
fn absence(camera: &mut dyn SourceOpener) -> CaptureError {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let absent = refusal(camera);
        assert!(matches!(absent, CaptureError::Lost { .. }), "{absent}");
        if absent.to_string().contains("it is not plugged in") {
            return absent;
        }
        assert!(Instant::now() < deadline, "{absent}");
        std::thread::yield_now();
    }
}

/// Whether the camera shows anything at the moment.
#[derive(Default)]
struct Shutter {
    closed: Mutex<bool>,
    changed: Condvar,
}

impl Shutter {
    fn close(&self, closed: bool) {
        *self.closed.lock().unwrap() = closed;
        self.changed.notify_all();
    }

    fn wait_until_open(&self) {
        let _open = self.changed.wait_while(self.closed.lock().unwrap(), |closed| *closed);
    }
}

/// Plugs in a camera that shows the walk while its shutter is open.
fn plug_in(shutter: &Arc<Shutter>) -> UsbCamera {
    let options = ReplayOptions { pace: Pace::Fastest, repeat: true, ..ReplayOptions::default() };
    let mut walk = Replay::open(Path::new(WALK), &options).unwrap();
    let mut luma = GrayImage::default();
    let shutter = Arc::clone(shutter);
    let model = CameraModel { serial: SERIAL, size: [640, 480], fps: 5 };
    let plugged = UsbCamera::plug_in(model, move |image| {
        shutter.wait_until_open();
        let frame = walk.next_frame(Duration::ZERO).unwrap().frames.remove(0);
        image.of(&frame, &mut luma)
    });
    listed();
    plugged
}

/// MJPG, YUYV and GREY as shown; unplugged, absent, plugged in again.
pub fn frames_are_those_that_were_shown() -> String {
    let shutter = Arc::default();
    let plugged = plug_in(&shutter);
    let replay = ReplayOptions { pace: Pace::Fastest, ..ReplayOptions::default() };
    let mut walk = Replay::open(Path::new(WALK), &replay).unwrap();
    let shown: Vec<_> = std::iter::from_fn(|| walk.next_frame(Duration::ZERO).ok()).collect();
    for format in ["YUYV", "GREY"] {
        let mut source = named(format).open().unwrap();
        let mode = source.description().mode.unwrap();
        assert!(mode.ends_with(&format!("640x480 {format} at 5 frames a second")), "{mode}");
        let seen = luma_of(&source.next_frame(PATIENCE).unwrap());
        assert!(shown.iter().any(|set| luma_of(set).pixels() == seen.pixels()), "{format}");
    }

    let mut opener = named("MJPG");
    let mut source = opener.open().unwrap();
    let mode = source.description().mode.unwrap();
    assert!(mode.contains("640x480 MJPG at 5 frames a second"), "{mode}");
    for _ in 0..5 {
        let seen = source.next_frame(PATIENCE).unwrap();
        assert!(
            shown.iter().any(|set| set.frames[0].bytes == seen.frames[0].bytes),
            "JPEG is passed on as it came"
        );
    }
    drop(plugged);
    let (_, unplugged) = frames_until_error(&mut *source);
    assert!(matches!(unplugged, CaptureError::Lost { .. }), "{unplugged}");
    assert!(unplugged.to_string().ends_with("it was unplugged"), "{unplugged}");
    drop(source);
    let absent = absence(&mut *opener);
    let again = plug_in(&shutter);
    // The kernel may take a while to let go of the camera that was unplugged.
    let mut source =
        std::iter::repeat_with(|| opener.open()).take(10).find_map(Result::ok).unwrap();
    source.next_frame(PATIENCE).unwrap();
    drop((source, again));
    format!("MJPG, YUYV and GREY as shown; {unplugged}; {absent}")
}

/// A camera that stops answering holds one thread, however often it is opened, and gives frames
/// again when it answers.
pub fn a_stalled_camera_holds_one_thread() -> String {
    let shutter: Arc<Shutter> = Arc::default();
    let plugged = plug_in(&shutter);
    let mut opener = named("MJPG");
    opener.open().unwrap().next_frame(PATIENCE).unwrap();
    let mut source = opener.open().unwrap();
    source.next_frame(PATIENCE).unwrap();
    let (_, threads, _) = footprint();
    shutter.close(true);
    let (_, stalled) = frames_until_error(&mut *source);
    assert_eq!(stalled, CaptureError::TimedOut { waited: PATIENCE });
    drop(source);
    let mut refused = String::new();
    for _ in 0..3 {
        let error = refusal(&mut *opener);
        assert!(matches!(error, CaptureError::Lost { .. }), "it may answer again: {error}");
        assert!(error.to_string().contains("it still does not answer"), "{error}");
        assert!(footprint().1 <= threads, "{threads} threads became {}", footprint().1);
        refused = error.to_string();
    }
    shutter.close(false);
    // A wait is over once a frame comes; then the camera can be opened.
    let mut source = std::iter::repeat_with(|| opener.open()).take(5).find_map(Result::ok).unwrap();
    source.next_frame(PATIENCE).unwrap();
    drop((source, plugged));
    format!("{threads} threads before and after; {refused}")
}

/// Two cameras at once, one that another program has, gray images, a format that nokhwa does not
/// know, and the listing.
pub fn two_cameras_and_one_in_use() -> String {
    let native = |number| {
        let mode = ModeRequest { format: Some("GREY".to_owned()), ..ModeRequest::default() };
        uvc::camera(UvcOptions {
            selector: Selector::Index(number),
            mode,
            backend: Backend::Native,
        })
    };
    // Left at a format that nokhwa does not know.
    native(0).open().unwrap().next_frame(PATIENCE).unwrap();
    let camera = |number| portable(Selector::Index(number), "YUYV", (640, 360));
    let (mut first, mut second) = (camera(0).open().unwrap(), camera(1).open().unwrap());
    for _ in 0..3 {
        let sizes = [&mut first, &mut second]
            .map(|source| source.next_frame(PATIENCE).unwrap().frames[0].size);
        assert_eq!(sizes, [ImageSize::new(640, 360); 2]);
    }
    drop((first, second));

    let mut holder = Command::new("v4l2-ctl");
    holder.args(["-d", VIVID, "--stream-mmap", "--stream-count=100000"]);
    let mut holder = holder.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut progress = std::io::Read::bytes(holder.stderr.take().unwrap());
    assert!(progress.any(|byte| byte.unwrap() == b'<'), "v4l2-ctl did not stream");
    let mut waiting = camera(0);
    let busy = refusal(&mut *waiting);
    assert!(matches!(busy, CaptureError::Lost { .. }), "it may be free again by itself: {busy}");
    assert!(busy.to_string().ends_with("in use by another program; close that first"), "{busy}");
    holder.kill().unwrap();
    holder.wait().unwrap();
    waiting.open().unwrap().next_frame(PATIENCE).unwrap();

    let mut gray = portable(Selector::Index(1), "GREY", (640, 360)).open().unwrap();
    let frame = gray.next_frame(PATIENCE).unwrap().frames.remove(0);
    assert_eq!((frame.size, frame.format), (ImageSize::new(640, 360), PixelFormat::Mono8));
    drop(gray);
    let deep = refusal(&mut *portable(Selector::Index(1), "Y16", (640, 360)));
    assert!(matches!(deep, CaptureError::Failed { .. }), "{deep}");
    assert!(deep.to_string().contains("no format Y16; through nokhwa it offers GREY"), "{deep}");
    native(1).open().unwrap().next_frame(PATIENCE).unwrap();

    let output = Command::new(PLUMB).args(["devices", "--json"]).output().unwrap();
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let backends = document["backends"].as_array().unwrap();
    let names = |backend: &str| -> Vec<String> {
        let listing = backends.iter().find(|listing| listing["backend"] == backend).unwrap();
        let devices = listing["devices"].as_array().unwrap();
        devices.iter().map(|device| device["name"].as_str().unwrap().to_owned()).collect()
    };
    let vivid = |names: Vec<String>| names.iter().filter(|name| name.contains("vivid")).count();
    assert_eq!((vivid(names("v4l2")), vivid(names("uvc"))), (2, 2), "{document}");
    format!("{busy}; {deep}")
}
