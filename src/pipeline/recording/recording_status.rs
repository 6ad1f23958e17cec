//! The state of a recording, as the daemon reports it.

use std::path::PathBuf;

/// Whether a recording goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingState {
    /// It goes on.
    Recording,
    /// It was stopped, or reached a limit; the file is complete.
    Finished,
    /// It could not be written any further; what was written stays readable.
    Failed,
}

/// A recording as seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingStatus {
    /// Ids sort by time.
    pub id: String,
    /// The camera's name.
    pub camera: String,
    /// The file.
    pub path: PathBuf,
    /// Whether it goes on.
    pub state: RecordingState,
    /// Which limit ended it, or why it failed.
    pub reason: Option<String>,
    /// UTC, nanoseconds since the Unix epoch.
    pub started_at_ns: i64,
    /// When it ended, in the same unit.
    pub finished_at_ns: Option<i64>,
    /// Frame sets written.
    pub frame_sets: u64,
    /// Frame sets dropped because the disk was too slow.
    pub dropped: u64,
    /// The size of the file, in bytes.
    pub bytes: u64,
}
