//! Frames of one camera, put together by their stamps.
//!
//! A bag is in the order in which messages arrived: color and depth of one frame set may be
//! interleaved with those of the next. A few sets wait until each has all its frames.

use std::collections::VecDeque;

use crate::imaging::frame::{Frame, FrameSet};
use crate::imaging::timestamp::HostTime;

/// Frames of different sensors whose stamps differ by at most this were taken together: half of
/// what is between two frames at 30 a second.
const TOGETHER_NS: u64 = 15_000_000;
/// How many sets wait for their missing frames.
const MOST_WAITING_SETS: usize = 4;

/// The frame sets that are not complete yet, in the order of their stamps.
#[derive(Debug)]
pub(super) struct StampedSets {
    sensors: usize,
    waiting: VecDeque<FrameSet>,
    next_sequence: u64,
}

impl StampedSets {
    /// Of a camera with so many topics of images.
    pub(super) fn new(sensors: usize) -> Self {
        Self { sensors, waiting: VecDeque::new(), next_sequence: 0 }
    }

    /// Forgets all.
    pub(super) fn clear(&mut self) {
        *self = Self::new(self.sensors);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Takes in a frame that was taken at `stamp_ns`.
    pub(super) fn push(&mut self, stamp_ns: i64, frame: Frame) {
        let together = |set: &&mut FrameSet| {
            set.host_time.utc_ns.abs_diff(stamp_ns) <= TOGETHER_NS
                && set.frame(frame.sensor).is_none()
        };
        if let Some(set) = self.waiting.iter_mut().find(together) {
            set.frames.push(frame);
            set.frames.sort_by_key(|frame| frame.sensor);
            return;
        }
        let at = self.waiting.iter().position(|set| set.host_time.utc_ns > stamp_ns);
        let set = FrameSet {
            sequence: 0,
            host_time: HostTime { utc_ns: stamp_ns },
            device_time: None,
            name: None,
            frames: vec![frame],
        };
        self.waiting.insert(at.unwrap_or(self.waiting.len()), set);
    }

    /// The earliest set, if it is complete or has waited long enough.
    pub(super) fn pop_complete(&mut self) -> Option<FrameSet> {
        let complete = self.waiting.front().is_some_and(|set| set.frames.len() >= self.sensors);
        if complete || self.waiting.len() > MOST_WAITING_SETS { self.pop() } else { None }
    }

    /// The earliest set.
    pub(super) fn pop(&mut self) -> Option<FrameSet> {
        let set = self.waiting.pop_front()?;
        self.next_sequence += 1;
        Some(FrameSet { sequence: self.next_sequence - 1, ..set })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::frame::{PixelFormat, SensorKind};

    fn frame(sensor: SensorKind) -> Frame {
        let (size, format) = (ImageSize::new(1, 1), PixelFormat::Mono8);
        Frame { sensor, size, format, stride: 1, bytes: [7].as_slice().into() }
    }

    #[test]
    fn interleaved_sensors_are_put_together_and_a_missing_one_holds_nothing_up() {
        use SensorKind::{Color, Depth};
        let mut sets = StampedSets::new(2);
        let arrivals =
            [(0, Color), (33, Color), (1, Depth), (66, Color), (100, Color), (67, Depth)];
        let more = [(133, Color), (101, Depth), (166, Color), (134, Depth), (167, Depth)];
        let mut given = Vec::new();
        for (ms, sensor) in arrivals.into_iter().chain(more) {
            sets.push(ms * 1_000_000, frame(sensor));
            while let Some(set) = sets.pop_complete() {
                given.push((set.sequence, set.host_time.utc_ns / 1_000_000, set.frames.len()));
            }
        }
        while let Some(set) = sets.pop() {
            given.push((set.sequence, set.host_time.utc_ns / 1_000_000, set.frames.len()));
        }
        let expected = [(0, 0, 2), (1, 33, 1), (2, 66, 2), (3, 100, 2), (4, 133, 2), (5, 166, 2)];
        assert_eq!(given, expected);
    }
}
