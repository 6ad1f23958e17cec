//! The tables of calibrations and of the current ones.

use rusqlite::{Connection, OptionalExtension, Row, ToSql, params};

use crate::calibration::result::Calibration;
use crate::calibration::session_record::SessionRecord;
use crate::document::calibration::CalibrationDocument;
use crate::store::database::Store;
use crate::store::error::StoreError;
use crate::store::{checksum, json, sessions};

const COLUMNS: &str =
    "SELECT id, camera, session, created_at_ns, document, checksum FROM calibrations";

impl Store {
    /// Stores a new calibration; it never changes after that.
    ///
    /// # Errors
    /// [`StoreError::Failed`], also when its id is taken; [`StoreError::Unstorable`] for one that
    /// contains NaN or infinity.
    pub fn append_calibration(&self, calibration: &Calibration) -> Result<(), StoreError> {
        let document = column(calibration)?;
        insert(&self.connection(), calibration, &document).map_err(|e| self.failed(&e))
    }

    /// Stores how a session ended, the calibration that resulted, and, with `make_current`, that it
    /// is now the camera's current one: all or nothing.
    ///
    /// # Errors
    /// As [`Store::append_calibration`] and [`Store::save_session`].
    pub fn finish_session(
        &self,
        record: &SessionRecord,
        calibration: &Calibration,
        make_current: bool,
    ) -> Result<(), StoreError> {
        let (document, session) = (column(calibration)?, sessions::document(record)?);
        let mut connection = self.connection();
        let mut write = || {
            let transaction = connection.transaction()?;
            insert(&transaction, calibration, &document)?;
            if make_current {
                approve(&transaction, &record.camera, &calibration.id)?;
            }
            let updated = sessions::update_session(&transaction, record, &session)?;
            if updated > 0 {
                transaction.commit()?;
            }
            Ok(updated)
        };
        self.saved(record, write())
    }

    /// The calibration `id`.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn calibration(&self, id: &str) -> Result<Option<Calibration>, StoreError> {
        let found = self.select_calibrations(&format!("{COLUMNS} WHERE id = ?1"), &[&id])?;
        found.into_iter().next().transpose()
    }

    /// Every calibration of a camera that can be read, newest first; the others are listed by
    /// [`Store::unreadable`].
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn calibrations(&self, camera: &str) -> Result<Vec<Calibration>, StoreError> {
        Ok(self.calibrations_page(camera, None, None)?.0)
    }

    /// A page of a camera's calibrations that can be read, newest first: at most `limit` that
    /// follow the calibration `after`, or all without a limit. If there are more, also the last one
    /// of the page, from which the next page follows.
    ///
    /// # Errors
    /// [`StoreError::Failed`]; [`StoreError::Missing`] where the camera has no calibration `after`.
    pub fn calibrations_page(
        &self,
        camera: &str,
        after: Option<&str>,
        limit: Option<u32>,
    ) -> Result<(Vec<Calibration>, Option<String>), StoreError> {
        let start: (i64, String) = match after {
            None => (i64::MAX, String::new()),
            Some(id) => {
                let sql =
                    "SELECT created_at_ns, id FROM calibrations WHERE id = ?1 AND camera = ?2";
                let place = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?));
                let rows = self.select("calibrations", sql, &[&id, &camera], place)?;
                let missing =
                    || StoreError::Missing { row: format!("{} of {camera}", row_name(id)) };
                rows.into_iter().next().ok_or_else(missing)??
            }
        };
        let sql = format!(
            "{COLUMNS} WHERE camera = ?1 AND (created_at_ns, id) < (?2, ?3)
            ORDER BY created_at_ns DESC, id DESC LIMIT ?4"
        );
        // One row more than requested shows whether there are more; for SQLite, -1 means no limit.
        let most = limit.map_or(-1, |limit| i64::from(limit) + 1);
        let values: [&dyn ToSql; 4] = [&camera, &start.0, &start.1, &most];
        let mut rows = self.select("calibrations", &sql, &values, StoredCalibration::from_row)?;
        let limit = limit.map_or(usize::MAX, |limit| limit as usize);
        let has_more = rows.len() > limit;
        rows.truncate(limit);
        let last = rows.iter().rev().find_map(|row| Some(row.as_ref().ok()?.id.clone()));
        let calibrations = rows.into_iter().map(|row| row.and_then(|row| row.to_calibration()));
        Ok((self.readable(calibrations), last.filter(|_| has_more)))
    }

    /// Every calibration that can be read, of any camera, newest first.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub(super) fn every_calibration(&self) -> Result<Vec<Calibration>, StoreError> {
        let sql = format!("{COLUMNS} ORDER BY created_at_ns DESC, id DESC");
        Ok(self.readable(self.select_calibrations(&sql, &[])?.into_iter()))
    }

    /// Makes a calibration the current one of a camera.
    ///
    /// # Errors
    /// [`StoreError::Missing`] for a calibration that is not there; [`StoreError::Failed`].
    pub fn set_current(&self, camera: &str, calibration_id: &str) -> Result<(), StoreError> {
        if self.calibration(calibration_id)?.is_none() {
            return Err(StoreError::Missing { row: row_name(calibration_id) });
        }
        let mut connection = self.connection();
        let mut write = || {
            let transaction = connection.transaction()?;
            approve(&transaction, camera, calibration_id)?;
            transaction.commit()
        };
        write().map_err(|e| self.failed(&e))
    }

    /// Whether calibration `id` is stored, readable or not.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn has_calibration(&self, id: &str) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM calibrations WHERE id = ?1)";
        self.connection().query_row(sql, [id], |row| row.get(0)).map_err(|e| self.failed(&e))
    }

    /// The id of the current calibration of a camera.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn current_calibration_id(&self, camera: &str) -> Result<Option<String>, StoreError> {
        let sql = "SELECT calibration FROM current_calibrations WHERE camera = ?1";
        self.connection()
            .query_row(sql, [camera], |row| row.get(0))
            .optional()
            .map_err(|e| self.failed(&e))
    }

    fn select_calibrations(
        &self,
        sql: &str,
        values: &[&dyn ToSql],
    ) -> Result<Vec<Result<Calibration, StoreError>>, StoreError> {
        let rows = self.select("calibrations", sql, values, StoredCalibration::from_row)?;
        Ok(rows.into_iter().map(|row| row.and_then(|row| row.to_calibration())).collect())
    }
}

fn column(calibration: &Calibration) -> Result<String, StoreError> {
    json::write(&CalibrationDocument::from(calibration), || row_name(&calibration.id))
}

fn insert(
    connection: &Connection,
    calibration: &Calibration,
    document: &str,
) -> Result<(), rusqlite::Error> {
    let row = params![
        calibration.id,
        calibration.camera,
        calibration.session,
        calibration.created_at_ns,
        document,
        checksum_of(
            [Some(&calibration.id), calibration.camera.as_ref(), calibration.session.as_ref()],
            calibration.created_at_ns,
            document
        )
    ];
    let sql = "INSERT INTO calibrations (id, camera, session, created_at_ns, document, checksum)
        VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
    connection.execute(sql, row).map(drop)
}

fn approve(
    connection: &Connection,
    camera: &str,
    calibration_id: &str,
) -> Result<(), rusqlite::Error> {
    let current = "INSERT INTO current_calibrations (camera, calibration) VALUES (?1, ?2)
        ON CONFLICT (camera) DO UPDATE SET calibration = excluded.calibration";
    connection.execute(current, params![camera, calibration_id])?;
    let approved = "INSERT OR IGNORE INTO approvals (calibration) VALUES (?1)";
    connection.execute(approved, params![calibration_id]).map(drop)
}

fn row_name(id: &str) -> String {
    format!("calibration {id}")
}

fn checksum_of(names: [Option<&String>; 3], created_at_ns: i64, document: &str) -> u32 {
    let [id, camera, session] = names.map(|name| name.map(String::as_bytes).unwrap_or_default());
    checksum::of_columns(&[id, camera, session, &created_at_ns.to_le_bytes(), document.as_bytes()])
}

struct StoredCalibration {
    id: String,
    camera: Option<String>,
    session: Option<String>,
    created_at_ns: i64,
    document: String,
    checksum: Option<u32>,
}

impl StoredCalibration {
    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        Ok(Self {
            id: row.get(0)?,
            camera: row.get(1)?,
            session: row.get(2)?,
            created_at_ns: row.get(3)?,
            document: row.get(4)?,
            checksum: row.get(5)?,
        })
    }

    fn to_calibration(&self) -> Result<Calibration, StoreError> {
        let row = || row_name(&self.id);
        let names = [Some(&self.id), self.camera.as_ref(), self.session.as_ref()];
        let computed = checksum_of(names, self.created_at_ns, &self.document);
        checksum::check(self.checksum, computed, row)?;
        let document: CalibrationDocument = json::read(&self.document, row)?;
        Calibration::try_from(&document)
            .map_err(|e| StoreError::Unreadable { row: row(), detail: e.to_string() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::session_record::SessionState;
    use crate::store::example_tests::{calibration, record};

    #[test]
    fn calibrations_come_back_to_the_bit_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        {
            let store = Store::open(folder.path()).unwrap();
            for (id, created_at_ns) in [("c1", 1), ("c3", 3), ("c2", 2)] {
                store.append_calibration(&calibration(id, created_at_ns)).unwrap();
            }
        }
        let store = Store::open(folder.path()).unwrap();
        let expected = [calibration("c3", 3), calibration("c2", 2), calibration("c1", 1)];
        assert_eq!(store.calibrations("front").unwrap(), expected);
        assert_eq!(store.calibrations("back").unwrap(), []);
        assert_eq!(store.calibration("c2").unwrap(), Some(calibration("c2", 2)));
        assert_eq!(store.calibration("c9").unwrap(), None);
    }

    #[test]
    fn pages_have_every_calibration_once_and_read_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        for number in 0..9_i64 {
            // Several that were made at the same time.
            store.append_calibration(&calibration(&format!("c{number}"), number / 2)).unwrap();
        }
        let damage = "UPDATE calibrations SET document = '{}' WHERE id IN ('c3', 'c4')";
        store.connection().execute(damage, []).unwrap();
        let (first, next) = store.calibrations_page("front", None, Some(4)).unwrap();
        assert_eq!(ids(&first), ["c8", "c7", "c6", "c5"]);
        assert_eq!(store.unreadable(), [] as [String; 0], "a page reads nothing beyond it");
        // A page of which nothing can be read is not the last one.
        let (none, next) = store.calibrations_page("front", next.as_deref(), Some(2)).unwrap();
        assert_eq!((ids(&none).len(), next.as_deref()), (0, Some("c3")));
        let (last, next) = store.calibrations_page("front", next.as_deref(), Some(3)).unwrap();
        assert_eq!((ids(&last), next), (vec!["c2", "c1", "c0"], None));
        assert_eq!(ids(&store.calibrations("front").unwrap()).len(), 7);
        for (camera, cursor) in [("front", "c9"), ("rear", "c8")] {
            let unknown = store.calibrations_page(camera, Some(cursor), Some(1));
            assert!(matches!(unknown, Err(StoreError::Missing { .. })));
        }
    }

    fn ids(calibrations: &[Calibration]) -> Vec<&str> {
        calibrations.iter().map(|calibration| calibration.id.as_str()).collect()
    }

    #[test]
    fn the_current_one_is_the_one_approved_last() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        assert!(matches!(store.set_current("front", "c1"), Err(StoreError::Missing { .. })));
        assert_eq!(store.current_calibration_id("front").unwrap(), None);
        store.append_calibration(&calibration("c1", 1)).unwrap();
        store.append_calibration(&calibration("c2", 2)).unwrap();
        for id in ["c2", "c1"] {
            store.set_current("front", id).unwrap();
            assert_eq!(store.current_calibration_id("front").unwrap().as_deref(), Some(id));
        }
    }

    #[test]
    fn a_session_ends_with_its_calibration_and_what_is_current_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let finished = |id: &str| SessionRecord { state: SessionState::Finished, ..record(id) };
        store.begin_session(&record("s1")).unwrap();
        let never_begun = store.finish_session(&finished("s9"), &calibration("c1", 1), true);
        assert!(matches!(never_begun, Err(StoreError::Missing { .. })));
        assert_eq!(store.calibration("c1").unwrap(), None);
        assert_eq!(store.current_calibration_id("front").unwrap(), None);
        store.finish_session(&finished("s1"), &calibration("c1", 1), false).unwrap();
        assert_eq!(store.current_calibration_id("front").unwrap(), None);
        store.finish_session(&finished("s1"), &calibration("c2", 2), true).unwrap();
        assert_eq!(store.session("s1").unwrap().unwrap().state, SessionState::Finished);
        assert_eq!(store.current_calibration_id("front").unwrap().as_deref(), Some("c2"));
    }

    #[test]
    fn a_calibration_never_changes() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.append_calibration(&calibration("c1", 1)).unwrap();
        assert!(matches!(
            store.append_calibration(&calibration("c1", 2)),
            Err(StoreError::Failed { .. })
        ));
        assert_eq!(store.calibration("c1").unwrap(), Some(calibration("c1", 1)));
    }
}
