//! Writes frame sets as a rosbag2: a folder with an MCAP file and `metadata.yaml`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;

use crate::geometry::depth_camera::DepthReading;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::recording::RecordingError;
use crate::recording::mcap_writer::write_error;
use crate::recording::ros2_messages::{
    Ros2Message, camera_info, definition, depth_in_meters, image,
};

/// A bag being written: frames as they came, raw or compressed, on the topics of one camera.
pub struct Ros2Writer {
    folder: PathBuf,
    file_name: String,
    camera: String,
    writer: mcap::Writer<BufWriter<File>>,
    /// Of each topic its type and how many messages it has.
    topics: BTreeMap<String, (&'static str, u64)>,
    /// The first and the last message's time.
    times_ns: Option<(u64, u64)>,
    /// What readings of depth mean, and the one that means none, where that is not whole
    /// millimeters and 0.
    depth_in_meters: Option<(DepthReading, Option<u16>)>,
}

impl std::fmt::Debug for Ros2Writer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ros2Writer").field("folder", &self.folder).finish_non_exhaustive()
    }
}

impl Ros2Writer {
    /// Begins the bag in the folder `folder`, which is made, for the frames of `camera`.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the system refuses.
    pub fn create(folder: &Path, camera: &str) -> Result<Self, RecordingError> {
        let refused = |source| RecordingError::Io { path: folder.to_owned(), source };
        fs::create_dir_all(folder).map_err(refused)?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let file_name = format!("{name}_0.mcap");
        let path = folder.join(&file_name);
        let refused = |source| RecordingError::Io { path: path.clone(), source };
        let file = BufWriter::new(File::create(&path).map_err(refused)?);
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            .compression(Some(mcap::Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .library(concat!("plumb ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(file).map_err(|error| write_error(&path, error))?;
        let (folder, camera) = (folder.to_owned(), camera.to_owned());
        let topics = BTreeMap::new();
        let (times_ns, depth_in_meters) = (None, None);
        Ok(Self { folder, file_name, camera, writer, topics, times_ns, depth_in_meters })
    }

    /// Appends the frames of `set`, at its host time.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the system refuses, as on a full disk.
    pub fn write(&mut self, set: &FrameSet) -> Result<(), RecordingError> {
        for frame in &set.frames {
            let meters = self.depth_in_meters.filter(|_| frame.sensor == SensorKind::Depth);
            let message = match meters {
                Some((reading, invalid)) => {
                    depth_in_meters(frame, &self.camera, set.host_time.utc_ns, reading, invalid)
                }
                None => image(frame, &self.camera, set.host_time.utc_ns),
            };
            if let Some(message) = message {
                self.append(&message, set.sequence as u32, set.host_time.utc_ns)?;
            }
        }
        Ok(())
    }

    /// Notes what the device states of its sensors: lenses, where ROS has their model, and what
    /// readings of depth mean. Depth that is not in whole millimeters, as ROS takes 16 bits to be
    /// (REP 118), is written in meters from then on.
    ///
    /// # Errors
    /// As [`Self::write`], and [`RecordingError::NoMeters`] for disparity of unknown meaning.
    pub fn write_factory(
        &mut self,
        factory: &FactoryCalibration,
        utc_ns: i64,
    ) -> Result<(), RecordingError> {
        let encoding = factory.depth_encoding.unwrap_or(DepthEncoding::ORDINARY);
        let no_meters = || RecordingError::NoMeters { path: self.folder.clone() };
        let reading = encoding.reading.ok_or_else(no_meters)?;
        self.depth_in_meters =
            (encoding != DepthEncoding::ORDINARY).then_some((reading, encoding.invalid));
        for stated in &factory.sensors {
            let Some(lens) = &stated.lens else { continue };
            let info = camera_info(&self.camera, stated.sensor, lens, stated.image_size, utc_ns);
            if let Some(message) = info {
                self.append(&message, 0, utc_ns)?;
            }
        }
        Ok(())
    }

    /// Writes the index and the metadata.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let path = self.folder.join(&self.file_name);
        self.writer.finish().map_err(|error| write_error(&path, error))?;
        let path = self.folder.join("metadata.yaml");
        fs::write(&path, self.metadata()).map_err(|source| RecordingError::Io { path, source })
    }

    fn append(
        &mut self,
        message: &Ros2Message,
        sequence: u32,
        utc_ns: i64,
    ) -> Result<(), RecordingError> {
        let path = self.folder.join(&self.file_name);
        let failed = |error| write_error(&path, error);
        let text = definition(message.type_name);
        let schema = self.writer.add_schema(message.type_name, "ros2msg", text.as_bytes());
        let schema = schema.map_err(failed)?;
        let channel = self
            .writer
            .add_channel(schema, &message.topic, "cdr", &BTreeMap::new())
            .map_err(failed)?;
        let time = utc_ns.max(0).unsigned_abs();
        let header =
            MessageHeader { channel_id: channel, sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &message.bytes).map_err(failed)?;
        self.topics.entry(message.topic.clone()).or_insert((message.type_name, 0)).1 += 1;
        let (first, last) = self.times_ns.unwrap_or((time, time));
        self.times_ns = Some((first.min(time), last.max(time)));
        Ok(())
    }

    /// `metadata.yaml` in version 5, which Humble and later read.
    fn metadata(&self) -> String {
        let (first, last) = self.times_ns.unwrap_or_default();
        let count: u64 = self.topics.values().map(|(_, count)| count).sum();
        let (duration, file) = (last - first, quoted(&self.file_name));
        let mut topics = String::new();
        for (name, (type_name, count)) in &self.topics {
            // Writing into a string cannot fail.
            let _ = write!(
                topics,
                "\n    - topic_metadata:\n        name: {name}\n        type: {type_name}\n        serialization_format: cdr\n        offered_qos_profiles: \"\"\n      message_count: {count}"
            );
        }
        let topics = if topics.is_empty() { " []".to_owned() } else { topics };
        format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {duration}\n  starting_time:\n    nanoseconds_since_epoch: {first}\n  message_count: {count}\n  topics_with_message_count:{topics}\n  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  files:\n    - path: {file}\n      starting_time:\n        nanoseconds_since_epoch: {first}\n      duration:\n        nanoseconds: {duration}\n      message_count: {count}\n"
        )
    }
}

/// A YAML string: a folder may be named `run #3`, whose end would be a comment.
fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::pixel::ImageSize;
    use crate::imaging::depth_image::DepthImage;
    use crate::imaging::frame::{Frame, PixelFormat};
    use crate::imaging::timestamp::HostTime;
    use crate::recording::{ReadOptions, Recording};

    fn depth_set(readings: &[u16]) -> FrameSet {
        let frame = Frame {
            sensor: SensorKind::Depth,
            size: ImageSize::new(readings.len() as u32, 1),
            format: PixelFormat::Depth16,
            stride: 2 * readings.len(),
            bytes: Arc::from(readings.iter().flat_map(|r| r.to_le_bytes()).collect::<Vec<_>>()),
        };
        let host_time = HostTime { utc_ns: 1_770_000_000_000_000_000 };
        FrameSet { sequence: 0, host_time, device_time: None, name: None, frames: vec![frame] }
    }

    /// Readers of ROS take 16 bits for millimeters.
    #[test]
    fn depth_is_as_far_away_for_readers_whatever_the_device_s_unit() {
        let disparity = DepthReading::Disparity { offset: 3.0, slope: -0.001 };
        let invalid = Some(2047);
        for (encoding, readings, millimeters) in [
            (DepthEncoding::ORDINARY, [0, 1500, 65_535], [0, 1500, 65_535]),
            (DepthEncoding::metric(1e-4), [0, 15_000, 65_535], [0, 1500, 6554]),
            (
                DepthEncoding { reading: Some(disparity), invalid },
                [2047, 1000, 2500],
                [0, 500, 2000],
            ),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("bag");
            let mut writer = Ros2Writer::create(&path, "front").unwrap();
            let factory =
                FactoryCalibration { sensors: Vec::new(), depth_encoding: Some(encoding) };
            writer.write_factory(&factory, 0).unwrap();
            writer.write(&depth_set(&readings)).unwrap();
            writer.finish().unwrap();
            let mut bag = Recording::open(&path, &ReadOptions::default()).unwrap();
            let set = bag.next_frame_set().unwrap().unwrap();
            let read = DepthImage::from_frame(set.frame(SensorKind::Depth).unwrap()).unwrap();
            assert_eq!(read.readings(), millimeters, "{encoding:?}");
        }
    }

    #[test]
    fn a_folder_s_name_is_written_as_a_yaml_string() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a: it's #3");
        let mut writer = Ros2Writer::create(&path, "front").unwrap();
        writer.write(&depth_set(&[1, 2])).unwrap();
        writer.finish().unwrap();
        let metadata = fs::read_to_string(path.join("metadata.yaml")).unwrap();
        assert!(metadata.contains("    - 'a: it''s #3_0.mcap'\n"), "{metadata}");
        let mut bag = Recording::open(&path, &ReadOptions::default()).unwrap();
        assert!(bag.next_frame_set().unwrap().is_some());
    }

    #[test]
    fn disparity_of_unknown_meaning_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = Ros2Writer::create(&folder.path().join("bag"), "front").unwrap();
        let depth_encoding = Some(DepthEncoding { reading: None, invalid: None });
        let refused =
            writer.write_factory(&FactoryCalibration { sensors: Vec::new(), depth_encoding }, 0);
        assert!(matches!(refused, Err(RecordingError::NoMeters { .. })));
    }
}
