//! A simulated camera as a source: frames of a rendered world at the pace of a real one.

use std::sync::OnceLock;
use std::thread;
use std::time::{Duration, Instant};

use crate::capture::host_clock;
use crate::capture::{CaptureError, FrameSource, Pace, SourceDescription};
use crate::geometry::pose::Pose;
use crate::imaging::frame::FrameSet;
use crate::imaging::timestamp::{DeviceTime, HostTime};
use crate::simulation::{Operator, OperatorKind, World, WorldOptions};

/// A camera that needs no hardware: a board carried about without end.
///
/// At the recorded pace a frame comes when it is due; frames that were due while nobody asked are
/// dropped, as a camera drops them. At the fastest, every frame comes, with the times it would have
/// had.
#[derive(Debug)]
pub struct Simulated {
    world: World,
    options: WorldOptions,
    carrier: Option<Carrier>,
    pace: Pace,
    clock: SimulatedClock,
    started: Option<(Instant, i64)>,
    next: u64,
}

impl Simulated {
    /// Starts the world that `options` describe.
    pub fn new(options: &WorldOptions, pace: Pace, clock: SimulatedClock) -> Self {
        Self {
            world: World::new(options),
            options: options.clone(),
            carrier: None,
            pace,
            clock,
            started: None,
            next: 0,
        }
    }

    /// The same with the board in the hands of a person, in place of its walk.
    #[must_use]
    pub fn operated(self, kind: OperatorKind) -> Self {
        let WorldOptions { seed, board, sensor, .. } = &self.options;
        let mut operator = Operator::before(*seed, kind, board, &sensor.lens, sensor.size);
        let now_from_board = operator.step(0.0);
        Self { carrier: Some(Carrier { operator, now_from_board, steps: 0 }), ..self }
    }

    /// The world's clock: when frame 0 was due, on this machine's clock and in UTC.
    fn start(&mut self) -> (Instant, i64) {
        *self.started.get_or_insert_with(|| match self.clock {
            SimulatedClock::Own => now(),
            SimulatedClock::Shared => *SHARED_START.get_or_init(now),
        })
    }
}

/// A person with the board, and the pose of the newest frame.
#[derive(Debug)]
struct Carrier {
    operator: Operator,
    now_from_board: Pose,
    steps: u64,
}

impl Carrier {
    /// The poses of the frame before the `index`-th and of itself, in the camera's frame.
    fn poses(&mut self, index: u64, interval_s: f64) -> [Pose; 2] {
        let mut before_from_board = self.now_from_board;
        while self.steps < index + 1 {
            self.steps += 1;
            before_from_board =
                std::mem::replace(&mut self.now_from_board, self.operator.step(interval_s));
        }
        [before_from_board, self.now_from_board]
    }
}

/// When a simulated world begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimulatedClock {
    /// With the source's first frame.
    Own,
    /// With the first frame of all that share the clock: cameras of one rig see the board at the
    /// same places.
    Shared,
}

static SHARED_START: OnceLock<(Instant, i64)> = OnceLock::new();

fn now() -> (Instant, i64) {
    (Instant::now(), host_clock::now().utc_ns)
}

impl FrameSource for Simulated {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        let (started, utc_ns) = self.start();
        let interval_s = 1.0 / self.options.fps;
        if self.pace == Pace::Recorded {
            let newest = (started.elapsed().as_secs_f64() / interval_s) as u64;
            self.next = self.next.max(newest);
            let due = started + Duration::from_secs_f64(self.next as f64 * interval_s);
            let wait = due.saturating_duration_since(Instant::now());
            thread::sleep(wait.min(timeout));
            if wait > timeout {
                return Err(CaptureError::TimedOut { waited: timeout });
            }
        }
        let index = self.next;
        self.next += 1;
        let since_ns = (index as f64 * interval_s * 1e9).round() as i64;
        Ok(FrameSet {
            sequence: index,
            host_time: HostTime { utc_ns: utc_ns + since_ns },
            device_time: Some(DeviceTime { monotonic_ns: since_ns }),
            name: None,
            frames: match &mut self.carrier {
                None => self.world.frame(index),
                Some(carrier) => self.world.frame_carried(index, carrier.poses(index, interval_s)),
            }
            .into_frames(),
        })
    }

    fn suggested(&mut self, camera_from_board: Option<&Pose>) {
        if let Some(carrier) = &mut self.carrier {
            carrier.operator.ask(camera_from_board);
        }
    }

    fn description(&self) -> SourceDescription {
        SourceDescription {
            kind: "simulator",
            identity: format!("seed {}", self.options.seed),
            fps: Some(self.options.fps),
            frame_set_count: None,
            waits: self.pace == Pace::Fastest,
            ..SourceDescription::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pixel::ImageSize;

    #[test]
    fn every_frame_comes_at_the_fastest_and_the_same_again() {
        let options = WorldOptions::new(3, ImageSize::new(160, 120));
        let mut sources =
            [(); 2].map(|()| Simulated::new(&options, Pace::Fastest, SimulatedClock::Own));
        for index in 0..5 {
            let [a, b] =
                sources.each_mut().map(|source| source.next_frame(Duration::ZERO).unwrap());
            assert_eq!((a.sequence, a.device_time), (index, b.device_time));
            assert_eq!(a.frames[0].bytes, b.frames[0].bytes);
        }
    }

    #[test]
    fn no_frame_comes_before_it_is_due() {
        let options =
            WorldOptions { fps: 1.0 / 3600.0, ..WorldOptions::new(3, ImageSize::new(64, 48)) };
        let mut source = Simulated::new(&options, Pace::Recorded, SimulatedClock::Own);
        assert_eq!(source.next_frame(Duration::ZERO).unwrap().sequence, 0);
        let early = source.next_frame(Duration::ZERO).unwrap_err();
        assert_eq!(early, CaptureError::TimedOut { waited: Duration::ZERO });
    }
}
