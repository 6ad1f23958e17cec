//! ROS bags: rosbag2 in MCAP and SQLite, and the .bag files of ROS 1.
//!
//! A bag is a [`BagStorage`] that yields messages; what the messages say is the same for all of
//! them. Image topics are found by type and grouped into cameras by their names; a frame's time is
//! its `header.stamp`, and frames of one camera with equal stamps are one frame set.

mod camera_info;
mod camera_messages;
mod folder;
mod image_error;
mod images;
mod mcap_storage;
mod ros1_storage;
mod sqlite_storage;
mod stamped_sets;
mod stated;
mod storage;
mod topics;
mod transforms;

pub use camera_messages::{CameraMessageError, CameraMessages};
pub(super) use folder::{holds_bag, is_bag_file};
pub use image_error::RosImageError;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{FrameSet, SensorKind};
use crate::recording::RecordingError;
use crate::recording::bag::camera_info::CameraInfo;
use crate::recording::bag::stamped_sets::StampedSets;
use crate::recording::bag::stated::stated;
use crate::recording::bag::storage::{BagMessage, BagStorage, BagTopic};
use crate::recording::bag::topics::{CameraTopics, Role};
use crate::recording::bag::transforms::FrameTree;

/// How many messages are searched for what a camera states of itself: drivers send camera_info
/// with every image and transforms at the start.
const STATED_WITHIN_MESSAGES: usize = 500;

/// A bag being read: the frame sets of one camera.
pub struct BagReader {
    path: PathBuf,
    storage: Box<dyn BagStorage>,
    topics: Vec<BagTopic>,
    /// What each topic with this index is to the camera.
    roles: BTreeMap<usize, Role>,
    wanted: Vec<bool>,
    sets: StampedSets,
    factory: FactoryCalibration,
    given: usize,
    ended: bool,
    error: Option<RecordingError>,
}

impl std::fmt::Debug for BagReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BagReader").field("path", &self.path).finish_non_exhaustive()
    }
}

/// Whether an MCAP file has images in messages of ROS.
///
/// # Errors
/// As [`BagReader::open`].
pub(super) fn mcap_has_ros_images(path: &Path) -> Result<bool, RecordingError> {
    let storage = mcap_storage::McapStorage::open(path)?;
    Ok(storage.topics().iter().any(topics::carries_images))
}

impl BagReader {
    /// Opens the bag at `path`, a file or a folder, for the camera of `topics`: names of topics or
    /// their beginnings up to a slash; of the only camera where none is given.
    ///
    /// # Errors
    /// [`RecordingError`] for what is no bag, holds no images, or several cameras.
    pub fn open(path: &Path, topics: &[String]) -> Result<Self, RecordingError> {
        let storage = folder::open(path)?;
        let known = storage.topics().to_vec();
        let camera = CameraTopics::pick(path, &known, topics)?;
        let mut reader = Self {
            path: path.to_owned(),
            storage,
            wanted: vec![false; known.len()],
            topics: known,
            sets: StampedSets::new(camera.images()),
            roles: camera.roles,
            factory: FactoryCalibration::default(),
            given: 0,
            ended: false,
            error: None,
        };
        reader.factory = reader.read_factory()?;
        reader.rewind()?;
        Ok(reader)
    }

    /// What the camera's driver states: `camera_info` of each sensor, and how the sensors lie to
    /// each other by `tf_static`.
    pub fn factory(&self) -> &FactoryCalibration {
        &self.factory
    }

    /// Starts again at the first frame set.
    ///
    /// # Errors
    /// When the bag can no longer be read.
    pub fn rewind(&mut self) -> Result<(), RecordingError> {
        self.want(|role| matches!(role, Role::Image(_)));
        self.storage.rewind().map_err(|error| error.at(&self.path, 0))?;
        self.sets.clear();
        (self.given, self.ended, self.error) = (0, false, None);
        Ok(())
    }

    /// The next frames taken together; `None` after the last.
    ///
    /// # Errors
    /// Once, after every frame that can be read: [`RecordingError::Cut`],
    /// [`RecordingError::Damaged`], [`RecordingError::UnknownImage`] and
    /// [`RecordingError::NoFrames`].
    pub fn next_frame_set(&mut self) -> Result<Option<FrameSet>, RecordingError> {
        while !self.ended {
            if let Some(set) = self.sets.pop_complete() {
                self.given += 1;
                return Ok(Some(set));
            }
            let taken = match self.storage.next_message(&self.wanted) {
                Ok(Some(message)) => self.take(&message),
                Ok(None) if self.given == 0 && self.sets.is_empty() => {
                    self.ended = true;
                    Err(RecordingError::NoFrames { path: self.path.clone() })
                }
                Ok(None) => {
                    self.ended = true;
                    Ok(())
                }
                Err(error) => Err(error.at(&self.path, self.given)),
            };
            if let Err(error) = taken {
                (self.ended, self.error) = (true, Some(error));
            }
        }
        if let Some(set) = self.sets.pop() {
            self.given += 1;
            return Ok(Some(set));
        }
        self.error.take().map_or(Ok(None), Err)
    }

    fn want(&mut self, wanted: impl Fn(&Role) -> bool) {
        for (topic, role) in &self.roles {
            self.wanted[*topic] = wanted(role);
        }
    }

    fn take(&mut self, message: &BagMessage) -> Result<(), RecordingError> {
        let Some(Role::Image(image)) = self.roles.get(&message.topic) else { return Ok(()) };
        let topic = &self.topics[message.topic];
        let unknown = |error: RosImageError| RecordingError::UnknownImage {
            path: self.path.clone(),
            topic: topic.name.clone(),
            reason: error.to_string(),
        };
        let (header, frame) = images::read(topic, *image, &message.bytes).map_err(unknown)?;
        let stamp_ns = if header.stamp_ns == 0 { message.log_time_ns } else { header.stamp_ns };
        self.sets.push(stamp_ns, frame);
        Ok(())
    }

    /// Reads the first messages for what the camera states of itself.
    fn read_factory(&mut self) -> Result<FactoryCalibration, RecordingError> {
        self.want(|_| true);
        let mut infos: BTreeMap<SensorKind, CameraInfo> = BTreeMap::new();
        let mut frame_ids: BTreeMap<SensorKind, String> = BTreeMap::new();
        let mut tree = FrameTree::default();
        for _ in 0..STATED_WITHIN_MESSAGES {
            // What is damaged is reported when the frames are read.
            let Ok(Some(message)) = self.storage.next_message(&self.wanted) else { break };
            let Some(role) = self.roles.get(&message.topic) else { continue };
            let topic = &self.topics[message.topic];
            match role {
                Role::Image(image) => {
                    if let Ok((header, frame)) = images::read(topic, *image, &message.bytes) {
                        frame_ids.entry(frame.sensor).or_insert(header.frame_id);
                    }
                }
                Role::CameraInfo(sensor) => {
                    if let Ok(info) = CameraInfo::read(topic.layout, &message.bytes) {
                        infos.entry(*sensor).or_insert(info);
                    }
                }
                Role::Transforms => {
                    // A message that cannot be read states nothing.
                    let _ = tree.read(topic.layout, &message.bytes);
                }
            }
        }
        Ok(stated(infos, &frame_ids, &tree))
    }
}
