//! A program that feeds a loopback device, as a real camera would be fed by light.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use plumb::capture::{FrameSource, Pace, Replay, ReplayOptions};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode;
use plumb::imaging::frame::Frame;
use plumb::imaging::gray::GrayImage;
use v4l::format::field::FieldOrder;
use v4l::video::Output;
use v4l::{Device, Format, FourCC};

/// The argument by which this program becomes the feeder.
pub const FEED: &str = "feed";

/// A feeder as a process of its own; it ends with this value.
pub struct Feeder(Child);

impl Feeder {
    pub fn start(device: &str, format: &str, recording: &str, fps: &str) -> Self {
        let program = std::env::current_exe().unwrap();
        let child = Command::new(program)
            .args([FEED, device, format, recording, fps])
            .stdout(Stdio::null())
            .spawn();
        Self(child.unwrap())
    }
}

impl Drop for Feeder {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// A loopback device that this process shows images to.
pub struct Screen(Device);

impl Screen {
    /// Opens it for images of this size and format (a FourCC).
    pub fn open(device: &str, size: ImageSize, format: &str) -> Self {
        let device = Device::with_path(device).unwrap();
        let code: [u8; 4] = format.as_bytes().try_into().unwrap();
        let mut format = Format::new(size.width, size.height, FourCC::new(&code));
        format.size = size.width * size.height * 2;
        format.field_order = FieldOrder::Progressive;
        Output::set_format(&device, &format).unwrap();
        Self(device)
    }

    /// Shows an image, once what was shown before is taken.
    pub fn show(&mut self, bytes: &[u8]) {
        while let Err(error) = self.0.write_all(bytes) {
            assert_eq!(error.kind(), ErrorKind::WouldBlock, "{error}");
        }
    }
}

/// A frame's luminance as YUYV.
pub fn yuyv_of(frame: &Frame, luma: &mut GrayImage) -> Vec<u8> {
    decode::luma(frame, luma).unwrap();
    luma.pixels().iter().flat_map(|y| [*y, 128]).collect()
}

/// Shows the recording to the device over and over, until killed.
pub fn feed(device: &str, format: &str, recording: &Path, fps: f64) {
    let options = ReplayOptions { pace: Pace::Fastest, repeat: true, ..ReplayOptions::default() };
    let mut replay = Replay::open(recording, &options).unwrap();
    let mut screen = None;
    let mut luma = GrayImage::default();
    let mut due: Option<Instant> = None;
    loop {
        let set = replay.next_frame(Duration::ZERO).unwrap();
        let frame = &set.frames[0];
        let screen = screen.get_or_insert_with(|| Screen::open(device, frame.size, format));
        let bytes = if format == "MJPG" { frame.bytes.to_vec() } else { yuyv_of(frame, &mut luma) };
        let time = due.unwrap_or_else(Instant::now);
        thread::sleep(time.saturating_duration_since(Instant::now()));
        due = Some(time + Duration::from_secs_f64(1.0 / fps));
        screen.show(&bytes);
    }
}
