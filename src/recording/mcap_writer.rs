//! Writes frame sets as MCAP with the Foxglove schemas.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::recording::RecordingError;
use crate::recording::depth_record::{self, DEPTH_ENCODING};
use crate::recording::messages::{Encoded, Topic, encode_frame, encode_lens, encode_pose};

/// An MCAP file being written: one topic a sensor, chunks of about a megabyte, indexed when
/// finished.
///
/// Frames are stored as they came; a recording that ends without [`Self::finish`] can be read up to
/// its last whole chunk, and loses less than a second: chunks end by time, too.
pub struct McapWriter {
    path: PathBuf,
    camera: String,
    writer: mcap::Writer<BufWriter<File>>,
    /// When the chunk that is being written began, in frame time.
    chunk_began_ns: Option<i64>,
}

/// The longest that frames wait in memory for their chunk to be full: half of the second that a
/// killed process may lose.
const LONGEST_CHUNK_NS: i64 = 500_000_000;

impl std::fmt::Debug for McapWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("McapWriter")
            .field("path", &self.path)
            .field("camera", &self.camera)
            .finish_non_exhaustive()
    }
}

impl McapWriter {
    /// Begins the file at `path`, in place of any that is there, for the frames of `camera`.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the system refuses.
    pub fn create(path: &Path, camera: &str) -> Result<Self, RecordingError> {
        let refused = |source| RecordingError::Io { path: path.to_owned(), source };
        let file = BufWriter::new(File::create(path).map_err(refused)?);
        // Lossless, for raw frames and depth; JPEG goes through it unchanged at a hundredth of a
        // core. At the fastest level and in this thread: recording must not take the processor from
        // detection.
        let options = mcap::WriteOptions::new()
            .compression(Some(mcap::Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .library(concat!("plumb ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(file).map_err(|error| write_error(path, error))?;
        Ok(Self { path: path.to_owned(), camera: camera.to_owned(), writer, chunk_began_ns: None })
    }

    /// Appends the frames of `set`: logged at its host time, published at its device time where it
    /// has one.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the system refuses, as on a full disk.
    pub fn write(&mut self, set: &FrameSet) -> Result<(), RecordingError> {
        let log_time = set.host_time.utc_ns.max(0).unsigned_abs();
        let publish_time =
            set.device_time.map_or(log_time, |time| time.monotonic_ns.max(0).unsigned_abs());
        for frame in &set.frames {
            let topic = Topic::Frames { camera: self.camera.clone(), sensor: frame.sensor };
            let Some(message) =
                encode_frame(frame, &self.frame_id(frame.sensor), set.host_time.utc_ns)
            else {
                continue;
            };
            self.append(&topic, &message, set.sequence as u32, [log_time, publish_time])?;
        }
        let now_ns = set.host_time.utc_ns;
        let began_ns = *self.chunk_began_ns.get_or_insert(now_ns);
        // A clock that was set back ends the chunk as well.
        if !(0..LONGEST_CHUNK_NS).contains(&now_ns.saturating_sub(began_ns)) {
            self.writer.flush().map_err(|error| write_error(&self.path, error))?;
            self.chunk_began_ns = None;
        }
        Ok(())
    }

    /// Notes what the device states of its sensors: lenses, where they are, and what readings of
    /// depth mean. To be called before the first frame, so that readers know it by then.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_factory(
        &mut self,
        factory: &FactoryCalibration,
        utc_ns: i64,
    ) -> Result<(), RecordingError> {
        for stated in &factory.sensors {
            if let Some(lens) = &stated.lens {
                self.write_lens(stated.sensor, stated.image_size, lens, utc_ns)?;
            }
            let others = stated.color_from_sensor.filter(|_| stated.sensor != SensorKind::Color);
            if let Some(color_from_sensor) = others {
                self.write_pose(stated.sensor, &color_from_sensor, utc_ns)?;
            }
        }
        match &factory.depth_encoding {
            Some(encoding) => self.write_metadata(DEPTH_ENCODING, depth_record::entries(encoding)),
            None => Ok(()),
        }
    }

    /// Notes what the device states of a sensor's lens.
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
        let topic = Topic::Calibration { camera: self.camera.clone(), sensor };
        let Some(message) = encode_lens(lens, size, &self.frame_id(sensor), utc_ns) else {
            return Ok(());
        };
        self.append(&topic, &message, 0, [utc_ns.max(0).unsigned_abs(); 2])
    }

    /// Notes where the device states a sensor to be from its color sensor.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_pose(
        &mut self,
        sensor: SensorKind,
        color_from_sensor: &Pose,
        utc_ns: i64,
    ) -> Result<(), RecordingError> {
        let topic = Topic::Transform { camera: self.camera.clone(), sensor };
        let frames = [SensorKind::Color, sensor].map(|sensor| self.frame_id(sensor));
        let Some(message) = encode_pose(color_from_sensor, frames, utc_ns) else { return Ok(()) };
        self.append(&topic, &message, 0, [utc_ns.max(0).unsigned_abs(); 2])
    }

    /// Writes the metadata record `name`.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), RecordingError> {
        let record = mcap::records::Metadata { name: name.to_owned(), metadata };
        self.writer.write_metadata(&record).map_err(|error| write_error(&self.path, error))
    }

    /// Writes the index and closes the file.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish().map(|_| ()).map_err(|error| write_error(&self.path, error))
    }

    fn frame_id(&self, sensor: SensorKind) -> String {
        format!("{}_{}", self.camera, sensor.name())
    }

    fn append(
        &mut self,
        topic: &Topic,
        message: &Encoded,
        sequence: u32,
        [log_time, publish_time]: [u64; 2],
    ) -> Result<(), RecordingError> {
        let path = &self.path;
        let failed = |error| write_error(path, error);
        let schema = self
            .writer
            .add_schema(message.schema, "protobuf", &message.descriptor)
            .map_err(failed)?;
        let channel = self
            .writer
            .add_channel(schema, &topic.name(), "protobuf", &BTreeMap::new())
            .map_err(failed)?;
        let header = MessageHeader { channel_id: channel, sequence, log_time, publish_time };
        self.writer.write_to_known_channel(&header, &message.bytes).map_err(failed)
    }
}

pub(super) fn write_error(path: &Path, error: mcap::McapError) -> RecordingError {
    let source = match error {
        mcap::McapError::Io(source) => source,
        other => std::io::Error::other(other.to_string()),
    };
    RecordingError::Io { path: path.to_owned(), source }
}
