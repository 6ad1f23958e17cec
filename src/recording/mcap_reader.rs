//! Reads MCAP files with the Foxglove schemas, from front to back, with one chunk's part in memory.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::{FactoryCalibration, FactorySensor, StatedLens};
use crate::imaging::frame::{Frame, FrameSet, SensorKind};
use crate::imaging::timestamp::{DeviceTime, HostTime};
use crate::recording::RecordingError;
use crate::recording::depth_record::{self, DEPTH_ENCODING};
use crate::recording::messages::{Topic, decode_frame, decode_lens, decode_pose};
use crate::recording::records::{McapRecord, MessageHeader, RecordReader};
use crate::recording::topic_names::names_topic;

/// Frames of different sensors that come within this time are taken together.
const TOGETHER_NS: u64 = 15_000_000;

/// Metadata records that are kept; Plumb writes two.
const MOST_METADATA: usize = 64;

/// An MCAP file being read: frame set by frame set, of the one camera it holds.
///
/// One that was cut off gives every whole frame before its one error.
pub struct McapReader {
    path: PathBuf,
    /// The topics to read; all where it is empty.
    asked: Vec<String>,
    records: RecordReader,
    schemas: BTreeMap<u16, String>,
    topics: BTreeMap<u16, (Topic, String)>,
    /// Topics with images that were not asked for.
    other_topics: BTreeSet<String>,
    lenses: BTreeMap<SensorKind, (ImageSize, Lens)>,
    /// Where sensors are, as color_from_sensor.
    poses: BTreeMap<SensorKind, Pose>,
    depth_encoding: Option<DepthEncoding>,
    /// Metadata records of others, by name.
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    gathering: Option<Gathering>,
    frame_sets: usize,
    frame_set_count: Option<usize>,
    next_sequence: u64,
    ended: bool,
    error: Option<RecordingError>,
}

/// A frame set whose frames are still coming.
#[derive(Debug)]
struct Gathering {
    set: FrameSet,
    log_time: u64,
}

impl std::fmt::Debug for McapReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("McapReader")
            .field("path", &self.path)
            .field("frame_sets", &self.frame_sets)
            .finish_non_exhaustive()
    }
}

impl McapReader {
    /// Opens the file at `path`, for the topics that `asked` names (or their beginnings up to a
    /// slash); for all where it is empty.
    ///
    /// # Errors
    /// [`RecordingError::NotARecording`] unless it begins as an MCAP file does, and what the system
    /// refuses.
    pub fn open(path: &Path, asked: &[String]) -> Result<Self, RecordingError> {
        let refused = |source| RecordingError::Io { path: path.to_owned(), source };
        let not_one = || RecordingError::NotARecording { path: path.to_owned() };
        let mut records = RecordReader::open(path).map_err(refused)?.ok_or_else(not_one)?;
        let frame_set_count = frame_set_count(&mut records);
        let mut reader = Self {
            path: path.to_owned(),
            asked: asked.to_vec(),
            records,
            schemas: BTreeMap::new(),
            topics: BTreeMap::new(),
            other_topics: BTreeSet::new(),
            lenses: BTreeMap::new(),
            poses: BTreeMap::new(),
            depth_encoding: None,
            metadata: BTreeMap::new(),
            gathering: None,
            frame_sets: 0,
            frame_set_count,
            next_sequence: 0,
            ended: false,
            error: None,
        };
        reader.rewind()?;
        Ok(reader)
    }

    /// Starts again at the first frame set.
    ///
    /// # Errors
    /// When the file can no longer be read.
    pub fn rewind(&mut self) -> Result<(), RecordingError> {
        let refused = |source| RecordingError::Io { path: self.path.clone(), source };
        self.records.rewind().map_err(refused)?;
        (self.gathering, self.error) = (None, None);
        (self.frame_sets, self.next_sequence, self.ended) = (0, 0, false);
        Ok(())
    }

    /// The camera whose frames it holds, as far as the file has been read.
    pub fn camera(&self) -> Option<&str> {
        self.topics.values().find_map(|(topic, _)| match topic {
            Topic::Frames { camera, .. } => Some(camera.as_str()),
            Topic::Calibration { .. } | Topic::Transform { .. } => None,
        })
    }

    /// How many frame sets there are, if the file has its index.
    pub fn frame_set_count(&self) -> Option<usize> {
        self.frame_set_count
    }

    /// Metadata records besides those of the device, as far as the file has been read.
    pub(super) fn metadata(&self) -> &BTreeMap<String, BTreeMap<String, String>> {
        &self.metadata
    }

    /// What the recorded device stated of its sensors before the first frame.
    pub fn factory(&self) -> FactoryCalibration {
        let Ok(mut ahead) = Self::open(&self.path, &self.asked) else {
            return FactoryCalibration::default();
        };
        // What is damaged is reported when the frames are read.
        let _first = ahead.next_frame_set();
        let sensors = ahead.lenses.iter().map(|(sensor, (image_size, lens))| FactorySensor {
            sensor: *sensor,
            image_size: *image_size,
            stated: StatedLens {
                model: lens.model().name().to_owned(),
                focal_px: [lens.matrix.fx, lens.matrix.fy],
                principal_px: [lens.matrix.cx, lens.matrix.cy],
                coefficients: lens.distortion.coefficients().to_vec(),
            },
            lens: Some(*lens),
            color_from_sensor: match sensor {
                SensorKind::Color => Some(Pose::identity()),
                other => ahead.poses.get(other).copied(),
            },
        });
        FactoryCalibration { sensors: sensors.collect(), depth_encoding: ahead.depth_encoding }
    }

    /// The next frames taken together; `None` after the last.
    ///
    /// # Errors
    /// [`RecordingError::Cut`] and [`RecordingError::Damaged`] once, after every frame that can be
    /// read; [`RecordingError::NoFrames`], [`RecordingError::NoSuchTopic`] and
    /// [`RecordingError::SeveralCameras`].
    pub fn next_frame_set(&mut self) -> Result<Option<FrameSet>, RecordingError> {
        while !self.ended {
            let taken = match self.records.next_record() {
                Ok(Some(record)) => self.take(record),
                Ok(None) if self.frame_sets == 0 && self.gathering.is_none() => {
                    Err(self.no_frames())
                }
                Ok(None) => {
                    self.ended = true;
                    Ok(None)
                }
                Err(error) => Err(error.at(&self.path, self.frame_sets)),
            };
            match taken {
                Ok(Some(set)) => return Ok(Some(set)),
                Ok(None) => {}
                Err(error) => {
                    self.ended = true;
                    self.error = Some(error);
                }
            }
        }
        // What was gathered is whole: it goes out before the error.
        if let Some(gathering) = self.gathering.take() {
            self.frame_sets += 1;
            return Ok(Some(gathering.set));
        }
        self.error.take().map_or(Ok(None), Err)
    }

    /// Takes a record in; gives the frame set that it completes.
    fn take(&mut self, record: McapRecord) -> Result<Option<FrameSet>, RecordingError> {
        match record {
            McapRecord::Schema { id, name } => {
                self.schemas.insert(id, name);
            }
            McapRecord::Channel { id, schema_id, topic, .. } => {
                let is_asked = names_topic(&self.asked, &topic);
                let known = Topic::parse(&topic);
                if !is_asked && matches!(known, Some(Topic::Frames { .. })) {
                    self.other_topics.insert(topic);
                }
                if let Some(topic) = known.filter(|_| is_asked) {
                    let schema = self.schemas.get(&schema_id).cloned().unwrap_or_default();
                    self.check_camera(&topic)?;
                    self.topics.insert(id, (topic, schema));
                }
            }
            McapRecord::Message { header, data } => match self.topics.get(&header.channel_id) {
                Some((Topic::Frames { sensor, .. }, schema)) => {
                    let frame = decode_frame(schema, *sensor, &data)
                        .map_err(|error| self.unreadable(error.to_string()))?;
                    return Ok(self.gather(frame, &header));
                }
                Some((Topic::Calibration { sensor, .. }, _)) => {
                    if let Some(lens) = decode_lens(&data) {
                        self.lenses.insert(*sensor, lens);
                    }
                }
                Some((Topic::Transform { sensor, .. }, _)) => {
                    if let Some(color_from_sensor) = decode_pose(&data) {
                        self.poses.insert(*sensor, color_from_sensor);
                    }
                }
                None => {}
            },
            McapRecord::Metadata { name, entries } if name == DEPTH_ENCODING => {
                self.depth_encoding = depth_record::encoding(&entries);
            }
            McapRecord::Metadata { name, entries } if self.metadata.len() < MOST_METADATA => {
                self.metadata.insert(name, entries);
            }
            _ => {}
        }
        Ok(None)
    }

    fn check_camera(&self, topic: &Topic) -> Result<(), RecordingError> {
        let other = self
            .topics
            .values()
            .map(|(known, _)| known.camera())
            .find(|camera| *camera != topic.camera());
        let Some(other) = other.map(str::to_owned) else { return Ok(()) };
        let cameras = [format!("/{other}"), format!("/{}", topic.camera())];
        Err(RecordingError::SeveralCameras { path: self.path.clone(), cameras })
    }

    /// Adds a frame to the set it was taken with; gives the set before it if it is the first of a
    /// new one.
    fn gather(&mut self, frame: Frame, header: &MessageHeader) -> Option<FrameSet> {
        if let Some(gathering) = &mut self.gathering {
            let is_later = header.log_time.abs_diff(gathering.log_time) > TOGETHER_NS;
            if !is_later && gathering.set.frame(frame.sensor).is_none() {
                gathering.set.frames.push(frame);
                gathering.set.frames.sort_by_key(|frame| frame.sensor);
                return None;
            }
        }
        // Recorders that do not count leave 0.
        let sequence = u64::from(header.sequence).max(self.next_sequence);
        self.next_sequence = sequence + 1;
        let nanoseconds = |time: u64| i64::try_from(time).unwrap_or(i64::MAX);
        let device_time = (header.publish_time != header.log_time)
            .then(|| DeviceTime { monotonic_ns: nanoseconds(header.publish_time) });
        let set = FrameSet {
            sequence,
            host_time: HostTime { utc_ns: nanoseconds(header.log_time) },
            device_time,
            name: None,
            frames: vec![frame],
        };
        let done = self.gathering.replace(Gathering { set, log_time: header.log_time });
        self.frame_sets += usize::from(done.is_some());
        done.map(|gathering| gathering.set)
    }

    fn no_frames(&self) -> RecordingError {
        let path = self.path.clone();
        if self.other_topics.is_empty() {
            return RecordingError::NoFrames { path };
        }
        let known: Vec<&str> = self.other_topics.iter().map(String::as_str).collect();
        let (topic, known) = (self.asked.join(", "), known.join(", "));
        RecordingError::NoSuchTopic { path, topic, known }
    }

    fn unreadable(&self, reason: String) -> RecordingError {
        RecordingError::Damaged { path: self.path.clone(), frame_sets: self.frame_sets, reason }
    }
}

/// The metadata record `name` of the MCAP file at `path`; `None` if it has none.
///
/// # Errors
/// As [`McapReader::open`], and [`RecordingError::Damaged`] for a file that cannot be read to its
/// end.
pub fn metadata(
    path: &Path,
    name: &str,
) -> Result<Option<BTreeMap<String, String>>, RecordingError> {
    let mut records = McapReader::open(path, &[])?.records;
    while let Some(record) = records.next_record().map_err(|error| error.at(path, 0))? {
        if let McapRecord::Metadata { name: found, entries } = record
            && found == name
        {
            return Ok(Some(entries));
        }
    }
    Ok(None)
}

/// From the summary at the file's end: the most messages that any sensor's topic has.
fn frame_set_count(records: &mut RecordReader) -> Option<usize> {
    if !records.seek_to_summary().ok()? {
        return None;
    }
    let mut of_frames = Vec::new();
    let mut counts = BTreeMap::new();
    while let Some(record) = records.next_record().ok()? {
        match record {
            McapRecord::Channel { id, topic, .. }
                if matches!(Topic::parse(&topic), Some(Topic::Frames { .. })) =>
            {
                of_frames.push(id);
            }
            McapRecord::Statistics { message_counts } => counts = message_counts,
            _ => {}
        }
    }
    of_frames.iter().filter_map(|id| counts.get(id)).map(|count| *count as usize).max()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::imaging::frame::PixelFormat;
    use crate::recording::McapWriter;

    fn frame(sensor: SensorKind, format: PixelFormat, bytes: &[u8]) -> Frame {
        let (size, stride) = match format.bytes_per_pixel() {
            Some(bytes_per_pixel) => (ImageSize::new(4, 2), 4 * bytes_per_pixel),
            None => (ImageSize::new(0, 0), 0),
        };
        Frame { sensor, size, format, stride, bytes: Arc::from(bytes) }
    }

    /// Twenty frame sets; every third without depth.
    fn frame_sets() -> Vec<FrameSet> {
        let set = |k: u64| {
            let mut frames = vec![frame(SensorKind::Color, PixelFormat::Mono8, &[k as u8; 8])];
            if !k.is_multiple_of(3) {
                frames.push(frame(SensorKind::Depth, PixelFormat::Depth16, &[k as u8; 16]));
            }
            FrameSet {
                sequence: 10 + 2 * k,
                host_time: HostTime { utc_ns: 1_700_000_000_000_000_000 + k as i64 * 33_333_333 },
                device_time: Some(DeviceTime { monotonic_ns: 5 + k as i64 }),
                name: None,
                frames,
            }
        };
        (0..20).map(set).collect()
    }

    fn write(path: &Path, sets: &[FrameSet]) {
        let mut writer = McapWriter::create(path, "front").unwrap();
        for set in sets {
            writer.write(set).unwrap();
        }
        writer
            .write_metadata("plumb.truth", BTreeMap::from([("seed".into(), "7".into())]))
            .unwrap();
        writer.finish().unwrap();
    }

    fn read(path: &Path) -> (Vec<FrameSet>, Result<(), RecordingError>) {
        let mut sets = Vec::new();
        let mut reader = match McapReader::open(path, &[]) {
            Ok(reader) => reader,
            Err(error) => return (sets, Err(error)),
        };
        loop {
            match reader.next_frame_set() {
                Ok(Some(set)) => sets.push(set),
                Ok(None) => return (sets, Ok(())),
                Err(error) => {
                    assert!(reader.next_frame_set().unwrap().is_none(), "one error, then the end");
                    return (sets, Err(error));
                }
            }
        }
    }

    /// Everything of a frame set, as text that can be compared.
    fn key(set: &FrameSet) -> String {
        format!("{set:?}")
    }

    #[test]
    fn frame_sets_survive() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.mcap");
        write(&path, &frame_sets());
        let (sets, end) = read(&path);
        assert!(end.is_ok(), "{end:?}");
        assert_eq!(
            sets.iter().map(key).collect::<Vec<_>>(),
            frame_sets().iter().map(key).collect::<Vec<_>>()
        );
        assert_eq!(McapReader::open(&path, &[]).unwrap().frame_set_count(), Some(20));
        assert_eq!(metadata(&path, "plumb.truth").unwrap().unwrap()["seed"], "7");
        assert_eq!(metadata(&path, "other").unwrap(), None);
    }

    #[test]
    fn a_file_cut_anywhere_gives_its_whole_frames_and_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.mcap");
        let written = &frame_sets()[..6];
        write(&path, written);
        let whole = std::fs::read(&path).unwrap();
        let mut most = 0;
        for cut in (0..whole.len()).step_by(3) {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let (sets, end) = read(&path);
            assert!(sets.len() >= most, "{} after {most} at {cut}", sets.len());
            most = sets.len();
            assert!(sets.iter().zip(written).all(|(a, b)| a.sequence == b.sequence));
            if let Err(error) = end {
                let line = error.to_string();
                assert!(line.contains("walk.mcap") && !line.contains('\n'), "{line}");
            }
            // Depth comes after color: until the next set begins, a set may lack it.
            let complete =
                sets.iter().rev().skip(1).zip(written[..sets.len()].iter().rev().skip(1));
            assert!({ complete }.all(|(a, b)| key(a) == key(b)), "at {cut}");
        }
        assert_eq!(most, 6);
    }

    #[test]
    fn any_byte_may_be_wrong_without_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.mcap");
        write(&path, &frame_sets()[..2]);
        let whole = std::fs::read(&path).unwrap();
        for at in (0..whole.len()).step_by(2) {
            for value in [0xff, whole[at] ^ 0x20] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                std::fs::write(&path, &bytes).unwrap();
                let (_, end) = read(&path);
                let line = end.err().map(|error| error.to_string()).unwrap_or_default();
                assert!(!line.contains('\n'), "{line}");
            }
        }
    }

    #[test]
    fn two_cameras_in_one_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two.mcap");
        let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
        for topic in ["/left/color", "/right/color"] {
            let channel = writer.add_channel(0, topic, "protobuf", &BTreeMap::new()).unwrap();
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: 0,
                log_time: 0,
                publish_time: 0,
            };
            writer.write_to_known_channel(&header, &[]).unwrap();
        }
        writer.finish().unwrap();
        let line = read(&path).1.unwrap_err().to_string();
        assert!(
            line.contains("not foxglove.CompressedImage") || line.contains("left and right"),
            "{line}"
        );
    }

    #[test]
    fn a_topic_that_is_not_there_is_refused_with_those_that_are() {
        let path = Path::new("recordings/walk.mcap");
        let mut reader = McapReader::open(path, &["/nope".to_owned()]).unwrap();
        let line = reader.next_frame_set().unwrap_err().to_string();
        assert!(line.contains("no images on the topic `/nope`: there are /"), "{line}");
    }
}
