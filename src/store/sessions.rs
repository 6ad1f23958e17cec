//! The table of sessions.

use rusqlite::{Connection, Row, ToSql, params};

use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::document::session::SessionDocument;
use crate::store::database::Store;
use crate::store::error::StoreError;
use crate::store::{checksum, json};

const COLUMNS: &str =
    "SELECT id, camera, state, started_at_ns, collecting_s, document, checksum FROM sessions";
/// Whether ?1 is a camera in the session's rig; NULL for a damaged document, where it is unknown.
const OF_MEMBER: &str = "CASE WHEN json_valid(document) THEN EXISTS (
    SELECT 1 FROM json_each(document, '$.cameras') AS member
    WHERE member.value ->> '$.camera' = ?1) END";

impl Store {
    /// Stores a new session.
    ///
    /// # Errors
    /// [`StoreError::NoRoom`]; [`StoreError::Failed`], also when its id is taken;
    /// [`StoreError::Unstorable`].
    pub fn begin_session(&self, record: &SessionRecord) -> Result<(), StoreError> {
        self.has_room(0)?;
        let document = document(record)?;
        let row = params![
            record.id,
            record.camera,
            record.state.name(),
            record.started_at_ns,
            record.collecting_s,
            document,
            checksum_of(record, &document)
        ];
        let sql = "INSERT INTO sessions (id, camera, state, started_at_ns, collecting_s, document, checksum)
            VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)";
        self.connection().execute(sql, row).map_err(|e| self.failed(&e))?;
        Ok(())
    }

    /// Stores the present state of a session.
    ///
    /// # Errors
    /// [`StoreError::Missing`] for one that was never begun; [`StoreError::Failed`],
    /// [`StoreError::Unstorable`].
    pub fn save_session(&self, record: &SessionRecord) -> Result<(), StoreError> {
        let document = document(record)?;
        let saved = update_session(&self.connection(), record, &document);
        self.saved(record, saved)
    }

    /// Fails if there was no session to update.
    pub(super) fn saved(
        &self,
        record: &SessionRecord,
        updated: Result<usize, rusqlite::Error>,
    ) -> Result<(), StoreError> {
        match updated.map_err(|e| self.failed(&e))? {
            0 => Err(StoreError::Missing { row: format!("session {}", record.id) }),
            _ => Ok(()),
        }
    }

    /// The session `id`.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn session(&self, id: &str) -> Result<Option<SessionRecord>, StoreError> {
        let sql = format!("{COLUMNS} WHERE id = ?1");
        let rows = self.select("sessions", &sql, &[&id], StoredSession::from_row)?;
        rows.into_iter().map(|row| row.and_then(StoredSession::into_record)).next().transpose()
    }

    /// Every session that can be read, newest first; [`Store::unreadable`] has the others.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn sessions(&self) -> Result<Vec<SessionRecord>, StoreError> {
        self.select_sessions(&format!("{COLUMNS} ORDER BY started_at_ns DESC, id DESC"))
    }

    /// A page of the sessions that can be read, newest first: at most `limit` sessions that follow
    /// the session `after`. If `camera` is given, only those for which [`SessionRecord::is_of`]
    /// holds. If there are more, also the last session of the page, from which the next page
    /// follows.
    ///
    /// # Errors
    /// [`StoreError::Failed`]; [`StoreError::Missing`] where there is no session `after`.
    pub fn sessions_page(
        &self,
        camera: Option<&str>,
        after: Option<&str>,
        limit: u32,
    ) -> Result<(Vec<SessionRecord>, Option<String>), StoreError> {
        let start = match after {
            None => (i64::MAX, String::new()),
            Some(id) => {
                let sql = "SELECT started_at_ns, id FROM sessions WHERE id = ?1";
                let rows =
                    self.select("sessions", sql, &[&id], |row| Ok((row.get(0)?, row.get(1)?)))?;
                let missing = || StoreError::Missing { row: format!("session {id}") };
                rows.into_iter().next().ok_or_else(missing)??
            }
        };
        let sql = format!(
            "{COLUMNS} WHERE (?1 IS NULL OR camera = ?1 OR {OF_MEMBER})
            AND (started_at_ns, id) < (?2, ?3) ORDER BY started_at_ns DESC, id DESC LIMIT ?4"
        );
        // One row more than requested shows whether there are more.
        let values: [&dyn ToSql; 4] = [&camera, &start.0, &start.1, &(i64::from(limit) + 1)];
        let mut rows = self.select("sessions", &sql, &values, StoredSession::from_row)?;
        let has_more = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        let last = rows.iter().rev().find_map(|row| Some(row.as_ref().ok()?.id.clone()));
        let records = rows.into_iter().map(|row| row.and_then(StoredSession::into_record));
        Ok((self.readable(records), last.filter(|_| has_more)))
    }

    /// The sessions that were collecting or solving, oldest first: those that are resumed after the
    /// process was killed. One that cannot be read is left as it is and listed by
    /// [`Store::unreadable`].
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn unfinished_sessions(&self) -> Result<Vec<SessionRecord>, StoreError> {
        self.select_sessions(&format!(
            "{COLUMNS} WHERE state IN ('{}', '{}') ORDER BY started_at_ns, id",
            SessionState::Collecting.name(),
            SessionState::Solving.name()
        ))
    }

    fn select_sessions(&self, sql: &str) -> Result<Vec<SessionRecord>, StoreError> {
        let rows = self.select("sessions", sql, &[], StoredSession::from_row)?;
        Ok(self.readable(rows.into_iter().map(|row| row.and_then(StoredSession::into_record))))
    }
}

/// Updates a session's state. Returns how many sessions have its id.
pub(super) fn update_session(
    connection: &Connection,
    record: &SessionRecord,
    document: &str,
) -> Result<usize, rusqlite::Error> {
    let checksum = checksum_of(record, document);
    let row = params![record.id, record.state.name(), record.collecting_s, document, checksum];
    let sql = "UPDATE sessions SET state = ?2, collecting_s = ?3, document = ?4, checksum = ?5
        WHERE id = ?1";
    connection.execute(sql, row)
}

/// A session as the JSON of its column.
pub(super) fn document(record: &SessionRecord) -> Result<String, StoreError> {
    json::write(&SessionDocument::from(record), || format!("session {}", record.id))
}

fn checksum_of(record: &SessionRecord, document: &str) -> u32 {
    let columns = CheckedColumns {
        id: &record.id,
        camera: &record.camera,
        state: record.state.name(),
        started_at_ns: record.started_at_ns,
        collecting_s: record.collecting_s,
        document,
    };
    columns.checksum()
}

/// The columns that the checksum is of.
struct CheckedColumns<'a> {
    id: &'a str,
    camera: &'a str,
    state: &'a str,
    started_at_ns: i64,
    collecting_s: f64,
    document: &'a str,
}

impl CheckedColumns<'_> {
    fn checksum(&self) -> u32 {
        checksum::of_columns(&[
            self.id.as_bytes(),
            self.camera.as_bytes(),
            self.state.as_bytes(),
            &self.started_at_ns.to_le_bytes(),
            &self.collecting_s.to_le_bytes(),
            self.document.as_bytes(),
        ])
    }
}

struct StoredSession {
    id: String,
    camera: String,
    state: String,
    started_at_ns: i64,
    collecting_s: f64,
    document: String,
    checksum: Option<u32>,
}

impl StoredSession {
    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        Ok(Self {
            id: row.get(0)?,
            camera: row.get(1)?,
            state: row.get(2)?,
            started_at_ns: row.get(3)?,
            collecting_s: row.get(4)?,
            document: row.get(5)?,
            checksum: row.get(6)?,
        })
    }

    fn into_record(self) -> Result<SessionRecord, StoreError> {
        let row = || format!("session {}", self.id);
        let columns = CheckedColumns {
            id: &self.id,
            camera: &self.camera,
            state: &self.state,
            started_at_ns: self.started_at_ns,
            collecting_s: self.collecting_s,
            document: &self.document,
        };
        checksum::check(self.checksum, columns.checksum(), row)?;
        let document: SessionDocument = json::read(&self.document, row)?;
        let record = document.to_record(self.collecting_s);
        record.map_err(|e| StoreError::Unreadable { row: row(), detail: e.to_string() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::session_record::SessionMember;
    use crate::store::example_tests::record;

    #[test]
    fn a_session_comes_back_as_it_was_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = record("s1");
        {
            let store = Store::open(folder.path()).unwrap();
            store.begin_session(&session).unwrap();
            session.frames_seen += 1;
            session.reason = Some("waiting for the camera".into());
            store.save_session(&session).unwrap();
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.session("s1").unwrap(), Some(session.clone()));
        assert_eq!(store.unfinished_sessions().unwrap(), [session]);
        assert_eq!(store.session("s2").unwrap(), None);
    }

    #[test]
    fn only_what_is_not_over_is_unfinished_and_the_list_is_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        for (i, state) in SessionState::ALL.into_iter().enumerate() {
            let started_at_ns = i as i64;
            store
                .begin_session(&SessionRecord { state, started_at_ns, ..record(state.name()) })
                .unwrap();
        }
        let ids = |records: Vec<SessionRecord>| {
            records.into_iter().map(|record| record.id).collect::<Vec<_>>()
        };
        assert_eq!(ids(store.unfinished_sessions().unwrap()), ["collecting", "solving"]);
        assert_eq!(
            ids(store.sessions().unwrap()),
            ["aborted", "failed", "finished", "solving", "collecting"]
        );
    }

    #[test]
    fn pages_have_every_session_once_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        for number in 0..23_i64 {
            let id = format!("s{number:02}");
            let camera = if number % 2 == 0 { "front" } else { "back" }.to_owned();
            // Several that began at the same time.
            let started_at_ns = number / 4;
            store.begin_session(&SessionRecord { camera, started_at_ns, ..record(&id) }).unwrap();
        }
        for number in 23..30_i64 {
            let members = ["back", "left"].map(SessionMember::begin).to_vec();
            let (camera, started_at_ns) = ("head".to_owned(), number / 4);
            let of_rig = record(&format!("s{number:02}"));
            store
                .begin_session(&SessionRecord { camera, members, started_at_ns, ..of_rig })
                .unwrap();
        }
        let counts = [
            (None, 30),
            (Some("front"), 12),
            (Some("back"), 11 + 7),
            (Some("left"), 7),
            (Some("head"), 7),
            (Some("none"), 0),
        ];
        for (camera, count) in counts {
            let (mut ids, mut after) = (Vec::new(), None);
            loop {
                let (page, last) = store.sessions_page(camera, after.as_deref(), 5).unwrap();
                assert!(page.len() == 5 || last.is_none());
                ids.extend(page.into_iter().map(|session| session.id));
                after = last;
                if after.is_none() {
                    break;
                }
                assert_eq!(after.as_ref(), ids.last());
            }
            let all = store.sessions().unwrap();
            let of_camera =
                all.into_iter().filter(|session| camera.is_none_or(|name| session.is_of(name)));
            assert_eq!(ids, of_camera.map(|session| session.id).collect::<Vec<_>>());
            assert_eq!(ids.len(), count);
        }
        assert!(matches!(
            store.sessions_page(None, Some("s99"), 5),
            Err(StoreError::Missing { .. })
        ));
    }

    #[test]
    fn what_was_never_begun_cannot_be_saved_nor_begun_twice() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        assert!(matches!(store.save_session(&record("s1")), Err(StoreError::Missing { .. })));
        store.begin_session(&record("s1")).unwrap();
        assert!(matches!(store.begin_session(&record("s1")), Err(StoreError::Failed { .. })));
    }

    #[test]
    fn an_estimate_that_is_no_number_does_not_cost_the_session() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let mut session = record("s1");
        session.estimate.as_mut().unwrap().uncertainty_px.worst = f64::INFINITY;
        store.begin_session(&session).unwrap();
        assert_eq!(store.session("s1").unwrap(), Some(session.clone()));
        session.estimate.as_mut().unwrap().rms_px = f64::NAN;
        store.save_session(&session).unwrap();
        session.estimate = None;
        assert_eq!(store.session("s1").unwrap(), Some(session));
    }
}
