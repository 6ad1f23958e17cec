//! The tables of calibrations and of those that hold now.

use rusqlite::{Connection, OptionalExtension, ToSql, params};

use crate::calibration::result::Calibration;
use crate::calibration::session_record::SessionRecord;
use crate::document::calibration::CalibrationDocument;
use crate::store::database::Store;
use crate::store::error::StoreError;
use crate::store::{json, sessions};

impl Store {
    /// Writes a new calibration down; it never changes after that.
    ///
    /// # Errors
    /// [`StoreError::Failed`], also when its id is taken; [`StoreError::Unstorable`] for one with a
    /// number that is none.
    pub fn append_calibration(&self, calibration: &Calibration) -> Result<(), StoreError> {
        let document = column(calibration)?;
        insert(&self.connection(), calibration, &document).map_err(|e| self.failed(&e))
    }

    /// Writes down how a session ended, and the calibration that it led to, both or none.
    ///
    /// # Errors
    /// As [`Store::append_calibration`] and [`Store::save_session`].
    pub fn finish_session(
        &self,
        record: &SessionRecord,
        calibration: &Calibration,
    ) -> Result<(), StoreError> {
        let (document, session) = (column(calibration)?, sessions::document(record)?);
        let mut connection = self.connection();
        let mut write = || {
            let transaction = connection.transaction()?;
            insert(&transaction, calibration, &document)?;
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
        let found = self
            .select_calibrations("SELECT id, document FROM calibrations WHERE id = ?1", &[&id])?;
        Ok(found.into_iter().next())
    }

    /// Every calibration of a camera, newest first.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn calibrations(&self, camera: &str) -> Result<Vec<Calibration>, StoreError> {
        let sql = "SELECT id, document FROM calibrations WHERE camera = ?1 ORDER BY created_at_ns DESC, id DESC";
        self.select_calibrations(sql, &[&camera])
    }

    /// Makes a calibration the one that holds for a camera now.
    ///
    /// # Errors
    /// [`StoreError::Missing`] for a calibration that is not there; [`StoreError::Failed`].
    pub fn set_current(&self, camera: &str, calibration_id: &str) -> Result<(), StoreError> {
        if self.calibration(calibration_id)?.is_none() {
            return Err(StoreError::Missing { row: row_name(calibration_id) });
        }
        let sql = "INSERT INTO current_calibrations (camera, calibration) VALUES (?1, ?2)
            ON CONFLICT (camera) DO UPDATE SET calibration = excluded.calibration";
        self.connection()
            .execute(sql, params![camera, calibration_id])
            .map_err(|e| self.failed(&e))?;
        Ok(())
    }

    /// Which calibration holds for a camera now.
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
    ) -> Result<Vec<Calibration>, StoreError> {
        let rows = || {
            let connection = self.connection();
            let mut statement = connection.prepare(sql)?;
            let rows = statement.query_map(values, |row| Ok((row.get(0)?, row.get(1)?)))?;
            rows.collect::<Result<Vec<(String, String)>, _>>()
        };
        let rows = rows().map_err(|e| self.failed(&e))?;
        rows.iter().map(|(id, document)| read(id, document)).collect()
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
        document
    ];
    let sql = "INSERT INTO calibrations (id, camera, session, created_at_ns, document) VALUES (?1, ?2, ?3, ?4, ?5)";
    connection.execute(sql, row).map(drop)
}

fn row_name(id: &str) -> String {
    format!("calibration {id}")
}

fn read(id: &str, document: &str) -> Result<Calibration, StoreError> {
    let document: CalibrationDocument = json::read(document, || row_name(id))?;
    Calibration::try_from(&document)
        .map_err(|e| StoreError::Unreadable { row: row_name(id), detail: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::example_tests::calibration;

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
