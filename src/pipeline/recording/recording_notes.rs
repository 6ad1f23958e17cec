//! The note beside each recording, from which a daemon that was killed knows after its restart
//! which recordings are on disk.

use std::path::{Path, PathBuf};

use crate::document::reading::{from_json, to_json};
use crate::document::recording::{RecordingDocument, RecordingStateName};
use crate::document::time;
use crate::pipeline::recording::recording_status::{RecordingState, RecordingStatus};

const ENDED_WITHOUT: &str = "the daemon ended while it was written; what was written can be read, and `plumb record --repair FILE` gives it its index";

/// The document of a recording.
pub fn recording_document(status: &RecordingStatus) -> RecordingDocument {
    RecordingDocument {
        id: status.id.clone(),
        camera: status.camera.clone(),
        path: status.path.display().to_string(),
        state: match status.state {
            RecordingState::Recording => RecordingStateName::Recording,
            RecordingState::Finished => RecordingStateName::Finished,
            RecordingState::Failed => RecordingStateName::Failed,
        },
        reason: status.reason.clone(),
        started_at: time::from_utc_ns(status.started_at_ns),
        finished_at: status.finished_at_ns.map(time::from_utc_ns),
        frame_sets: status.frame_sets,
        dropped: status.dropped,
        bytes: status.bytes,
    }
}

/// Writes a recording's present status in place of its previous note.
///
/// # Errors
/// What the system refuses.
pub(in crate::pipeline) fn write(status: &RecordingStatus) -> Result<(), std::io::Error> {
    let json = to_json(&recording_document(status)).map_err(std::io::Error::other)?;
    let file = note_of(&status.path);
    let made = file.with_extension("json-new");
    std::fs::write(&made, json)?;
    std::fs::rename(made, file)
}

/// The recordings in `folder` that have a note, newest first. One whose note says that it is being
/// recorded has failed, unless `is_running`.
pub(in crate::pipeline) fn read_all(
    folder: &Path,
    is_running: impl Fn(&str) -> bool,
) -> Vec<RecordingStatus> {
    let Ok(files) = std::fs::read_dir(folder) else { return Vec::new() };
    let paths = files.filter_map(|file| Some(file.ok()?.path()));
    let notes = paths.filter(|path| path.extension().is_some_and(|ends| ends == "json"));
    let mut found: Vec<RecordingStatus> =
        notes.filter_map(|note| read(&note)).filter(|status| !is_running(&status.id)).collect();
    found.sort_by(|a, b| b.id.cmp(&a.id));
    found
}

/// Deletes a recording and its note.
///
/// # Errors
/// What the system refuses; a file that is not there is no error.
pub(in crate::pipeline) fn delete(status: &RecordingStatus) -> Result<(), std::io::Error> {
    for file in [status.path.clone(), note_of(&status.path)] {
        match std::fs::remove_file(file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

fn note_of(recording: &Path) -> PathBuf {
    recording.with_extension("json")
}

/// `None` for a note that cannot be read, and for one whose recording is gone.
fn read(note: &Path) -> Option<RecordingStatus> {
    let document: RecordingDocument = from_json(&std::fs::read(note).ok()?).ok()?;
    // The folder may have been moved since the note was written.
    let path = note.with_extension("mcap");
    let bytes = std::fs::metadata(&path).ok()?.len();
    let (state, reason) = match document.state {
        RecordingStateName::Recording => (RecordingState::Failed, Some(ENDED_WITHOUT.to_owned())),
        RecordingStateName::Finished => (RecordingState::Finished, document.reason),
        RecordingStateName::Failed => (RecordingState::Failed, document.reason),
    };
    Some(RecordingStatus {
        id: document.id,
        camera: document.camera,
        path,
        state,
        reason,
        started_at_ns: time::utc_ns(document.started_at),
        finished_at_ns: document.finished_at.map(time::utc_ns),
        frame_sets: document.frame_sets,
        dropped: document.dropped,
        bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(folder: &Path, id: &str, state: RecordingState) -> RecordingStatus {
        let path = folder.join(format!("{id}.mcap"));
        std::fs::write(&path, b"1234567").unwrap();
        RecordingStatus {
            id: id.to_owned(),
            camera: "front".to_owned(),
            path,
            state,
            reason: None,
            started_at_ns: 1_770_000_000_000_000_000,
            finished_at_ns: Some(1_770_000_005_000_000_000),
            frame_sets: 5,
            dropped: 1,
            bytes: 7,
        }
    }

    #[test]
    fn what_lies_on_disk_is_known_after_a_restart_and_can_be_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let finished = status(folder.path(), "01A", RecordingState::Finished);
        let killed = status(folder.path(), "01B", RecordingState::Recording);
        let running = status(folder.path(), "01C", RecordingState::Recording);
        for status in [&finished, &killed, &running] {
            write(status).unwrap();
        }
        std::fs::write(folder.path().join("01D.json"), "{").unwrap();
        let found = read_all(folder.path(), |id| id == "01C");
        let reason = Some(ENDED_WITHOUT.to_owned());
        let failed = RecordingStatus { state: RecordingState::Failed, reason, ..killed };
        assert_eq!(found, [failed.clone(), finished.clone()]);
        delete(&failed).unwrap();
        delete(&failed).unwrap();
        assert_eq!(read_all(folder.path(), |id| id == "01C"), [finished]);
        assert_eq!(read_all(&folder.path().join("none"), |_| false), []);
    }
}
