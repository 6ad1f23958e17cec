//! The table of sessions.

use rusqlite::{OptionalExtension, Row, params};

use crate::calibration::session_record::{SessionRecord, SessionState};
use crate::calibration::view::View;
use crate::document::session::SessionDocument;
use crate::store::error::StoreError;
use crate::store::{Store, json};

const COLUMNS: &str = "SELECT id, collecting_s, document FROM sessions";

impl Store {
    /// Writes a new session down.
    ///
    /// # Errors
    /// [`StoreError::Failed`], also when its id is taken; [`StoreError::Unstorable`].
    pub fn begin_session(&self, record: &SessionRecord) -> Result<(), StoreError> {
        let row = params![
            record.id,
            record.camera,
            record.state.name(),
            record.started_at_ns,
            record.collecting_s,
            document(record)?
        ];
        let sql = "INSERT INTO sessions (id, camera, state, started_at_ns, collecting_s, document)
            VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
        self.connection().execute(sql, row).map_err(|e| self.failed(&e))?;
        Ok(())
    }

    /// Writes down where a session stands now.
    ///
    /// # Errors
    /// [`StoreError::Missing`] for one that was never begun; [`StoreError::Failed`],
    /// [`StoreError::Unstorable`].
    pub fn save_session(&self, record: &SessionRecord) -> Result<(), StoreError> {
        let row = params![record.id, record.state.name(), record.collecting_s, document(record)?];
        let sql = "UPDATE sessions SET state = ?2, collecting_s = ?3, document = ?4 WHERE id = ?1";
        match self.connection().execute(sql, row).map_err(|e| self.failed(&e))? {
            0 => Err(StoreError::Missing { row: format!("session {}", record.id) }),
            _ => Ok(()),
        }
    }

    /// The session `id`.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn session(&self, id: &str) -> Result<Option<SessionRecord>, StoreError> {
        let found = self
            .connection()
            .query_row(&format!("{COLUMNS} WHERE id = ?1"), [id], StoredSession::from_row)
            .optional()
            .map_err(|e| self.failed(&e))?;
        found.map(StoredSession::into_record).transpose()
    }

    /// Every session, newest first.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn sessions(&self) -> Result<Vec<SessionRecord>, StoreError> {
        self.select_sessions(&format!("{COLUMNS} ORDER BY started_at_ns DESC, id DESC"))
    }

    /// The sessions that were collecting or solving, oldest first, each with its views in order:
    /// what a process that was killed goes on with.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn unfinished_sessions(&self) -> Result<Vec<(SessionRecord, Vec<View>)>, StoreError> {
        let records = self.select_sessions(&format!(
            "{COLUMNS} WHERE state IN ('{}', '{}') ORDER BY started_at_ns, id",
            SessionState::Collecting.name(),
            SessionState::Solving.name()
        ))?;
        let with_views = |record: SessionRecord| Ok((self.views(&record.id)?, record));
        records
            .into_iter()
            .map(with_views)
            .map(|pair| pair.map(|(views, record)| (record, views)))
            .collect()
    }

    fn select_sessions(&self, sql: &str) -> Result<Vec<SessionRecord>, StoreError> {
        let rows = || {
            let connection = self.connection();
            let mut statement = connection.prepare(sql)?;
            let rows = statement.query_map([], StoredSession::from_row)?;
            rows.collect::<Result<Vec<_>, _>>()
        };
        let rows = rows().map_err(|e| self.failed(&e))?;
        rows.into_iter().map(StoredSession::into_record).collect()
    }
}

fn document(record: &SessionRecord) -> Result<String, StoreError> {
    json::write(&SessionDocument::from(record), || format!("session {}", record.id))
}

struct StoredSession {
    id: String,
    collecting_s: f64,
    document: String,
}

impl StoredSession {
    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        Ok(Self { id: row.get(0)?, collecting_s: row.get(1)?, document: row.get(2)? })
    }

    fn into_record(self) -> Result<SessionRecord, StoreError> {
        let row = || format!("session {}", self.id);
        let document: SessionDocument = json::read(&self.document, row)?;
        let record = document.to_record(self.collecting_s);
        record.map_err(|e| StoreError::Unreadable { row: row(), detail: e.to_string() })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::calibration::admission::Rejections;
    use crate::calibration::coverage::Coverage;
    use crate::calibration::guidance::Guidance;
    use crate::calibration::result::ProjectionUncertainty;
    use crate::calibration::session_record::{Finish, RunningEstimate, SessionRequest};
    use crate::document::lens_model::LensRequest;
    use crate::document::reading::from_json;
    use crate::geometry::lens::{Lens, LensModel};
    use crate::geometry::pixel::Pixel;
    use crate::geometry::target::chessboard;

    /// A session in the middle of its work, with every field filled in.
    pub(in crate::store) fn record(id: &str) -> SessionRecord {
        let third = 1.0 / 3.0;
        let lens = Lens::from_parameters(
            LensModel::Radial,
            &[500.0 + third, 501.0, 320.0, 240.0, 0.0, -0.1 * third],
        );
        SessionRecord {
            id: id.into(),
            camera: "front".into(),
            members: Vec::new(),
            request: SessionRequest {
                target: chessboard(9, 6, 0.1 * third).unwrap(),
                lens: from_json::<LensRequest>(b"\"brown\"").unwrap().into(),
                finish: Some(Finish {
                    uncertainty_px: Some(third),
                    min_views: Some(12),
                    max_seconds: None,
                }),
            },
            state: SessionState::Collecting,
            reason: None,
            started_at_ns: 1_770_000_000_123_456_789,
            finished_at_ns: None,
            frames_seen: 100,
            boards_seen: 50,
            views_kept: 1,
            rejected: Rejections::from_counts([("blurred", 3), ("too_similar", 46)]),
            collecting_s: 10.0 * third,
            coverage: Coverage::from_cells(vec![vec![0, 1], vec![2, 3]]).unwrap(),
            guidance: Guidance {
                message: "tilt it".into(),
                outline_px: vec![Pixel::new(third, 2.0 * third)],
            },
            estimate: Some(RunningEstimate {
                lens: lens.unwrap(),
                rms_px: third,
                uncertainty_px: ProjectionUncertainty { center: 0.1, median: third, worst: 1.0 },
                views: 1,
            }),
            calibration: None,
        }
    }

    #[test]
    fn a_session_comes_back_as_it_was_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = record("s1");
        {
            let store = Store::open(folder.path()).unwrap();
            store.begin_session(&session).unwrap();
            session.frames_seen += 1;
            session.reason = Some("waits for the camera".into());
            store.save_session(&session).unwrap();
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.session("s1").unwrap(), Some(session.clone()));
        assert_eq!(store.unfinished_sessions().unwrap(), [(session, vec![])]);
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
        let unfinished =
            store.unfinished_sessions().unwrap().into_iter().map(|(record, _)| record).collect();
        assert_eq!(ids(unfinished), ["collecting", "solving"]);
        assert_eq!(
            ids(store.sessions().unwrap()),
            ["aborted", "failed", "finished", "solving", "collecting"]
        );
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
