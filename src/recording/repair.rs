//! Makes a recording whole that was cut off: what can be read of it, with its index.

use std::path::Path;

use crate::imaging::frame::{FrameSet, SensorKind};
use crate::recording::RecordingError;
use crate::recording::mcap_reader::McapReader;
use crate::recording::mcap_writer::McapWriter;

/// What became of a recording that was to be repaired.
#[derive(Debug)]
pub struct RepairedRecording {
    /// Frame sets that it holds now.
    pub frame_sets: usize,
    /// Where it was cut off or damaged; `None` for one that was whole and stays as it is.
    pub fault: Option<RecordingError>,
}

/// Reads the recording at `path` as far as it can be read, and puts a whole one with its index in
/// its place; one that is whole is left as it is.
///
/// # Errors
/// [`RecordingError`] for what is no recording or holds no frames, and what the system refuses; the
/// file is then as it was.
pub fn repair(path: &Path) -> Result<RepairedRecording, RecordingError> {
    let refused = |source| RecordingError::Io { path: path.to_owned(), source };
    let made = path.with_extension("repaired");
    let mut reader = McapReader::open(path, &[])?;
    let has_index = reader.frame_set_count().is_some();
    let first = reader.next_frame_set()?;
    let camera = reader.camera().unwrap_or_default().to_owned();
    let mut writer = McapWriter::create(&made, &camera)?;
    let mut copied = Copied { next: first, frame_sets: 0, lenses: Vec::new() };
    let outcome = copied.copy(&mut reader, &mut writer);
    let finished = writer.finish();
    let fault = match outcome {
        Ok(()) => None,
        Err(fault @ (RecordingError::Cut { .. } | RecordingError::Damaged { .. })) => Some(fault),
        Err(error) => return discard(&made, error),
    };
    if let Err(error) = finished {
        return discard(&made, error);
    }
    if fault.is_none() && has_index {
        std::fs::remove_file(&made).map_err(refused)?;
    } else {
        std::fs::rename(&made, path).map_err(refused)?;
    }
    Ok(RepairedRecording { frame_sets: copied.frame_sets, fault })
}

fn discard<T>(made: &Path, error: RecordingError) -> Result<T, RecordingError> {
    // What could not be written is of no use, and may not even be there.
    let _ = std::fs::remove_file(made);
    Err(error)
}

/// How far the copy is.
struct Copied {
    next: Option<FrameSet>,
    frame_sets: usize,
    lenses: Vec<SensorKind>,
}

impl Copied {
    fn copy(
        &mut self,
        reader: &mut McapReader,
        writer: &mut McapWriter,
    ) -> Result<(), RecordingError> {
        while let Some(set) = self.next.take() {
            for sensor in SensorKind::ALL {
                if let Some((size, lens)) = reader.factory_lens(sensor)
                    && !self.lenses.contains(&sensor)
                {
                    writer.write_lens(sensor, size, &lens, set.host_time.utc_ns)?;
                    if let Some(color_from_sensor) = reader.factory_pose(sensor) {
                        writer.write_pose(sensor, &color_from_sensor, set.host_time.utc_ns)?;
                    }
                    self.lenses.push(sensor);
                }
            }
            writer.write(&set)?;
            self.frame_sets += 1;
            self.next = reader.next_frame_set()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::frame::{Frame, PixelFormat};
    use crate::imaging::timestamp::HostTime;

    /// Forty frame sets, ten a second.
    fn frame_sets() -> Vec<FrameSet> {
        let set = |sequence: u64| {
            let frame = Frame {
                sensor: SensorKind::Color,
                size: ImageSize::new(64, 48),
                format: PixelFormat::Mono8,
                stride: 64,
                bytes: Arc::from(
                    (0..64 * 48).map(|i| (i * 7 + sequence) as u8).collect::<Vec<_>>(),
                ),
            };
            let utc_ns = 1_770_000_000_000_000_000 + sequence as i64 * 100_000_000;
            FrameSet {
                sequence,
                host_time: HostTime { utc_ns },
                device_time: None,
                name: None,
                frames: vec![frame],
            }
        };
        (0..40).map(set).collect()
    }

    fn read(path: &Path) -> Vec<String> {
        let mut reader = McapReader::open(path, &[]).unwrap();
        assert!(reader.frame_set_count().is_some(), "it has its index");
        std::iter::from_fn(|| reader.next_frame_set().unwrap())
            .map(|set| format!("{set:?}"))
            .collect()
    }

    /// As a kill leaves it: nothing is finished.
    #[test]
    fn a_killed_recording_loses_less_than_a_second_and_is_made_whole() {
        let sets = frame_sets();
        let folder = tempfile::tempdir().unwrap();
        let (path, copy) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
        let mut writer = McapWriter::create(&path, "front").unwrap();
        for (count, set) in sets.iter().enumerate() {
            writer.write(set).unwrap();
            std::fs::copy(&path, &copy).unwrap();
            if count < 6 {
                continue;
            }
            let repaired = repair(&copy).unwrap();
            assert!(repaired.fault.is_some(), "{count}: {repaired:?}");
            let lost = count + 1 - repaired.frame_sets;
            assert!(lost * 100 < 1000, "{lost} frame sets of 100 ms are lost after {count}");
            let expected: Vec<String> =
                sets[..repaired.frame_sets].iter().map(|set| format!("{set:?}")).collect();
            assert_eq!(read(&copy), expected);
        }
    }

    #[test]
    fn a_whole_one_stays_as_it_is_and_others_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = McapWriter::create(&path, "front").unwrap();
        frame_sets().iter().for_each(|set| writer.write(set).unwrap());
        writer.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let repaired = repair(&path).unwrap();
        assert!(repaired.fault.is_none() && repaired.frame_sets == 40);
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
        let other = folder.path().join("other.mcap");
        std::fs::write(&other, b"nothing of the kind").unwrap();
        assert!(matches!(repair(&other), Err(RecordingError::NotARecording { .. })));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing is left behind");
    }
}
