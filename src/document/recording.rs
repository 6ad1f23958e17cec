//! A recording that the daemon writes.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::error::DocumentError;

/// The request to start a recording. Without limits it runs until it is stopped.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordDocument {
    /// Stop after this many seconds of frames.
    #[schema(exclusive_minimum = 0.0)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_seconds: Option<f64>,
    /// Stop when the file reaches this size, in bytes.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_992_u64)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_bytes: Option<u64>,
}

impl RecordDocument {
    /// Refuses an invalid limit.
    ///
    /// # Errors
    /// [`DocumentError::Field`] naming the field.
    pub fn check(&self) -> Result<(), DocumentError> {
        const MOST_BYTES: u64 = 1 << 53;
        if let Some(bytes) = self.max_bytes.filter(|bytes| !(1..=MOST_BYTES).contains(bytes)) {
            let problem = format!("{bytes} is no size; give 1 to {MOST_BYTES}");
            return Err(DocumentError::field("max_bytes", problem));
        }
        match self.max_seconds.filter(|seconds| seconds.is_nan() || *seconds <= 0.0) {
            Some(seconds) => Err(DocumentError::field(
                "max_seconds",
                format!("{seconds} is no time; give a positive number"),
            )),
            None => Ok(()),
        }
    }
}

/// Whether a recording goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingStateName {
    /// Recording is in progress.
    Recording,
    /// It was stopped, or reached a limit; the file is whole.
    Finished,
    /// It could not be written any further; what was written stays readable.
    Failed,
}

/// A recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RecordingDocument {
    /// Sortable by time.
    pub id: String,
    /// The camera's name.
    pub camera: String,
    /// The file, on the daemon's machine.
    pub path: String,
    /// State of the recording.
    pub state: RecordingStateName,
    /// Which limit ended it, or why it failed.
    pub reason: Option<String>,
    /// When it was started.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: jiff::Timestamp,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<jiff::Timestamp>,
    /// Frame sets written.
    pub frame_sets: u64,
    /// Frame sets dropped because the disk was too slow.
    pub dropped: u64,
    /// The size of the file, in bytes.
    pub bytes: u64,
}

/// The recordings that lie on disk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RecordingsDocument {
    /// The newest of each camera in the order of the configuration, then the others, newest first.
    pub recordings: Vec<RecordingDocument>,
}
