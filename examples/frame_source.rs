//! A source of frames of one's own: raw 8-bit images from any stream of bytes, such as a pipe or a
//! socket. Here the stream is a rendered scene, and each frame is searched for a chessboard.
//!
//! To let the daemon open it by name, add a variant to `src/config/source.rs` and an arm to
//! `src/daemon/sources.rs`.
//!
//! ```text
//! cargo run --example frame_source
//! ```

#![allow(clippy::print_stdout, reason = "it is what the program is for")]

use std::error::Error;
use std::io::{Cursor, Read};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use plumb::capture::{CaptureError, FrameSource, SourceDescription};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode::luma;
use plumb::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use plumb::imaging::gray::GrayImage;
use plumb::imaging::timestamp::HostTime;
use plumb::simulation::{World, WorldOptions};

/// Images of one size, one after the other, without any header.
struct RawStream<R> {
    reader: R,
    size: ImageSize,
    sequence: u64,
}

impl<R: Read + Send> FrameSource for RawStream<R> {
    // The timeout is the reader's own here: a socket has `set_read_timeout`.
    fn next_frame(&mut self, _timeout: Duration) -> Result<FrameSet, CaptureError> {
        let stride = self.size.width as usize;
        let mut bytes = vec![0; stride * self.size.height as usize];
        self.reader.read_exact(&mut bytes).map_err(|_| CaptureError::Ended)?;
        let since_epoch = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        let set = FrameSet {
            sequence: self.sequence,
            host_time: HostTime { utc_ns: since_epoch.as_nanos() as i64 },
            device_time: None,
            name: None,
            frames: vec![Frame {
                sensor: SensorKind::Color,
                size: self.size,
                format: PixelFormat::Mono8,
                stride,
                bytes: Arc::from(bytes),
            }],
        };
        self.sequence += 1;
        Ok(set)
    }

    fn description(&self) -> SourceDescription {
        SourceDescription { kind: "raw", identity: "stream".to_owned(), ..Default::default() }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let options = WorldOptions::new(1, ImageSize::new(640, 480));
    let mut world = World::new(&options);
    let stream: Vec<u8> = (0..3).flat_map(|k| world.frame(k).image.into_pixels()).collect();
    let mut source =
        RawStream { reader: Cursor::new(stream), size: options.sensor.size, sequence: 0 };

    let mut image = GrayImage::default();
    loop {
        let set = match source.next_frame(Duration::from_secs(1)) {
            Ok(set) => set,
            Err(CaptureError::Ended) => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        luma(&set.frames[0], &mut image)?;
        match plumb::detect(image.view(), options.board.size) {
            Ok(found) => println!("frame {}: {} corners", set.sequence, found.corners.len()),
            Err(no_board) => println!("frame {}: {no_board}", set.sequence),
        }
    }
}
