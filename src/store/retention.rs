//! Deletes old sessions, but never approved calibrations and the sessions that they came from.

use rusqlite::{OptionalExtension, Transaction, params};

use crate::calibration::session_record::SessionState;
use crate::store::database::Store;
use crate::store::error::StoreError;

/// How many of the finished sessions are kept; no limit unless given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Retention {
    /// Sessions that began longer ago are deleted, in days.
    pub days: Option<u32>,
    /// This many of the newest are kept.
    pub sessions: Option<u32>,
    /// The oldest are deleted until the database is no larger than this, in millions of bytes.
    pub megabytes: Option<u32>,
}

/// What was deleted by pruning.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Pruned {
    /// The sessions, oldest first.
    pub sessions: Vec<String>,
    /// Their size, in bytes; the database reuses the space.
    pub bytes: u64,
}

const DAY_NS: i64 = 86_400 * 1_000_000_000;

/// Sessions that are over and led to no calibration that was ever approved, newest first.
const PRUNABLE: &str = "SELECT id, started_at_ns FROM sessions
    WHERE state NOT IN (?1, ?2) AND id NOT IN (
        SELECT session FROM calibrations JOIN approvals ON approvals.calibration = calibrations.id
        WHERE session IS NOT NULL)
    ORDER BY started_at_ns DESC, id DESC";

impl Store {
    /// Deletes a finished session with its views and images; the calibrations that resulted from it
    /// stay.
    ///
    /// # Errors
    /// [`StoreError::Missing`]; [`StoreError::Held`] for one that is still running, or from which
    /// an approved calibration came; [`StoreError::Failed`].
    pub fn delete_session(&self, id: &str) -> Result<(), StoreError> {
        let row = || format!("session {id}");
        let state = "SELECT state FROM sessions WHERE id = ?1";
        let state: Option<String> = {
            let connection = self.connection();
            let found = connection.query_row(state, [id], |row| row.get(0)).optional();
            found.map_err(|e| self.failed(&e))?
        };
        let Some(state) = state else { return Err(StoreError::Missing { row: row() }) };
        if SessionState::from_name(&state).is_some_and(|state| !state.is_over()) {
            return Err(StoreError::Held {
                row: row(),
                reason: "it has not ended; stop it first".to_owned(),
            });
        }
        if !self.prunable()?.iter().any(|(prunable, _)| prunable == id) {
            let reason = "an approved calibration was made from it".to_owned();
            return Err(StoreError::Held { row: row(), reason });
        }
        self.changed(|transaction| delete(transaction, id)).map(drop)
    }

    /// Deletes a calibration that was never approved.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Held`] for one that was approved,
    /// [`StoreError::Failed`].
    pub fn delete_calibration(&self, id: &str) -> Result<(), StoreError> {
        let row = || format!("calibration {id}");
        let deleted = self.changed(|transaction| {
            let approved = "SELECT count(*) FROM approvals WHERE calibration = ?1";
            if transaction.query_row(approved, [id], |row| row.get::<_, i64>(0))? > 0 {
                return Ok(None);
            }
            transaction.execute("DELETE FROM calibrations WHERE id = ?1", [id]).map(Some)
        })?;
        match deleted {
            None => Err(StoreError::Held {
                row: row(),
                reason: "it was approved, and approved calibrations are never deleted".to_owned(),
            }),
            Some(0) => Err(StoreError::Missing { row: row() }),
            Some(_) => Ok(()),
        }
    }

    /// Deletes the sessions that `retention` does not keep, oldest first, with their views and
    /// images. With `only_list` they are listed and stay.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn prune(
        &self,
        retention: &Retention,
        now_ns: i64,
        only_list: bool,
    ) -> Result<Pruned, StoreError> {
        let prunable = self.prunable()?;
        let kept = retention.sessions.map_or(usize::MAX, |sessions| sessions as usize);
        let oldest_ns = retention
            .days
            .map(|days| now_ns.saturating_sub(i64::from(days).saturating_mul(DAY_NS)));
        let most = retention.megabytes.map_or(u64::MAX, |most| u64::from(most) * 1_000_000);
        let mut used = self.used_bytes()?;
        let mut pruned = Pruned::default();
        for (place, (id, started_at_ns)) in prunable.iter().enumerate().rev() {
            let is_old = oldest_ns.is_some_and(|oldest_ns| *started_at_ns < oldest_ns);
            if !is_old && place < kept && used <= most {
                continue;
            }
            let bytes = self.session_bytes(id)?;
            if !only_list {
                self.changed(|transaction| delete(transaction, id))?;
            }
            used = used.saturating_sub(bytes);
            pruned.bytes += bytes;
            pruned.sessions.push(id.clone());
        }
        Ok(pruned)
    }

    /// Returns the space of deleted rows to the disk.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn compact(&self) -> Result<(), StoreError> {
        self.connection().execute_batch("VACUUM").map_err(|e| self.failed(&e))
    }

    fn prunable(&self) -> Result<Vec<(String, i64)>, StoreError> {
        let running = [SessionState::Collecting, SessionState::Solving].map(SessionState::name);
        let rows = self.select("sessions", PRUNABLE, &[&running[0], &running[1]], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })?;
        Ok(self.readable(rows.into_iter()))
    }

    /// The size of the rows, in bytes: the file without its free pages.
    fn used_bytes(&self) -> Result<u64, StoreError> {
        let connection = self.connection();
        let number = |name: &str| {
            let number: Result<i64, _> =
                connection.pragma_query_value(None, name, |row| row.get(0));
            number.map(i64::unsigned_abs).map_err(|e| self.failed(&e))
        };
        let pages = number("page_count")?.saturating_sub(number("freelist_count")?);
        Ok(pages * number("page_size")?)
    }

    fn session_bytes(&self, id: &str) -> Result<u64, StoreError> {
        let sql = "SELECT coalesce(sum(length(picture) + coalesce(length(detection), 0)), 0)
            FROM views WHERE session = ?1";
        let connection = self.connection();
        let bytes: Result<i64, _> = connection.query_row(sql, [id], |row| row.get(0));
        bytes.map(i64::unsigned_abs).map_err(|e| self.failed(&e))
    }

    /// Changes the database in one transaction: completely or not at all.
    fn changed<T>(
        &self,
        change: impl Fn(&Transaction<'_>) -> Result<T, rusqlite::Error>,
    ) -> Result<T, StoreError> {
        let mut connection = self.connection();
        let mut write = || {
            let transaction = connection.transaction()?;
            let changed = change(&transaction)?;
            transaction.commit()?;
            Ok(changed)
        };
        write().map_err(|e| self.failed(&e))
    }
}

fn delete(transaction: &Transaction<'_>, id: &str) -> Result<usize, rusqlite::Error> {
    transaction.execute("DELETE FROM views WHERE session = ?1", params![id])?;
    transaction.execute("DELETE FROM sessions WHERE id = ?1", params![id])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::result::Calibration;
    use crate::calibration::session_record::SessionRecord;
    use crate::store::example_tests::{calibration, keep, record, view, views};

    /// Ten sessions on ten days, `s0` the oldest; a calibration of `s1` was approved, `s9` runs.
    fn filled(folder: &std::path::Path) -> Store {
        let store = Store::open(folder).unwrap();
        for number in 0..10 {
            let state = match number {
                9 => SessionState::Collecting,
                _ => SessionState::Finished,
            };
            let id = format!("s{number}");
            let started_at_ns = number * DAY_NS;
            let session = SessionRecord { state, started_at_ns, ..record(&id) };
            store.begin_session(&session).unwrap();
            keep(&store, &id, &view(0), "image/jpeg", &[3; 200_000]).unwrap();
            store.save_session(&session).unwrap();
        }
        for (id, session) in [("c1", "s1"), ("c2", "s2")] {
            let session = Some(session.to_owned());
            store.append_calibration(&Calibration { session, ..calibration(id, 1) }).unwrap();
        }
        store.set_current("front", "c1").unwrap();
        store
    }

    fn left(store: &Store) -> Vec<String> {
        store.sessions().unwrap().into_iter().rev().map(|session| session.id).collect()
    }

    #[test]
    fn each_limit_prunes_the_oldest_and_never_the_evidence() {
        let table: [(Retention, &[&str]); 4] = [
            (Retention::default(), &[]),
            (Retention { days: Some(6), ..Retention::default() }, &["s0", "s2"]),
            (
                Retention { sessions: Some(3), ..Retention::default() },
                &["s0", "s2", "s3", "s4", "s5"],
            ),
            (
                Retention { megabytes: Some(1), ..Retention::default() },
                &["s0", "s2", "s3", "s4", "s5", "s6"],
            ),
        ];
        for (retention, expected) in table {
            let folder = tempfile::tempdir().unwrap();
            let store = filled(folder.path());
            let all = left(&store);
            let listed = store.prune(&retention, 9 * DAY_NS, true).unwrap();
            assert_eq!(
                (listed.sessions.as_slice(), left(&store)),
                (&*expected.iter().map(|id| (*id).to_owned()).collect::<Vec<_>>(), all.clone()),
                "{retention:?}"
            );
            assert_eq!(store.prune(&retention, 9 * DAY_NS, false).unwrap(), listed);
            let kept: Vec<String> =
                all.into_iter().filter(|id| !listed.sessions.contains(id)).collect();
            assert_eq!(left(&store), kept);
            assert_eq!(views(&store, "s1"), [view(0)]);
            for id in &listed.sessions {
                assert_eq!(store.picture(id, 0).unwrap(), None);
            }
            store.compact().unwrap();
        }
    }

    #[test]
    fn what_runs_or_is_evidence_is_not_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let store = filled(folder.path());
        let refusal = |error: StoreError| error.to_string();
        assert_eq!(
            refusal(store.delete_session("s9").unwrap_err()),
            "store: session s9 cannot be deleted: it has not ended; stop it first"
        );
        assert_eq!(
            refusal(store.delete_session("s1").unwrap_err()),
            "store: session s1 cannot be deleted: an approved calibration was made from it"
        );
        assert_eq!(
            refusal(store.delete_session("s77").unwrap_err()),
            "store: there is no session s77; see GET /v1/sessions and GET /v1/cameras/CAMERA/calibrations for those there are"
        );
        store.delete_session("s2").unwrap();
        assert_eq!(store.session("s2").unwrap(), None);
        assert!(store.calibration("c2").unwrap().is_some());
        assert!(matches!(store.delete_calibration("c1"), Err(StoreError::Held { .. })));
        assert!(matches!(store.delete_calibration("c7"), Err(StoreError::Missing { .. })));
        store.delete_calibration("c2").unwrap();
        assert_eq!(store.calibration("c2").unwrap(), None);
    }
}
