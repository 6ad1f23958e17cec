//! Pixel formats, modes and controls of a real device.

use std::collections::BTreeMap;

use image::RgbImage;
use plumb::capture::{CaptureError, SourceOpener};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode;
use plumb::imaging::gray::GrayImage;

use crate::guest::{PATIENCE, VIVID, camera, luma_of, options, still_controls};

const FORMATS: [&str; 9] = ["YUYV", "UYVY", "NV12", "GREY", "Y10", "Y12", "Y16", "RGB3", "BGR3"];

const GREY_RAMP: i64 = 20;
const COLOR_BARS: i64 = 0;

/// The same still image in every format.
pub fn every_format_gives_the_same_image() -> String {
    let bars: Vec<(GrayImage, RgbImage)> =
        FORMATS.iter().map(|format| still_image(format, COLOR_BARS)).collect();
    let luma = |k: usize| bars[k].0.pixels();
    assert_eq!(luma(0), luma(1), "UYVY is YUYV in another order");
    assert_eq!(luma(0), luma(2), "NV12 has the same luma");
    assert_eq!(bars[0].1, bars[1].1, "UYVY is YUYV in another order");
    assert_eq!(bars[7].1, bars[8].1, "BGR3 is RGB3 in another order");
    assert_eq!(luma(7), luma(8), "BGR3 is RGB3 in another order");
    for k in [4, 5, 6] {
        assert_eq!(luma(3), luma(k), "{} is GREY with more bits", FORMATS[k]);
    }
    let ramps: Vec<GrayImage> =
        FORMATS.iter().map(|format| still_image(format, GREY_RAMP).0).collect();
    for (format, ramp) in FORMATS.iter().zip(&ramps) {
        // Luma beside chroma has the range 16 to 235, alone it has the whole.
        let full = |value: u8| {
            if ["YUYV", "UYVY", "NV12"].contains(format) { stretched(value) } else { value }
        };
        let differing = ramp
            .pixels()
            .iter()
            .zip(ramps[3].pixels())
            .filter(|(a, b)| full(**a).abs_diff(**b) > 2);
        assert_eq!(differing.count(), 0, "{format}");
        assert!(
            ramp.pixels().iter().max() > Some(&200) && ramp.pixels().iter().min() < Some(&40),
            "{format}"
        );
    }
    format!("{} formats", FORMATS.len())
}

fn stretched(limited: u8) -> u8 {
    ((f64::from(limited) - 16.0) * 255.0 / 219.0).round().clamp(0.0, 255.0) as u8
}

fn still_image(format: &str, pattern: i64) -> (GrayImage, RgbImage) {
    let mut options = options(VIVID, Some(format));
    options.controls = still_controls();
    options.controls.insert("test_pattern".to_owned(), pattern);
    let mut source = camera(options).open().unwrap();
    let mode = source.description().mode.unwrap();
    assert!(mode.contains(&format!("640x360 {format} at 30 frames a second")), "{mode}");
    let first = source.next_frame(PATIENCE).unwrap();
    let second = source.next_frame(PATIENCE).unwrap();
    assert!(second.sequence > first.sequence);
    let (before, after) = (first.device_time.unwrap(), second.device_time.unwrap());
    assert!(after.monotonic_ns > before.monotonic_ns);
    let luma = luma_of(&second);
    assert_eq!(luma.size(), ImageSize::new(640, 360));
    (luma, decode::rgb(&second.frames[0]).unwrap())
}

pub fn what_cannot_be_had_is_reported() -> String {
    let refused = |format: &str| {
        camera(options(VIVID, Some(format))).open().map(|_| ()).unwrap_err().to_string()
    };
    let message = refused("MJPG");
    assert!(
        message.contains("no format MJPG; supported by the device and Plumb: GREY, NV12, YUYV"),
        "{message}"
    );
    let mut odd = options(VIVID, Some("YUYV"));
    odd.mode.size = Some(ImageSize::new(1000, 700));
    let source = camera(odd).open().unwrap();
    let mode = source.description().mode.unwrap();
    assert!(mode.contains("asked for 1000x700"), "{mode}");
    drop(source);
    let mut unsaid = options(VIVID, None);
    unsaid.mode.size = Some(ImageSize::new(1280, 720));
    unsaid.mode.fps = Some(10.0);
    let mode = camera(unsaid).open().unwrap().description().mode.unwrap();
    assert!(mode.contains("1280x720 GREY at 10"), "the cheapest that is fast enough: {mode}");
    message
}

pub fn controls_are_set_held_and_given_back() -> String {
    let mut with_controls = options(VIVID, Some("GREY"));
    with_controls.controls =
        BTreeMap::from([("brightness".to_owned(), 90), ("gain_auto".to_owned(), 1)]);
    with_controls.lock = true;
    let value = |control: &str| {
        let listing = plumb::capture::v4l2::list_devices();
        let found = listing.devices[0].controls.iter().find(|c| c.name == control);
        found.and_then(|control| control.value).unwrap()
    };
    assert_eq!(value("brightness"), 128);
    let mut source = camera(with_controls.clone()).open().unwrap();
    assert_eq!((value("brightness"), value("gain_auto")), (90, 1));
    source.calibrating(true).unwrap();
    assert_eq!(value("gain_auto"), 0);
    source.calibrating(false).unwrap();
    assert_eq!(value("gain_auto"), 1);
    source.calibrating(true).unwrap();
    drop(source);
    assert_eq!((value("brightness"), value("gain_auto")), (128, 1));
    with_controls.controls = BTreeMap::from([("focus_auto".to_owned(), 0)]);
    let error = camera(with_controls.clone()).open().map(|_| ()).unwrap_err();
    assert!(matches!(&error, CaptureError::Failed { .. }), "{error}");
    let message = error.to_string();
    assert!(message.contains("no control focus_auto; it has brightness, contrast"), "{message}");
    with_controls.controls = BTreeMap::from([("brightness".to_owned(), 256)]);
    let message = camera(with_controls).open().map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("control brightness takes 0 to 255"), "{message}");
    message
}
