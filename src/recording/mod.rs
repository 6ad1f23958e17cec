//! Frames on disk: MCAP files, ROS bags and folders of images. Uses geometry and imaging.
//!
//! [`Recording::open`] finds out which it is; reading goes frame set by frame set, with a bounded
//! amount in memory. A damaged image is a frame that fails when it is decoded; a recording that
//! was cut off gives all that can be read before its error.

mod bag;
mod depth_record;
mod error;
mod fields;
mod folder;
mod mcap_reader;
mod mcap_writer;
mod messages;
mod natural_order;
mod records;
mod repair;
mod ros2_messages;
pub mod ros2_results;
mod ros2_writer;
mod topic_names;
mod unpack;

use std::path::Path;

pub use bag::{BagReader, CameraMessageError, CameraMessages, RosImageError};
pub use error::RecordingError;
pub use folder::Folder;
pub use mcap_reader::{McapReader, metadata};
pub use mcap_writer::McapWriter;
pub use natural_order::natural_order;
pub use repair::{RepairedRecording, repair};
pub use ros2_writer::Ros2Writer;

use crate::geometry::pixel::ImageSize;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::{FrameSet, SensorKind};

/// How to read a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadOptions {
    /// Frame sets a second of a folder, which has no times; 10 unless said.
    pub fps: f64,
    /// The topics to read, or their beginnings up to a slash; those of the only camera unless
    /// said.
    pub topics: Vec<String>,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { fps: 10.0, topics: Vec::new() }
    }
}

/// A recording being read.
#[derive(Debug)]
pub enum Recording {
    /// Images in a folder.
    Folder(Folder),
    /// An MCAP file of Plumb's or Foxglove's.
    Mcap(Box<McapReader>),
    /// A ROS bag.
    Bag(Box<BagReader>),
}

impl Recording {
    /// Opens the folder, MCAP file or bag at `path`.
    ///
    /// # Errors
    /// [`RecordingError`] when it isn't there or is no recording.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, RecordingError> {
        if !path.exists() {
            return Err(RecordingError::Missing { path: path.to_owned() });
        }
        if is_bag(path)? {
            return Ok(Self::Bag(Box::new(BagReader::open(path, &options.topics)?)));
        }
        if path.is_dir() {
            return Ok(Self::Folder(Folder::open(path, options.fps)?));
        }
        Ok(Self::Mcap(Box::new(McapReader::open(path, &options.topics)?)))
    }

    /// The next frames taken together; `None` after the last.
    ///
    /// # Errors
    /// [`RecordingError`] where reading fails; every frame set before has been given by then.
    pub fn next_frame_set(&mut self) -> Result<Option<FrameSet>, RecordingError> {
        match self {
            Self::Folder(folder) => folder.next_frame_set(),
            Self::Mcap(file) => file.next_frame_set(),
            Self::Bag(bag) => bag.next_frame_set(),
        }
    }

    /// Starts again at the first frame set.
    ///
    /// # Errors
    /// [`RecordingError`] when the file can no longer be read.
    pub fn rewind(&mut self) -> Result<(), RecordingError> {
        match self {
            Self::Folder(folder) => {
                folder.rewind();
                Ok(())
            }
            Self::Mcap(file) => file.rewind(),
            Self::Bag(bag) => bag.rewind(),
        }
    }

    /// How many frame sets there are, where that is known without reading them.
    pub fn frame_set_count(&self) -> Option<usize> {
        match self {
            Self::Folder(folder) => Some(folder.frame_set_count()),
            Self::Mcap(file) => file.frame_set_count(),
            Self::Bag(_) => None,
        }
    }

    /// The size of a folder's first image of a sensor; `None` for files, whose frames state theirs.
    pub fn image_size(&self, sensor: SensorKind) -> Option<ImageSize> {
        match self {
            Self::Folder(folder) => folder.image_size(sensor),
            Self::Mcap(_) | Self::Bag(_) => None,
        }
    }

    /// What the recorded device stated of its own sensors.
    pub fn factory(&self) -> FactoryCalibration {
        match self {
            Self::Bag(bag) => bag.factory().clone(),
            Self::Mcap(file) => file.factory(),
            Self::Folder(_) => FactoryCalibration::default(),
        }
    }
}

/// Whether `path` is a recording by its name: an MCAP file or a bag's file.
pub fn is_recording_file(path: &Path) -> bool {
    bag::is_bag_file(path)
}

/// Whether the folder at `path` holds a bag, and no images of which it would be a folder.
pub fn is_bag_folder(path: &Path) -> bool {
    path.is_dir() && bag::holds_bag(path) && !folder::holds_images(path)
}

/// Whether `path` is a bag of ROS; an MCAP file is one by the messages in it.
fn is_bag(path: &Path) -> Result<bool, RecordingError> {
    let is_mcap = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap"));
    if is_mcap && path.is_file() {
        return bag::mcap_has_ros_images(path);
    }
    Ok(is_bag_folder(path) || path.is_file() && bag::is_bag_file(path))
}
