//! Frames on disk: MCAP files and folders of images. Uses geometry and imaging.
//!
//! [`Recording::open`] tells the two apart; reading goes frame set by frame set, with a bounded
//! amount in memory. A damaged picture is a frame that fails when it is decoded; a recording that
//! was cut off gives all that can be read before its error.

mod folder;
mod mcap_reader;
mod mcap_writer;
mod messages;
mod natural_order;
mod records;

use std::path::{Path, PathBuf};

pub use folder::Folder;
pub use mcap_reader::{McapReader, metadata};
pub use mcap_writer::McapWriter;
pub use natural_order::natural_order;

use crate::imaging::frame::FrameSet;

/// A recording that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Nothing is there.
    #[error("{}: there is no such file or folder: check the path", path.display())]
    Missing {
        /// What was asked for.
        path: PathBuf,
    },
    /// A folder with nothing that is named like a picture.
    #[error(
        "{}: no pictures in this folder: it needs .jpg, .png or .pgm files, or the subfolders color/, infrared/, infrared2/, depth/ with such files",
        path.display()
    )]
    NoPictures {
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
    /// An MCAP file that ends too early.
    #[error(
        "{}: the recording was cut off: {frame_sets} whole frames could be read, what follows is lost; copy it again, or go on with these",
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
    /// An MCAP file without images of a camera.
    #[error(
        "{}: no frames in this recording: it needs Foxglove images on topics like /front/color, /front/infrared or /front/depth",
        path.display()
    )]
    NoFrames {
        /// The file.
        path: PathBuf,
    },
    /// An MCAP file of more than one camera.
    #[error(
        "{}: holds several cameras ({} and {}): record each into a file of its own",
        path.display(), cameras[0], cameras[1]
    )]
    SeveralCameras {
        /// The file.
        path: PathBuf,
        /// Two of them.
        cameras: [String; 2],
    },
    /// A file that is no recording.
    #[error("{}: not a recording: give an .mcap file or a folder of images", path.display())]
    NotARecording {
        /// The file.
        path: PathBuf,
    },
}

/// A recording being read.
#[derive(Debug)]
pub enum Recording {
    /// Pictures in a folder.
    Folder(Folder),
    /// An MCAP file.
    Mcap(Box<McapReader>),
}

impl Recording {
    /// Opens the folder or MCAP file at `path`. Frames of a folder, which tells no times, are `fps`
    /// a second.
    ///
    /// # Errors
    /// [`RecordingError`] when it isn't there or is no recording.
    pub fn open(path: &Path, fps: f64) -> Result<Self, RecordingError> {
        if !path.exists() {
            return Err(RecordingError::Missing { path: path.to_owned() });
        }
        if path.is_dir() {
            return Ok(Self::Folder(Folder::open(path, fps)?));
        }
        Ok(Self::Mcap(Box::new(McapReader::open(path)?)))
    }

    /// The next frames taken together; `None` after the last.
    ///
    /// # Errors
    /// [`RecordingError`] where reading fails; every frame set before has been given by then.
    pub fn next_frame_set(&mut self) -> Result<Option<FrameSet>, RecordingError> {
        match self {
            Self::Folder(folder) => folder.next_frame_set(),
            Self::Mcap(file) => file.next_frame_set(),
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
        }
    }

    /// How many frame sets there are, where that is known without reading them.
    pub fn frame_set_count(&self) -> Option<usize> {
        match self {
            Self::Folder(folder) => Some(folder.frame_set_count()),
            Self::Mcap(file) => file.frame_set_count(),
        }
    }
}
