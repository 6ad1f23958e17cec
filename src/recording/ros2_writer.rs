//! Writes frame sets as a rosbag2: a folder with an MCAP file and `metadata.yaml`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::recording::RecordingError;
use crate::recording::mcap_writer::write_error;
use crate::recording::ros2_messages::{Ros2Message, camera_info, definition, image};

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
        Ok(Self { folder, file_name, camera, writer, topics, times_ns: None })
    }

    /// Appends the frames of `set`, at its host time.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the system refuses, as on a full disk.
    pub fn write(&mut self, set: &FrameSet) -> Result<(), RecordingError> {
        for frame in &set.frames {
            if let Some(message) = image(frame, &self.camera, set.host_time.utc_ns) {
                self.append(&message, set.sequence as u32, set.host_time.utc_ns)?;
            }
        }
        Ok(())
    }

    /// Notes what the device states of a sensor's lens, where ROS has its model.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_lens(
        &mut self,
        sensor: SensorKind,
        size: ImageSize,
        lens: &Lens,
        utc_ns: i64,
    ) -> Result<(), RecordingError> {
        match camera_info(&self.camera, sensor, lens, size, utc_ns) {
            Some(message) => self.append(&message, 0, utc_ns),
            None => Ok(()),
        }
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
        let (duration, file) = (last - first, &self.file_name);
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
