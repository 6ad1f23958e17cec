//! Which recordings are kept, and the deletion of the others.

use std::path::{Path, PathBuf};

use crate::pipeline::recording::recording_notes;
use crate::pipeline::recording::recording_status::{RecordingState, RecordingStatus};

/// How much is kept of the recordings that have ended; no limit unless given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RecordingRetention {
    /// Recordings that began longer ago are deleted, in days.
    pub days: Option<u32>,
    /// This many of the newest are kept.
    pub recordings: Option<u32>,
    /// The oldest are deleted until all together hold no more, in millions of bytes.
    pub megabytes: Option<u32>,
}

const DAY_NS: i64 = 86_400 * 1_000_000_000;

impl RecordingRetention {
    /// Those of `recordings` that are not kept, oldest first. One that is still being recorded is
    /// kept, and counts.
    pub(in crate::pipeline) fn not_kept(
        &self,
        recordings: &[RecordingStatus],
        now_ns: i64,
    ) -> Vec<RecordingStatus> {
        let mut newest_first: Vec<&RecordingStatus> = recordings.iter().collect();
        newest_first.sort_by(|a, b| b.started_at_ns.cmp(&a.started_at_ns).then(b.id.cmp(&a.id)));
        let most = self.recordings.map_or(usize::MAX, |most| most as usize);
        let most_bytes = self.megabytes.map_or(u64::MAX, |most| u64::from(most) * 1_000_000);
        let oldest_ns =
            self.days.map(|days| now_ns.saturating_sub(i64::from(days).saturating_mul(DAY_NS)));
        let mut bytes: u64 = recordings.iter().map(|status| status.bytes).sum();
        let mut not_kept = Vec::new();
        for (place, status) in newest_first.into_iter().enumerate().rev() {
            let is_old = oldest_ns.is_some_and(|oldest_ns| status.started_at_ns < oldest_ns);
            let is_over = status.state != RecordingState::Recording;
            if is_over && (is_old || place >= most || bytes > most_bytes) {
                bytes -= status.bytes;
                not_kept.push(status.clone());
            }
        }
        not_kept
    }
}

/// The folder of recordings in a store's folder.
pub fn recordings_folder(store: &Path) -> PathBuf {
    store.join("recordings")
}

/// Deletes the recordings in `folder` that `retention` does not keep, oldest first; with
/// `only_list` they are listed and stay. Only for a store that no daemon has open, where every
/// recording has ended.
///
/// # Errors
/// What the system refuses.
pub fn prune_folder(
    folder: &Path,
    retention: &RecordingRetention,
    now_ns: i64,
    only_list: bool,
) -> Result<Vec<RecordingStatus>, std::io::Error> {
    let not_kept = retention.not_kept(&recording_notes::read_all(folder, |_| false), now_ns);
    if !only_list {
        not_kept.iter().try_for_each(recording_notes::delete)?;
    }
    Ok(not_kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five recordings of a million bytes on five days, the oldest first in name; the newest goes
    /// on.
    fn recordings(folder: &Path) -> Vec<RecordingStatus> {
        let status = |day: i64| RecordingStatus {
            id: format!("r{day}"),
            camera: "front".to_owned(),
            path: folder.join(format!("r{day}.mcap")),
            state: if day == 4 { RecordingState::Recording } else { RecordingState::Finished },
            reason: None,
            started_at_ns: day * DAY_NS,
            finished_at_ns: None,
            frame_sets: 1,
            dropped: 0,
            bytes: 1_000_000,
        };
        (0..5).map(status).collect()
    }

    #[test]
    fn the_oldest_go_by_age_count_and_bytes() {
        let all = recordings(Path::new("recordings"));
        let none = RecordingRetention::default();
        for (retention, expected) in [
            (none, &[][..]),
            (RecordingRetention { days: Some(3), ..none }, &["r0", "r1"]),
            (RecordingRetention { recordings: Some(3), ..none }, &["r0", "r1"]),
            (RecordingRetention { megabytes: Some(4), ..none }, &["r0"]),
            (RecordingRetention { recordings: Some(0), ..none }, &["r0", "r1", "r2", "r3"]),
            (RecordingRetention { megabytes: Some(0), ..none }, &["r0", "r1", "r2", "r3"]),
        ] {
            let not_kept = retention.not_kept(&all, 5 * DAY_NS);
            let ids: Vec<&str> = not_kept.iter().map(|status| status.id.as_str()).collect();
            assert_eq!(ids, expected, "{retention:?}");
        }
    }

    #[test]
    fn a_folder_is_pruned_of_files_and_notes() {
        let folder = tempfile::tempdir().unwrap();
        for status in recordings(folder.path()) {
            std::fs::write(&status.path, b"1234567").unwrap();
            recording_notes::write(&status).unwrap();
        }
        let retention = RecordingRetention { recordings: Some(2), ..RecordingRetention::default() };
        let left = || std::fs::read_dir(folder.path()).unwrap().count();
        let listed = prune_folder(folder.path(), &retention, 0, true).unwrap();
        assert_eq!((listed.len(), left()), (3, 10));
        let pruned = prune_folder(folder.path(), &retention, 0, false).unwrap();
        assert_eq!((pruned, left()), (listed, 4));
    }
}
