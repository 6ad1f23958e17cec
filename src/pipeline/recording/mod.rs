//! Recordings of running cameras: what writes them, the note beside each, and which are kept.

pub mod recorder;
pub mod recording_notes;
pub mod recording_retention;
mod recording_status;
