//! A recording as a source: at its own pace like a camera, or as fast as frames are taken.

use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use crate::capture::{CaptureError, FrameSource, SourceDescription};
use crate::geometry::pixel::ImageSize;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::recording::{ReadOptions, Recording, RecordingError};

/// How fast a recording is replayed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Pace {
    /// As it was recorded: no frame comes before its time. One that is asked for late comes at
    /// once.
    #[default]
    Recorded,
    /// As fast as frames are taken; none is ever skipped.
    Fastest,
}

/// How to replay.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReplayOptions {
    /// How fast; as recorded unless said.
    pub pace: Pace,
    /// Whether to start again after the last frame; not, unless said. Sequence numbers and times go
    /// on rising.
    pub repeat: bool,
    /// What of the recording is read, and how.
    pub reading: ReadOptions,
}

/// A recording being replayed.
#[derive(Debug)]
pub struct Replay {
    path: PathBuf,
    recording: Recording,
    options: ReplayOptions,
    factory: FactoryCalibration,
    waiting: Option<FrameSet>,
    clock: Option<PaceClock>,
    /// The first frame ever given.
    first: Option<Moment>,
    /// The last frame given.
    last: Option<Moment>,
    /// From the frame before the last to the last.
    interval_ns: i64,
    /// Added to sequence numbers and times of the present round.
    moved_by: Moment,
}

/// When the first frame was given, and its recorded time.
#[derive(Debug, Clone, Copy)]
struct PaceClock {
    started: Instant,
    first_ns: i64,
}

/// A frame's place in the recording.
#[derive(Debug, Clone, Copy, Default)]
struct Moment {
    sequence: u64,
    utc_ns: i64,
}

impl Replay {
    /// Opens the recording at `path`.
    ///
    /// # Errors
    /// [`RecordingError`] when it isn't there or is no recording.
    pub fn open(path: &Path, options: &ReplayOptions) -> Result<Self, RecordingError> {
        let recording = Recording::open(path, &options.reading)?;
        let factory = recording.factory();
        Ok(Self {
            factory,
            path: path.to_owned(),
            recording,
            options: options.clone(),
            waiting: None,
            clock: None,
            first: None,
            last: None,
            interval_ns: (1e9 / options.reading.fps) as i64,
            moved_by: Moment::default(),
        })
    }

    /// The same, with what is stated beside the recording of its sensors.
    #[must_use]
    pub fn stating(mut self, factory: FactoryCalibration) -> Self {
        self.factory = factory;
        self
    }

    /// The size of the first image of a folder's sensor.
    pub fn image_size(&self, sensor: SensorKind) -> Option<ImageSize> {
        self.recording.image_size(sensor)
    }

    /// The next frame set of the recording, of a later round where it repeats.
    fn read(&mut self) -> Result<FrameSet, CaptureError> {
        let mut read = self.recording.next_frame_set().map_err(|error| failed(&error))?;
        if read.is_none() && self.options.repeat {
            self.start_another_round();
            self.recording.rewind().map_err(|error| failed(&error))?;
            read = self.recording.next_frame_set().map_err(|error| failed(&error))?;
        }
        let mut set = read.ok_or(CaptureError::Ended)?;
        set.sequence += self.moved_by.sequence;
        set.host_time.utc_ns += self.moved_by.utc_ns;
        if let Some(time) = &mut set.device_time {
            time.monotonic_ns += self.moved_by.utc_ns;
        }
        let now = Moment { sequence: set.sequence, utc_ns: set.host_time.utc_ns };
        if let Some(last) = self.last {
            self.interval_ns = now.utc_ns - last.utc_ns;
        }
        self.first.get_or_insert(now);
        self.last = Some(now);
        Ok(set)
    }

    /// Continues sequence and time one frame interval after the last frame.
    fn start_another_round(&mut self) {
        if let (Some(first), Some(last)) = (self.first, self.last) {
            let sequence = last.sequence + 1 - first.sequence;
            self.moved_by =
                Moment { sequence, utc_ns: last.utc_ns + self.interval_ns - first.utc_ns };
        }
    }

    fn due(&mut self, set: &FrameSet) -> Instant {
        let first = PaceClock { started: Instant::now(), first_ns: set.host_time.utc_ns };
        let clock = self.clock.get_or_insert(first);
        let after_ns = set.host_time.utc_ns.saturating_sub(clock.first_ns).max(0);
        clock.started + Duration::from_nanos(after_ns.unsigned_abs())
    }
}

fn failed(error: &RecordingError) -> CaptureError {
    CaptureError::Failed { reason: error.to_string() }
}

impl FrameSource for Replay {
    fn next_frame(&mut self, timeout: Duration) -> Result<FrameSet, CaptureError> {
        let set = match self.waiting.take() {
            Some(set) => set,
            None => self.read()?,
        };
        let due = self.due(&set);
        if self.options.pace == Pace::Recorded {
            let wait = due.saturating_duration_since(Instant::now());
            thread::sleep(wait.min(timeout));
            if wait > timeout {
                self.waiting = Some(set);
                return Err(CaptureError::TimedOut { waited: timeout });
            }
        }
        Ok(set)
    }

    fn description(&self) -> SourceDescription {
        SourceDescription {
            kind: "recording",
            identity: self.path.display().to_string(),
            fps: None,
            frame_set_count: self.recording.frame_set_count().filter(|_| !self.options.repeat),
            waits: self.options.pace == Pace::Fastest,
            factory: self.factory.clone(),
            ..SourceDescription::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_of(names: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            std::fs::write(folder.path().join(name), b"P5 1 1 255\n7").unwrap();
        }
        folder
    }

    #[test]
    fn repeats_with_rising_numbers_and_times() {
        let folder = folder_of(&["a10.pgm", "a2.pgm", "a1.pgm"]);
        let options =
            ReplayOptions { pace: Pace::Fastest, repeat: true, ..ReplayOptions::default() };
        let mut replay = Replay::open(folder.path(), &options).unwrap();
        for k in 0..8 {
            let set = replay.next_frame(Duration::ZERO).unwrap();
            assert_eq!((set.sequence, set.host_time.utc_ns), (k, k as i64 * 100_000_000));
            let name = ["a1.pgm", "a2.pgm", "a10.pgm"][k as usize % 3];
            assert!(set.name.unwrap().ends_with(name));
        }
    }

    #[test]
    fn ends_once_and_stays_ended() {
        let folder = folder_of(&["a.pgm"]);
        let options = ReplayOptions { pace: Pace::Fastest, ..ReplayOptions::default() };
        let mut replay = Replay::open(folder.path(), &options).unwrap();
        assert!(replay.next_frame(Duration::ZERO).is_ok());
        assert_eq!(replay.next_frame(Duration::ZERO).unwrap_err(), CaptureError::Ended);
        assert_eq!(replay.next_frame(Duration::ZERO).unwrap_err(), CaptureError::Ended);
    }

    #[test]
    fn at_its_own_pace_no_frame_comes_early_and_none_is_lost() {
        let folder = folder_of(&["a.pgm", "b.pgm"]);
        let reading = ReadOptions { fps: 1.0 / 3600.0, ..ReadOptions::default() };
        let options = ReplayOptions { reading, ..ReplayOptions::default() };
        let mut replay = Replay::open(folder.path(), &options).unwrap();
        assert_eq!(replay.next_frame(Duration::ZERO).unwrap().sequence, 0);
        for _ in 0..3 {
            let early = replay.next_frame(Duration::ZERO).unwrap_err();
            assert_eq!(early, CaptureError::TimedOut { waited: Duration::ZERO });
        }
    }
}
