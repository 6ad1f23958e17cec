//! The tables of calibrations and of those that hold now.

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
        let found = self.select_calibrations(&format!("{COLUMNS} WHERE id = ?1"), &[&id])?;
        found.into_iter().next().transpose()
    }

    /// Every calibration of a camera that can be read, newest first; [`Store::unreadable`] has the
    /// others.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn calibrations(&self, camera: &str) -> Result<Vec<Calibration>, StoreError> {
        let sql = format!("{COLUMNS} WHERE camera = ?1 ORDER BY created_at_ns DESC, id DESC");
        let found = self.select_calibrations(&sql, &[&camera])?;
        Ok(self.readable(found.into_iter()))
    }

    /// Every calibration that can be read, of whatever camera, newest first.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub(super) fn every_calibration(&self) -> Result<Vec<Calibration>, StoreError> {
        let sql = format!("{COLUMNS} ORDER BY created_at_ns DESC, id DESC");
        Ok(self.readable(self.select_calibrations(&sql, &[])?.into_iter()))
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
        let mut connection = self.connection();
        let mut write = || {
            let transaction = connection.transaction()?;
            transaction.execute(sql, params![camera, calibration_id])?;
            let approved = "INSERT OR IGNORE INTO approvals (calibration) VALUES (?1)";
            transaction.execute(approved, params![calibration_id])?;
            transaction.commit()
        };
        write().map_err(|e| self.failed(&e))
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
    ) -> Result<Vec<Result<Calibration, StoreError>>, StoreError> {
        let rows = self.select(("calibrations", sql), values, StoredCalibration::from_row)?;
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
