//! The open database: used by one process at a time; every commit is on disk before it returns.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use rusqlite::{Connection, ErrorCode, Row, ToSql};

use crate::locks::lock;
use crate::store::error::StoreError;
use crate::store::salvage::{self, RepairReport};
use crate::store::upgrades;

/// The database's name in the store's folder.
pub(super) const FILE_NAME: &str = "plumb.sqlite";
/// The lock file of the process that has the store open.
const LOCK_NAME: &str = "plumb.lock";

/// An open store; may be used from several threads.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    connection: Mutex<Connection>,
    least_free_bytes: u64,
    /// The rows that could not be read, with the reason.
    unreadable: Mutex<BTreeMap<String, String>>,
    /// Held as long as the store is open: one process at a time.
    _lock: Option<File>,
}

impl Store {
    /// Opens the store in `folder`, creates it if it does not exist, and upgrades an older one.
    ///
    /// # Errors
    /// [`StoreError::Folder`], [`StoreError::InUse`], [`StoreError::Newer`],
    /// [`StoreError::Damaged`].
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        Self::open_with(folder, 0)
    }

    /// Like [`Store::open`], but keeps this many bytes of the disk free: with less free space, new
    /// sessions and views are refused, so that running sessions can still be ended.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn open_with(folder: &Path, least_free_bytes: u64) -> Result<Self, StoreError> {
        let unusable = |detail: String| StoreError::Folder { path: folder.to_owned(), detail };
        std::fs::create_dir_all(folder).map_err(|e| unusable(e.to_string()))?;
        let lock = lock_folder(folder)?;
        let path = folder.join(FILE_NAME);
        let mut connection = Connection::open(&path).map_err(|e| unusable(e.to_string()))?;
        prepare(&connection).map_err(|e| opening(&path, &e))?;
        upgrades::bring_up_to_date(&mut connection, &path)?;
        salvage::keep_first_page(&connection, &path);
        Ok(Self {
            path,
            connection: Mutex::new(connection),
            least_free_bytes,
            unreadable: Mutex::default(),
            _lock: Some(lock),
        })
    }

    /// Like [`Store::open_with`], but a damaged database is moved aside, and what can be read of it
    /// is copied to a new one. `None` for a database that was intact.
    ///
    /// # Errors
    /// As [`Store::open`]; [`StoreError::Irreparable`] where none of it can be read.
    pub fn open_or_repair(
        folder: &Path,
        least_free_bytes: u64,
    ) -> Result<(Self, Option<RepairReport>), StoreError> {
        match Self::open_with(folder, least_free_bytes) {
            Err(StoreError::Damaged { path, detail }) => {
                let repaired = {
                    let _lock = lock_folder(folder)?;
                    salvage::repair(&path, &detail)?
                };
                Ok((Self::open_with(folder, least_free_bytes)?, Some(repaired)))
            }
            opened => Ok((opened?, None)),
        }
    }

    /// The store of a read-only connection; no lock is taken.
    pub(super) fn of_reader(path: PathBuf, connection: Connection) -> Self {
        Self {
            path,
            connection: Mutex::new(connection),
            least_free_bytes: 0,
            unreadable: Mutex::default(),
            _lock: None,
        }
    }

    /// The rows found unreadable since the store was opened: one line for each, with the reason.
    pub fn unreadable(&self) -> Vec<String> {
        let unreadable = lock(&self.unreadable);
        unreadable.iter().map(|(row, detail)| format!("{row}: {detail}")).collect()
    }

    /// The rows that could be read; the others are recorded for [`Store::unreadable`].
    pub(super) fn readable<T>(&self, rows: impl Iterator<Item = Result<T, StoreError>>) -> Vec<T> {
        let mut unreadable = lock(&self.unreadable);
        let mut kept = Vec::new();
        for row in rows {
            match row {
                Ok(row) => kept.push(row),
                Err(StoreError::Unreadable { row, detail }) => {
                    unreadable.insert(row, detail);
                }
                Err(other) => {
                    unreadable.insert("a row".to_owned(), other.to_string());
                }
            }
        }
        kept
    }

    /// The rows of a table that `sql` selects. A column with an unexpected type makes only its own
    /// row unreadable.
    pub(super) fn select<T>(
        &self,
        table: &str,
        sql: &str,
        values: &[&dyn ToSql],
        of_row: fn(&Row<'_>) -> Result<T, rusqlite::Error>,
    ) -> Result<Vec<Result<T, StoreError>>, StoreError> {
        let connection = self.connection();
        let mut statement = connection.prepare(sql).map_err(|e| self.failed(&e))?;
        let rows = statement.query_map(values, of_row).map_err(|e| self.failed(&e))?;
        let row = |number: usize| format!("row {number} of the table {table}");
        rows.enumerate()
            .map(|(number, found)| match found {
                Ok(found) => Ok(Ok(found)),
                Err(error) if error.sqlite_error_code().is_some() => Err(self.failed(&error)),
                Err(error) => {
                    let detail = error.to_string();
                    Ok(Err(StoreError::Unreadable { row: row(number), detail }))
                }
            })
            .collect()
    }

    /// The folder of the store.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(&self.path)
    }

    /// Limits the growth of the database to this many pages, to simulate a full disk.
    #[cfg(test)]
    pub(crate) fn limit_growth(&self, pages: Option<i64>) {
        let connection = self.connection();
        let used: i64 =
            connection.pragma_query_value(None, "page_count", |row| row.get(0)).unwrap();
        let most = pages.map_or(1 << 30, |pages| used + pages);
        connection.pragma_update_and_check(None, "max_page_count", most, |_| Ok(())).unwrap();
    }

    /// Checks that enough of the disk stays free after `bytes` more.
    ///
    /// # Errors
    /// [`StoreError::NoRoom`] where it does not.
    pub(crate) fn has_room(&self, bytes: u64) -> Result<(), StoreError> {
        const MB: u64 = 1_000_000;
        // Where the free space is unknown, the disk is assumed to have room: a write that fails
        // reports it.
        let Some(free) = free_bytes(self.folder()).filter(|_| self.least_free_bytes > 0) else {
            return Ok(());
        };
        if free >= self.least_free_bytes.saturating_add(bytes) {
            return Ok(());
        }
        Err(StoreError::NoRoom {
            path: self.folder().to_owned(),
            free_mb: free / MB,
            least_mb: self.least_free_bytes / MB,
        })
    }

    pub(super) fn connection(&self) -> MutexGuard<'_, Connection> {
        lock(&self.connection)
    }

    pub(super) fn failed(&self, error: &rusqlite::Error) -> StoreError {
        match error.sqlite_error_code() {
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
                StoreError::Damaged { path: self.path.clone(), detail: error.to_string() }
            }
            _ => StoreError::Failed { path: self.path.clone(), detail: error.to_string() },
        }
    }
}

/// The disk space that is free for this process, in bytes; `None` where it is unknown.
#[cfg(target_os = "linux")]
fn free_bytes(folder: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(not(target_os = "linux"))]
fn free_bytes(_: &Path) -> Option<u64> {
    None
}

/// Locks the store in `folder` for this process, until the returned file is dropped. Other
/// processes may still read the database, which a backup of a running store needs.
fn lock_folder(folder: &Path) -> Result<File, StoreError> {
    let path = folder.join(LOCK_NAME);
    let unusable = |e: std::io::Error| StoreError::Folder {
        path: folder.to_owned(),
        detail: format!("{LOCK_NAME}: {e}"),
    };
    let file = File::options().create(true).append(true).open(path).map_err(unusable)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse { path: folder.join(FILE_NAME) }),
        Err(TryLockError::Error(error)) => Err(unusable(error)),
    }
}

/// Configures the connection so that every commit is on disk before it returns.
fn prepare(connection: &Connection) -> Result<(), rusqlite::Error> {
    connection.pragma_update_and_check(None, "journal_mode", "WAL", |_| Ok(()))?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    connection.pragma_update(None, "foreign_keys", true)?;
    // An older plumb opens the database exclusively: detected now, not at the first write.
    connection.execute_batch("BEGIN IMMEDIATE; COMMIT;")
}

fn opening(path: &Path, error: &rusqlite::Error) -> StoreError {
    let path = path.to_owned();
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => StoreError::InUse { path },
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
            StoreError::Damaged { path, detail: error.to_string() }
        }
        Some(ErrorCode::SystemIoFailure | ErrorCode::DiskFull) => {
            StoreError::Failed { path, detail: error.to_string() }
        }
        _ => StoreError::Folder { path, detail: error.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(prepare: impl FnOnce(&Path)) -> String {
        let folder = tempfile::tempdir().unwrap();
        prepare(&folder.path().join(FILE_NAME));
        let text = Store::open(folder.path()).unwrap_err().to_string();
        assert!(!text.contains('\n'), "{text}");
        text.replace(&folder.path().display().to_string(), "DIR")
    }

    #[test]
    fn what_is_not_a_store_is_refused_in_one_line() {
        let garbage = refusal(|path| std::fs::write(path, vec![7; 10_000]).unwrap());
        assert_eq!(
            garbage,
            "store DIR/plumb.sqlite: damaged, or not a Plumb store: file is not a database; check `dmesg` for disk errors, then run `plumb store repair`, or restore a backup"
        );
        let foreign = refusal(|path| {
            Connection::open(path).unwrap().execute_batch("CREATE TABLE cats (id)").unwrap();
        });
        assert!(
            foreign.contains("not a Plumb store: it is another program's database"),
            "{foreign}"
        );
        let newer = refusal(|path| {
            drop(Store::open(path.parent().unwrap()).unwrap());
            Connection::open(path).unwrap().pragma_update(None, "user_version", 1000).unwrap();
        });
        assert!(newer.contains("has schema 1000, this program knows up to"), "{newer}");
    }

    #[test]
    fn a_damaged_page_is_noticed() {
        let text = refusal(|path| {
            drop(Store::open(path.parent().unwrap()).unwrap());
            let mut bytes = std::fs::read(path).unwrap();
            bytes[4096..].fill(0x5a);
            std::fs::write(path, bytes).unwrap();
        });
        assert!(text.contains("damaged"), "{text}");
    }

    #[test]
    fn a_folder_that_cannot_be_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(Store::open(&file.join("store")), Err(StoreError::Folder { .. })));
    }

    #[test]
    fn a_second_process_is_refused_and_a_later_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let first = Store::open(folder.path()).unwrap();
        assert!(matches!(Store::open(folder.path()), Err(StoreError::InUse { .. })));
        drop(first);
        assert!(Store::open(folder.path()).is_ok());
    }
}
