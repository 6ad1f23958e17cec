//! A USB camera through the kernel's own `uvcvideo`.

use std::path::Path;
use std::time::{Duration, Instant};

use plumb::capture::device_list::ListedDevice;
use plumb::capture::mode::ModeRequest;
use plumb::capture::v4l2::V4l2Options;
use plumb::capture::{CaptureError, FrameSource, Pace, Replay, ReplayOptions, SourceOpener};
use plumb::imaging::gray::GrayImage;

use crate::guest::{PATIENCE, camera, frames_until_error, luma_of, press};
use crate::usb_camera::{CameraModel, UsbCamera};
use crate::walk::WALK;

pub const SERIAL: &str = "A1B2C3D4";

/// Plugs in a camera that shows the walk, over and over.
pub fn plug_in() -> UsbCamera {
    let options = ReplayOptions { pace: Pace::Fastest, repeat: true, ..ReplayOptions::default() };
    let mut walk = Replay::open(Path::new(WALK), &options).unwrap();
    let mut luma = GrayImage::default();
    UsbCamera::plug_in(CameraModel { serial: SERIAL, size: [640, 480], fps: 5 }, move |image| {
        let frame = walk.next_frame(Duration::ZERO).unwrap().frames.remove(0);
        image.of(&frame, &mut luma)
    })
}

/// The camera as `plumb devices` lists it, once the kernel has made its node.
pub fn listed() -> ListedDevice {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let listing = plumb::capture::v4l2::list_devices();
        if let Some(device) =
            listing.devices.into_iter().find(|device| device.serial.as_deref() == Some(SERIAL))
        {
            return device;
        }
        assert!(Instant::now() < deadline, "the camera has no node");
        std::thread::yield_now();
    }
}

fn options(format: &str) -> V4l2Options {
    let mode = ModeRequest { format: Some(format.to_owned()), ..ModeRequest::default() };
    V4l2Options { device: SERIAL.into(), mode, lock: true, ..V4l2Options::default() }
}

/// Listed with its serial number and formats; streams; holds focus and exposure; comes and goes.
pub fn a_usb_camera_streams_holds_still_and_comes_back() -> String {
    let plugged = plug_in();
    let device = listed();
    assert_eq!(
        (device.name.as_str(), device.driver.as_deref()),
        ("Software camera", Some("uvcvideo"))
    );
    let formats: Vec<&str> = device.formats.iter().map(|format| format.name.as_str()).collect();
    assert_eq!(formats, ["MJPG", "YUYV", "GREY"]);
    let node = device.paths.last().unwrap().clone();

    let mut walk = Replay::open(
        Path::new(WALK),
        &ReplayOptions { pace: Pace::Fastest, ..ReplayOptions::default() },
    )
    .unwrap();
    let shown: Vec<_> = std::iter::from_fn(|| walk.next_frame(Duration::ZERO).ok()).collect();
    let mut yuyv = camera(options("YUYV")).open().unwrap();
    let seen = luma_of(&yuyv.next_frame(PATIENCE).unwrap());
    assert!(
        shown.iter().any(|set| luma_of(set).pixels() == seen.pixels()),
        "an image that was not shown"
    );
    drop(yuyv);

    let mut opener = camera(options("MJPG"));
    let mut source = opener.open().unwrap();
    assert_eq!(source.description().serial.as_deref(), Some(SERIAL));
    let seen = source.next_frame(PATIENCE).unwrap();
    assert!(
        shown.iter().any(|set| set.frames[0].bytes == seen.frames[0].bytes),
        "JPEG is passed on as it came"
    );
    let value = |name: &str| {
        let controls = listed().controls;
        controls
            .iter()
            .find(|control| control.name == name)
            .and_then(|control| control.value)
            .unwrap()
    };
    let names: Vec<String> = device.controls.iter().map(|control| control.name.clone()).collect();
    let [exposure, focus] = ["exposure_auto", "focus_auto"];
    assert!(names.iter().any(|name| name == focus), "{names:?}");
    assert_eq!((value(exposure), value(focus)), (3, 1));
    source.calibrating(true).unwrap();
    assert_eq!((value(exposure), value(focus)), (1, 0), "held");
    source.calibrating(false).unwrap();
    assert_eq!((value(exposure), value(focus)), (3, 1), "given back");
    assert_eq!(source.moved_since_calibrating(), None);
    press(&node, "focus_automatic_continuous=0,focus_absolute=100");
    let moved = source.moved_since_calibrating().unwrap();
    assert!(moved.contains("focus") && moved.contains("from 50 to 100"), "{moved}");

    drop(plugged);
    let (_, error) = frames_until_error(&mut *source);
    assert!(
        matches!(error, CaptureError::Lost { .. })
            && error.to_string().ends_with("it was unplugged"),
        "{error}"
    );
    drop(source);
    let absent = opener.open().map(|_| ()).unwrap_err();
    assert!(matches!(absent, CaptureError::Lost { .. }), "{absent}");
    let again = plug_in();
    listed();
    let mut source = opener.open().unwrap();
    source.next_frame(PATIENCE).unwrap();
    drop((source, again));
    format!("MJPG and YUYV as shown; {moved}; {error}; {absent}")
}
