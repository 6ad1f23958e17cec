//! Read-only access to a store that another process may have open: to check it or to copy it.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags};

use crate::store::database::FILE_NAME;
use crate::store::error::StoreError;
use crate::store::{Store, upgrades};

/// The result of a check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoreCheck {
    /// Sessions, views and calibrations that can be read.
    pub rows: u64,
    /// The damage, one line each: SQLite's findings, and rows that cannot be read.
    pub damage: Vec<String>,
}

/// A store that is opened for reading only.
#[derive(Debug)]
pub struct StoreReader {
    path: PathBuf,
    connection: Connection,
}

impl StoreReader {
    /// Opens the store in `folder` for reading, whether or not it is in use.
    ///
    /// # Errors
    /// [`StoreError::Folder`] where there is none.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(FILE_NAME);
        let unusable = |detail: String| StoreError::Folder { path: folder.to_owned(), detail };
        if !path.is_file() {
            return Err(unusable(format!("there is no {FILE_NAME} in it")));
        }
        let connection = Connection::open_with_flags(&path, OpenFlags::SQLITE_OPEN_READ_ONLY)
            .map_err(|e| unusable(e.to_string()))?;
        Ok(Self { path, connection })
    }

    /// Writes a copy of the store's present state to the file `to`, which must not exist.
    ///
    /// # Errors
    /// [`StoreError::Folder`] where it cannot be written.
    pub fn backup(&self, to: &Path) -> Result<(), StoreError> {
        let unusable = |detail: String| StoreError::Folder { path: to.to_owned(), detail };
        if to.exists() {
            return Err(unusable("it is there already".to_owned()));
        }
        let name = to.to_str().ok_or_else(|| unusable("its name is not UTF-8".to_owned()))?;
        self.connection.execute("VACUUM INTO ?1", [name]).map_err(|e| unusable(e.to_string()))?;
        let synced = std::fs::File::open(to).and_then(|file| file.sync_all());
        synced.map_err(|e| unusable(e.to_string()))
    }

    /// Reads everything: SQLite's integrity check, every row with its checksum, every document.
    ///
    /// # Errors
    /// [`StoreError::Older`] for a store that this version has not upgraded yet.
    pub fn check(self) -> Result<StoreCheck, StoreError> {
        let mut damage = self.findings();
        let version = upgrades::version_of(&self.connection);
        let known = upgrades::known();
        match version {
            Some(version) if version == known => {}
            Some(version) => {
                let (found, known) = (version as i64, known as i64);
                return Err(StoreError::Older { path: self.path, found, known });
            }
            None => {
                damage.push("its tables are not those of a store that is known here".to_owned());
                return Ok(StoreCheck { rows: 0, damage });
            }
        }
        let store = Store::of_reader(self.path, self.connection);
        let rows = count_readable(&store, &mut damage);
        damage.extend(store.unreadable());
        Ok(StoreCheck { rows, damage })
    }

    /// The findings of SQLite's own check.
    fn findings(&self) -> Vec<String> {
        let findings = || {
            let mut statement = self.connection.prepare("PRAGMA integrity_check")?;
            let rows = statement.query_map([], |row| row.get::<_, String>(0))?;
            rows.collect::<Result<Vec<_>, rusqlite::Error>>()
        };
        match findings() {
            Ok(found) => found.into_iter().filter(|line| line != "ok").collect(),
            Err(error) => vec![error.to_string()],
        }
    }
}

/// Counts the rows that can be read; the others are listed in [`Store::unreadable`] or in `damage`.
fn count_readable(store: &Store, damage: &mut Vec<String>) -> u64 {
    let mut note = |error: StoreError| damage.push(error.to_string());
    let mut rows = 0;
    for session in store.sessions().map_err(&mut note).unwrap_or_default() {
        rows += 1;
        for view in store.sensor_views(&session.id).map_err(&mut note).unwrap_or_default() {
            match store.sensor_picture(&session.id, view.frame_set, &view.sensor) {
                Ok(_) => rows += 1,
                Err(error) => note(error),
            }
        }
    }
    let calibrations = store.every_calibration().map_err(&mut note).unwrap_or_default();
    rows + calibrations.len() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::example_tests::{calibration, keep, record, view};

    #[test]
    fn a_store_in_use_is_checked_and_copied() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.begin_session(&record("s1")).unwrap();
        keep(&store, "s1", &view(0), "image/jpeg", b"first").unwrap();
        store.append_calibration(&calibration("c1", 1)).unwrap();
        let whole = StoreCheck { rows: 3, damage: Vec::new() };
        assert_eq!(StoreReader::open(folder.path()).unwrap().check().unwrap(), whole);
        let copy = tempfile::tempdir().unwrap();
        let file = copy.path().join(FILE_NAME);
        StoreReader::open(folder.path()).unwrap().backup(&file).unwrap();
        // What is written after it is not in it.
        store.append_calibration(&calibration("c2", 2)).unwrap();
        let copied = Store::open(copy.path()).unwrap();
        assert_eq!(copied.sessions().unwrap(), store.sessions().unwrap());
        assert_eq!(copied.calibrations("front").unwrap(), [calibration("c1", 1)]);
        let again = StoreReader::open(folder.path()).unwrap().backup(&file);
        assert!(again.unwrap_err().to_string().contains("it is there already"));
    }

    #[test]
    fn each_damaged_row_is_a_line() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.begin_session(&record("s1")).unwrap();
        store.begin_session(&record("s2")).unwrap();
        keep(&store, "s1", &view(0), "image/jpeg", b"first").unwrap();
        let sql = "UPDATE views SET picture = 'other'; UPDATE sessions SET document = replace(document, '100', '101') WHERE id = 's2'";
        // STRICT tables take no text for bytes.
        let sql = sql.replace("'other'", "x'00'");
        store.connection().execute_batch(&sql).unwrap();
        let found = StoreReader::open(folder.path()).unwrap().check().unwrap();
        assert_eq!(found.rows, 1);
        assert_eq!(found.damage.len(), 2, "{:?}", found.damage);
        assert!(found.damage[0].contains("the picture of color in frame set 0"));
        assert!(found.damage[1].starts_with("session s2: its checksum is"), "{:?}", found.damage);
    }
}
