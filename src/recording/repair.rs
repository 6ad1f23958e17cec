//! Makes a recording whole that was cut off: what can be read of it, with its index.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::imaging::frame::FrameSet;
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
    /// Where the damaged file lies now; `None` for one that was whole, or was never finished, of which
    /// nothing follows the fault.
    pub original: Option<PathBuf>,
}

/// Reads the recording at `path` as far as it can be read, and puts a whole one with its index in
/// its place; one that is whole is left as it is. One that was finished and is damaged in its middle
/// is kept beside it: what follows the damage is in no copy.
///
/// # Errors
/// [`RecordingError`] for what is no recording or holds no frames, and what the system refuses; the
/// file is then as it was.
pub fn repair(path: &Path) -> Result<RepairedRecording, RecordingError> {
    let made = path.with_extension("repaired");
    let mut reader = McapReader::open(path, &[])?;
    let has_index = reader.frame_set_count().is_some();
    let mut copied = Copied { next: reader.next_frame_set()?, frame_sets: 0 };
    let camera = reader.camera().unwrap_or_default().to_owned();
    let mut writer = McapWriter::create(&made, &camera)?;
    let outcome = copied.copy(&mut reader, &mut writer);
    let finished = writer.finish();
    let fault = match outcome {
        Ok(()) => None,
        Err(fault @ (RecordingError::Cut { .. } | RecordingError::Damaged { .. })) => Some(fault),
        Err(error) => return discard(&made, error),
    };
    let is_damaged = has_index && matches!(fault, Some(RecordingError::Damaged { .. }));
    let original = is_damaged.then(|| path.with_extension("damaged.mcap"));
    let is_whole = fault.is_none() && has_index;
    let replaced = finished.and_then(|()| match is_whole {
        true => fs::remove_file(&made).map_err(|source| refused(&made, source)),
        false => replace(path, &made, original.as_deref()),
    });
    if let Err(error) = replaced {
        return discard(&made, error);
    }
    Ok(RepairedRecording { frame_sets: copied.frame_sets, fault, original })
}

/// Puts `made` in the place of the file at `path`, which is kept as `original` where that is given.
fn replace(path: &Path, made: &Path, original: Option<&Path>) -> Result<(), RecordingError> {
    let synced = fs::File::open(made).and_then(|file| file.sync_all());
    synced.map_err(|source| refused(made, source))?;
    if let Some(original) = original {
        if original.exists() {
            // What an earlier repair kept.
            return Err(refused(original, ErrorKind::AlreadyExists.into()));
        }
        fs::rename(path, original).map_err(|source| refused(path, source))?;
    }
    fs::rename(made, path).map_err(|source| refused(path, source))
}

fn refused(path: &Path, source: std::io::Error) -> RecordingError {
    RecordingError::Io { path: path.to_owned(), source }
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
}

impl Copied {
    fn copy(
        &mut self,
        reader: &mut McapReader,
        writer: &mut McapWriter,
    ) -> Result<(), RecordingError> {
        if let Some(first) = &self.next {
            writer.write_factory(&reader.factory(), first.host_time.utc_ns)?;
        }
        let copied = self.copy_frames(reader, writer);
        for (name, entries) in reader.metadata() {
            writer.write_metadata(name, entries.clone())?;
        }
        copied
    }

    fn copy_frames(
        &mut self,
        reader: &mut McapReader,
        writer: &mut McapWriter,
    ) -> Result<(), RecordingError> {
        while let Some(set) = self.next.take() {
            writer.write(&set)?;
            self.frame_sets += 1;
            self.next = reader.next_frame_set()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use super::*;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::depth_encoding::DepthEncoding;
    use crate::imaging::factory::FactoryCalibration;
    use crate::imaging::frame::{Frame, PixelFormat, SensorKind};
    use crate::imaging::timestamp::HostTime;
    use crate::recording::mcap_reader::metadata;

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

    /// A byte in the middle of the pixels is wrong: the first part is read, the rest is not lost.
    #[test]
    fn a_damaged_one_is_kept_beside_what_could_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = McapWriter::create(&path, "front").unwrap();
        let depth_encoding = Some(DepthEncoding::metric(1e-4));
        let factory = FactoryCalibration { sensors: Vec::new(), depth_encoding };
        writer.write_factory(&factory, frame_sets()[0].host_time.utc_ns).unwrap();
        writer
            .write_metadata("plumb.truth", BTreeMap::from([("seed".into(), "7".into())]))
            .unwrap();
        frame_sets().iter().for_each(|set| writer.write(set).unwrap());
        writer.finish().unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let at = bytes.len() * 2 / 3;
        bytes[at] ^= 0x55;
        fs::write(&path, &bytes).unwrap();
        let repaired = repair(&path).unwrap();
        assert!(matches!(repaired.fault, Some(RecordingError::Damaged { .. })), "{repaired:?}");
        assert!((1..40).contains(&repaired.frame_sets), "{repaired:?}");
        let original = repaired.original.unwrap();
        assert_eq!(fs::read(&original).unwrap(), bytes);
        assert_eq!(read(&path).len(), repaired.frame_sets);
        assert_eq!(McapReader::open(&path, &[]).unwrap().factory(), factory);
        assert_eq!(metadata(&path, "plumb.truth").unwrap().unwrap()["seed"], "7");
        // What was kept is not written over by the next one.
        fs::write(&path, &bytes).unwrap();
        assert!(matches!(repair(&path), Err(RecordingError::Io { .. })));
        assert_eq!(
            (fs::read(&path).unwrap(), fs::read(&original).unwrap()),
            (bytes.clone(), bytes)
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing is left behind");
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
