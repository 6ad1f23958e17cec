//! Why a recording cannot be read or written, and what to do.

use std::path::{Path, PathBuf};

use crate::imaging::frame::SensorKind;
use crate::recording::records::Broken;

/// A recording that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Nothing is there.
    #[error("{}: there is no such file or folder: check the path", path.display())]
    Missing {
        /// What was asked for.
        path: PathBuf,
    },
    /// A folder with nothing that is named like an image.
    #[error(
        "{}: no images in this folder: it needs .jpg, .png or .pgm files, or the subfolders {} with such files",
        path.display(),
        SensorKind::ALL.map(|sensor| format!("{}/", sensor.name())).join(", ")
    )]
    NoImages {
        /// The folder.
        path: PathBuf,
    },
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Depth without a meaning in a format that has it in meters.
    #[error(
        "{}: its depth is disparity without a known scale, and ROS depth is in meters: record it without --ros2",
        path.display()
    )]
    NoMeters {
        /// The bag that was to be written.
        path: PathBuf,
    },
    /// An MCAP file that ends too early.
    #[error(
        "{}: the recording is truncated: {frame_sets} complete frames were read, the rest is lost; copy it again, or use these",
        path.display()
    )]
    Cut {
        /// The file.
        path: PathBuf,
        /// How many frame sets were read.
        frame_sets: usize,
    },
    /// An MCAP file whose bytes contradict themselves, or that holds images in a form that Plumb
    /// does not read.
    #[error("{}: cannot be read after {frame_sets} frames ({reason}): copy or record it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How many frame sets were read.
        frame_sets: usize,
        /// What was met.
        reason: String,
    },
    /// A file without images of a camera.
    #[error(
        "{}: no frames in this recording: it needs images of ROS (sensor_msgs Image or CompressedImage), or of Foxglove on topics like /front/color",
        path.display()
    )]
    NoFrames {
        /// The file.
        path: PathBuf,
    },
    /// A file of more than one camera.
    #[error(
        "{}: holds several cameras ({} and {}): pick one with --topic, or topic = in a configuration",
        path.display(), cameras[0], cameras[1]
    )]
    SeveralCameras {
        /// The file.
        path: PathBuf,
        /// Topics of two of them.
        cameras: [String; 2],
    },
    /// A topic was asked for that carries no images here.
    #[error("{}: no images on the topic `{topic}`: there are {known}", path.display())]
    NoSuchTopic {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        topic: String,
        /// The topics that carry images.
        known: String,
    },
    /// Images in a form that Plumb does not read.
    #[error("{}: {topic}: {reason}; convert them, or pick another topic", path.display())]
    UnknownImage {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What was met.
        reason: String,
    },
    /// A file that is no recording.
    #[error("{}: not a recording: give an .mcap file, a ROS bag (.db3, .bag) or a folder of images", path.display())]
    NotARecording {
        /// The file.
        path: PathBuf,
    },
}

impl RecordingError {
    /// The same of the file at `path`: of one that was unpacked to another place.
    pub(super) fn of(mut self, at: &Path) -> Self {
        match &mut self {
            Self::Missing { path }
            | Self::NoImages { path }
            | Self::NoMeters { path }
            | Self::Io { path, .. }
            | Self::Cut { path, .. }
            | Self::Damaged { path, .. }
            | Self::NoFrames { path }
            | Self::SeveralCameras { path, .. }
            | Self::NoSuchTopic { path, .. }
            | Self::UnknownImage { path, .. }
            | Self::NotARecording { path } => at.clone_into(path),
        }
        self
    }
}

impl Broken {
    /// As an error of the recording at `path`, of which `frame_sets` have been read.
    pub(super) fn at(self, path: &Path, frame_sets: usize) -> RecordingError {
        let path = path.to_owned();
        match self {
            Self::Cut => RecordingError::Cut { path, frame_sets },
            Self::Damaged(reason) => RecordingError::Damaged { path, frame_sets, reason },
            Self::Io(source) => RecordingError::Io { path, source },
        }
    }
}
