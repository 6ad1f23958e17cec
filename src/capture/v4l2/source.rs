//! The stream of frames of an open device: mapped buffers, and never a wait without an end.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use v4l::Device;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::io::traits::CaptureStream;
use v4l::prelude::MmapStream;

use crate::capture::frame_counter::FrameCounter;
use crate::capture::host_clock::now;
use crate::capture::v4l2::controls::Controls;
use crate::capture::v4l2::device_node::DeviceNode;
use crate::capture::v4l2::failure::lost;
use crate::capture::v4l2::mode::{Mode, PixelLayout};
use crate::capture::{CaptureError, FrameSource, Losses, SourceDescription};
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::timestamp::DeviceTime;

/// Buffers between the driver and the reader: at 30 frames a second the reader may be 100 ms late.
const BUFFERS: u32 = 4;
/// How long to leave a driver alone that says a frame is ready and then has none.
const RETRY_DELAY: Duration = Duration::from_millis(2);

/// An open device, set and ready to stream.
pub(super) struct OpenedDevice {
    pub device: Device,
    pub mode: Mode,
    pub controls: Controls,
    pub node: DeviceNode,
    pub identity: String,
    pub driver: String,
    pub lock: bool,
    pub next_sequence: Arc<AtomicU64>,
}

/// A streaming device.
pub(super) struct V4l2Source {
    opened: OpenedDevice,
    /// `None` only while it is being closed.
    stream: Option<MmapStream<'static>>,
    /// Whether the stream has handed out a buffer that goes back with the next call.
    holds_buffer: bool,
    counter: FrameCounter,
    losses: Losses,
}

impl V4l2Source {
    /// Starts streaming; no frame has been waited for.
    pub fn start(opened: OpenedDevice) -> Result<Self, CaptureError> {
        let stream = MmapStream::with_buffers(&opened.device, Type::VideoCapture, BUFFERS);
        let counter = FrameCounter::new(opened.next_sequence.load(Ordering::Relaxed));
        let mut source =
            Self { opened, stream: None, holds_buffer: false, counter, losses: Losses::default() };
        let mut stream = stream.map_err(|error| source.lost(&error))?;
        // Waiting is done in `is_ready`; the stream itself never waits, so that this only queues
        // and starts.
        stream.set_timeout(Duration::ZERO);
        match CaptureStream::next(&mut stream).map(|_| ()) {
            Ok(()) => source.holds_buffer = true,
            Err(error) if is_not_yet(&error) => {}
            Err(error) => {
                source.stream = Some(stream);
                return Err(source.lost(&error));
            }
        }
        source.stream = Some(stream);
        Ok(source)
    }

    /// Waits for a frame, at most for `timeout`.
    fn is_ready(&self, timeout: Duration) -> Result<bool, CaptureError> {
        let milliseconds = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        match self.opened.device.handle().poll(libc::POLLIN, milliseconds) {
            Ok(ready) => Ok(ready > 0),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
            Err(error) => Err(self.lost(&error)),
        }
    }

    /// The frame that is ready; `None` when it is of no use.
    fn take(&mut self) -> Result<Option<FrameSet>, CaptureError> {
        let Some(stream) = &mut self.stream else { return Ok(None) };
        if !self.holds_buffer {
            // The first buffer can only be taken without its content.
            return match CaptureStream::dequeue(stream) {
                Ok(_) => {
                    self.holds_buffer = true;
                    Ok(None)
                }
                Err(error) => self.not_taken(&error),
            };
        }
        self.holds_buffer = false;
        let outcome = CaptureStream::next(stream).map(|(bytes, metadata)| {
            let frame = frame_of(bytes, metadata, &self.opened.mode);
            (frame, *metadata)
        });
        let (frame, metadata) = match outcome {
            Ok(taken) => taken,
            Err(error) => return self.not_taken(&error),
        };
        self.holds_buffer = true;
        let missed = self.counter.count_32(metadata.sequence);
        self.losses.missed += missed;
        self.opened.next_sequence.store(self.counter.next(), Ordering::Relaxed);
        let Some(frame) = frame else {
            self.losses.damaged += 1;
            return Ok(None);
        };
        let sequence = self.counter.next() - 1;
        let device_time = device_time(&metadata);
        Ok(Some(FrameSet {
            sequence,
            host_time: now(),
            device_time,
            name: None,
            frames: vec![frame],
        }))
    }

    fn not_taken(&self, error: &io::Error) -> Result<Option<FrameSet>, CaptureError> {
        if is_not_yet(error) {
            thread::sleep(RETRY_DELAY);
            return Ok(None);
        }
        Err(self.lost(error))
    }

    fn lost(&self, error: &io::Error) -> CaptureError {
        lost(&self.opened.node.path, error)
    }
}

impl FrameSource for V4l2Source {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if self.is_ready(left)?
                && let Some(set) = self.take()?
            {
                return Ok(set);
            }
            if Instant::now() >= deadline {
                return Err(CaptureError::TimedOut { waited: timeout });
            }
        }
    }

    fn description(&self) -> SourceDescription {
        let OpenedDevice { mode, node, identity, driver, .. } = &self.opened;
        SourceDescription {
            kind: "v4l2",
            identity: identity.clone(),
            fps: mode.fps,
            model: Some(node.name.clone()),
            serial: node.serial().map(str::to_owned),
            bus: Some(node.bus.clone()),
            mode: Some(format!("{}, {driver}, {mode}", node.path.display())),
            ..SourceDescription::default()
        }
    }

    fn losses(&self) -> Losses {
        self.losses
    }

    fn calibrating(&mut self, on: bool) -> Result<(), CaptureError> {
        let OpenedDevice { device, controls, lock, .. } = &mut self.opened;
        match (*lock, on) {
            (true, true) => controls.hold(device),
            (true, false) => controls.release(device),
            (false, _) => {}
        }
        Ok(())
    }

    fn moved_since_calibrating(&self) -> Option<String> {
        self.opened.controls.moved(&self.opened.device)
    }
}

impl Drop for V4l2Source {
    fn drop(&mut self) {
        self.opened.controls.restore(&self.opened.device);
        let stream = self.stream.take();
        // The stream panics when the driver refuses to stop; a camera must not take the daemon down
        // with it.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(stream)));
    }
}

/// Nothing to take at this moment.
fn is_not_yet(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

/// A buffer's content as a frame; `None` when it was flagged as damaged, or cannot hold what it
/// should.
fn frame_of(buffer: &[u8], metadata: &Metadata, mode: &Mode) -> Option<Frame> {
    let used = buffer.get(..metadata.bytesused as usize)?;
    if metadata.flags.contains(Flags::ERROR) || used.is_empty() {
        return None;
    }
    let PixelLayout { format, up_bits, .. } = mode.layout;
    let whole = match format {
        PixelFormat::Jpeg => used.starts_with(&[0xff, 0xd8]),
        PixelFormat::Nv12 => used.len() >= mode.stride * mode.size.height as usize * 3 / 2,
        _ => used.len() >= mode.stride * mode.size.height as usize,
    };
    let bytes = if up_bits == 0 { Arc::from(used) } else { moved_up(used, up_bits) };
    whole.then_some(Frame {
        sensor: SensorKind::Color,
        size: mode.size,
        format,
        stride: mode.stride,
        bytes,
    })
}

/// 16-bit samples that fill only the lower bits, moved up to fill them all.
fn moved_up(samples: &[u8], up_bits: u32) -> Arc<[u8]> {
    samples
        .chunks_exact(2)
        .flat_map(|pair| (u16::from_le_bytes([pair[0], pair[1]]) << up_bits).to_le_bytes())
        .collect()
}

fn device_time(metadata: &Metadata) -> Option<DeviceTime> {
    let monotonic = metadata.flags.contains(Flags::TIMESTAMP_MONOTONIC);
    let time = metadata.timestamp;
    monotonic.then_some(DeviceTime { monotonic_ns: time.sec * 1_000_000_000 + time.usec * 1000 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_ten_bits_fill_sixteen() {
        assert_eq!(&*moved_up(&[0xff, 0x03, 0x01, 0x00], 6), [0xc0, 0xff, 0x40, 0x00]);
    }
}
