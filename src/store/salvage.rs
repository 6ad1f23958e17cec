//! Repairs a damaged database: all rows that can be read are copied to a new one, and the damaged
//! file is kept beside it.
//!
//! A page that cannot be read costs only the rows in it: each table is read from its first row
//! upwards and from its last row downwards, and the rows in between by their row numbers.

use std::fs;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags, params_from_iter};
use tempfile::TempDir;

use crate::store::error::StoreError;
use crate::store::upgrades;

/// The largest gap between readable rows in which every row number is tried, in rows: a page holds
/// far fewer; a larger gap means that the row numbers themselves are damaged.
const LARGEST_ROW_GAP: i64 = 100_000;
/// The size of a page, in bytes: SQLite's default, which no store changes.
const PAGE_BYTES: usize = 4096;

/// The position of the number of pages in the header, big-endian (SQLite's file format, 1.3).
const PAGE_COUNT_AT: u64 = 28;

/// The result of repairing a damaged database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RepairReport {
    /// SQLite's finding.
    pub finding: String,
    /// Where the damaged file is now.
    pub damaged: PathBuf,
    /// How many rows were copied.
    pub copied: u64,
    /// What could not be read, one line for each table and reason.
    pub lost: Vec<String>,
}

impl std::fmt::Display for RepairReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { finding, damaged, copied, lost } = self;
        let damaged = damaged.display();
        write!(f, "the store was damaged ({finding}) and is repaired: {copied} rows kept, ")?;
        match lost.is_empty() {
            true => write!(f, "none lost")?,
            false => write!(f, "lost: {}", lost.join("; "))?,
        }
        write!(f, "; the damaged file is {damaged}")
    }
}

/// Keeps a copy of the first page, which contains the schema: without it no row can be found.
pub(super) fn keep_first_page(connection: &Connection, path: &Path) {
    let copy = || {
        // The latest writes may still be in the log beside the database.
        let _ = connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
        let mut page = Vec::with_capacity(PAGE_BYTES);
        fs::File::open(path)?.take(PAGE_BYTES as u64).read_to_end(&mut page)?;
        let kept = first_page_of(path);
        if fs::read(&kept).ok().as_ref() != Some(&page) {
            fs::write(kept, page)?;
        }
        std::io::Result::Ok(())
    };
    // The copy is needed only if the first page is ever damaged, so a failure here is ignored.
    let _ = copy();
}

fn first_page_of(path: &Path) -> PathBuf {
    path.with_extension("first-page")
}

/// Moves the damaged database at `path` aside and replaces it with a new one that contains all rows
/// that can be read; `finding` is the damage that was found.
///
/// # Errors
/// [`StoreError::Irreparable`] where none of it can be read, [`StoreError::Folder`] where the new
/// one cannot be written. The damaged file is then where it was.
pub(super) fn repair(path: &Path, finding: &str) -> Result<RepairReport, StoreError> {
    let unusable = |detail: String| StoreError::Folder { path: path.to_owned(), detail };
    let made = path.with_extension("repaired");
    let _ = fs::remove_file(&made);
    let (version, old, copy) = readable(path, finding)?;
    let mut new = Connection::open(&made).map_err(|e| unusable(e.to_string()))?;
    let (copied, lost) =
        copy_tables(&old, &mut new, version).map_err(|e| unusable(e.to_string()))?;
    drop((old, new, copy));
    let damaged = unused_name(path);
    let moves = || {
        for suffix in ["", "-wal", "-shm"] {
            let [from, to] = [path, damaged.as_path()].map(|path| with_suffix(path, suffix));
            if from.exists() {
                fs::rename(from, to)?;
            }
        }
        fs::File::open(&made)?.sync_all()?;
        fs::rename(&made, path)
    };
    moves().map_err(|e: std::io::Error| unusable(e.to_string()))?;
    Ok(RepairReport { finding: finding.to_owned(), damaged, copied, lost })
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// `plumb.sqlite.damaged-1`, or the next number for which there is no file.
fn unused_name(path: &Path) -> PathBuf {
    let named = |number: u32| with_suffix(path, &format!(".damaged-{number}"));
    (1..u32::MAX).map(named).find(|name| !name.exists()).unwrap_or_else(|| named(u32::MAX))
}

/// The damaged database, open for reading, and the version of its schema. If it cannot be opened as
/// it is, this is a copy with the first page that was kept. The folder of that copy is deleted when
/// it is dropped.
fn readable(
    path: &Path,
    finding: &str,
) -> Result<(usize, Connection, Option<TempDir>), StoreError> {
    let irreparable =
        |detail: &str| StoreError::Irreparable { path: path.to_owned(), detail: detail.to_owned() };
    if let Some((version, connection)) = opened(path) {
        return Ok((version, connection, None));
    }
    let page = fs::read(first_page_of(path)).map_err(|_| irreparable(finding))?;
    let folder = with_first_page(path, &page).map_err(|e| irreparable(&e.to_string()))?;
    let (version, connection) =
        opened(&copy_in(&folder, path)).ok_or_else(|| irreparable(finding))?;
    Ok((version, connection, Some(folder)))
}

fn copy_in(folder: &TempDir, path: &Path) -> PathBuf {
    folder.path().join(path.file_name().unwrap_or_default())
}

/// A copy of the database with another first page, and of the log beside it, which contains the
/// latest writes.
fn with_first_page(path: &Path, page: &[u8]) -> Result<TempDir, std::io::Error> {
    let folder = tempfile::tempdir_in(path.parent().unwrap_or(path))?;
    let copy = copy_in(&folder, path);
    for suffix in ["", "-wal"] {
        let [from, to] = [path, copy.as_path()].map(|path| with_suffix(path, suffix));
        if from.exists() {
            fs::copy(from, to)?;
        }
    }
    let mut file = fs::File::options().write(true).open(&copy)?;
    let pages = u32::try_from(file.metadata()?.len() / PAGE_BYTES as u64).unwrap_or(u32::MAX);
    file.write_all(page)?;
    // The database has grown since the first page was copied.
    file.seek(SeekFrom::Start(PAGE_COUNT_AT))?;
    file.write_all(&pages.to_be_bytes())?;
    Ok(folder)
}

/// `None` for a database that does not have the schema of a store.
fn opened(path: &Path) -> Option<(usize, Connection)> {
    let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE).ok()?;
    let version = upgrades::version_of(&connection)?;
    Some((version, connection))
}

/// Copies all tables. Returns how many rows were copied, and what was lost.
fn copy_tables(
    old: &Connection,
    new: &mut Connection,
    version: usize,
) -> Result<(u64, Vec<String>), rusqlite::Error> {
    let transaction = new.transaction()?;
    upgrades::make_version(&transaction, version)?;
    let (mut copied, mut lost) = (0, Vec::new());
    for table in upgrades::tables_of(&transaction)? {
        let mut copy = TableCopy::new(old, &transaction, &table);
        copy.run();
        copied += copy.copied;
        lost.extend(copy.lost());
    }
    transaction.commit()?;
    Ok((copied, lost))
}

/// Copies one table as far as it can be read, with one row in memory at a time.
struct TableCopy<'a> {
    old: &'a Connection,
    new: &'a Connection,
    table: &'a str,
    copied: u64,
    /// How many rows the new table did not accept.
    refused: u64,
    /// Ranges of row numbers that could not be read.
    unread: Vec<(i64, i64)>,
    /// SQLite's error for the first of them.
    reason: Option<String>,
}

impl<'a> TableCopy<'a> {
    fn new(old: &'a Connection, new: &'a Connection, table: &'a str) -> Self {
        Self { old, new, table, copied: 0, refused: 0, unread: Vec::new(), reason: None }
    }

    fn run(&mut self) {
        let table = self.table;
        let up = self.scan(&format!("SELECT rowid, * FROM {table} ORDER BY rowid"));
        let (Some(reason), last) = up else { return };
        self.reason = Some(reason);
        let below = last.unwrap_or(i64::MIN);
        let sql = format!("SELECT rowid, * FROM {table} WHERE rowid > {below} ORDER BY rowid DESC");
        let Some(above) = self.scan(&sql).1 else {
            self.unread.push((below.saturating_add(1), i64::MAX));
            return;
        };
        let start = if below == i64::MIN { 1.min(above) } else { below + 1 };
        if above - start > LARGEST_ROW_GAP {
            self.unread.push((start, above - 1));
            return;
        }
        for row in start..above {
            let sql = format!("SELECT rowid, * FROM {table} WHERE rowid = {row}");
            if self.scan(&sql).0.is_some() {
                self.mark_unread(row);
            }
        }
    }

    /// Copies rows until one cannot be read. Returns the error, and the number of the last row that
    /// could be read.
    fn scan(&mut self, sql: &str) -> (Option<String>, Option<i64>) {
        let mut last = None;
        let reason = self.copy_rows(sql, &mut last).err().map(|error| error.to_string());
        (reason, last)
    }

    fn copy_rows(&mut self, sql: &str, last: &mut Option<i64>) -> Result<(), rusqlite::Error> {
        let mut statement = self.old.prepare(sql)?;
        let columns = statement.column_count();
        let places = vec!["?"; columns - 1].join(", ");
        let mut insert =
            self.new.prepare(&format!("INSERT INTO {} VALUES ({places})", self.table))?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let number: i64 = row.get(0)?;
            let values = (1..columns).map(|column| row.get(column));
            // A row with invalid UTF-8 in a text column is lost.
            match values.collect::<Result<Vec<Value>, _>>() {
                Ok(values) => match insert.execute(params_from_iter(values)) {
                    Ok(_) => self.copied += 1,
                    Err(_) => self.refused += 1,
                },
                Err(error) => {
                    self.reason.get_or_insert_with(|| error.to_string());
                    self.unread.push((number, number));
                }
            }
            *last = Some(number);
        }
        Ok(())
    }

    fn mark_unread(&mut self, row: i64) {
        match self.unread.last_mut() {
            Some((_, last)) if *last + 1 == row => *last = row,
            _ => self.unread.push((row, row)),
        }
    }

    /// One line for the rows that could not be read, and one for the rows that were refused.
    fn lost(&self) -> Vec<String> {
        let Self { table, refused, .. } = self;
        let named = |(first, last): &(i64, i64)| match (first, last) {
            (first, &i64::MAX) => format!("{first} and after"),
            (first, last) if first == last => first.to_string(),
            (first, last) => format!("{first} to {last}"),
        };
        let mut lines = Vec::new();
        if let Some(reason) = self.reason.as_deref().filter(|_| !self.unread.is_empty()) {
            let rows: Vec<String> = self.unread.iter().map(named).collect();
            lines.push(format!("rows {} of {table} ({reason})", rows.join(", ")));
        }
        if *refused > 0 {
            let why = "that refer to what is lost, or are there twice";
            lines.push(format!("{refused} of {table} {why}"));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::RngExt;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::calibration::session_record::{SessionRecord, SessionState};
    use crate::store::Store;
    use crate::store::example_tests::{calibration, keep, record, view};

    const SESSIONS: u32 = 12;
    const VIEWS: u32 = 6;
    const REFUSED: &str = "refused: ";

    /// What a store serves: a text for each row, by its name. A picture that is refused is not
    /// served, with the reason.
    fn served(store: &Store) -> BTreeMap<String, String> {
        let mut served = BTreeMap::new();
        for session in store.sessions().unwrap() {
            for view in store.sensor_views(&session.id).unwrap() {
                let place = (session.id.as_str(), view.frame_set, &view.sensor);
                let picture = store.sensor_picture(place.0, place.1, place.2);
                served.insert(format!("{place:?}"), format!("{view:?}"));
                let picture = picture.map_or_else(
                    |e| REFUSED.to_owned() + &e.to_string(),
                    |picture| format!("{picture:?}"),
                );
                served.insert(format!("picture of {place:?}"), picture);
            }
            served.insert(format!("session {}", session.id), format!("{session:?}"));
        }
        for calibration in store.calibrations("front").unwrap() {
            served.insert(format!("calibration {}", calibration.id), format!("{calibration:?}"));
        }
        let current = store.current_calibration_id("front").unwrap();
        served.insert("current".to_owned(), format!("{current:?}"));
        served
    }

    fn filled(folder: &Path) -> BTreeMap<String, String> {
        let store = Store::open(folder).unwrap();
        let mut noise = ChaCha8Rng::seed_from_u64(1);
        for number in 0..SESSIONS {
            let id = format!("s{number}");
            let state = SessionState::Finished;
            store.begin_session(&SessionRecord { state, ..record(&id) }).unwrap();
            for at in 0..VIEWS {
                let picture: Vec<u8> =
                    (0..noise.random_range(1..9000)).map(|_| noise.random()).collect();
                keep(&store, &id, &view(at), "image/jpeg", &picture).unwrap();
            }
            store.append_calibration(&calibration(&format!("c{number}"), number.into())).unwrap();
        }
        store.set_current("front", "c3").unwrap();
        served(&store)
    }

    /// Flips one byte at each of many places: what is served is as it was written, and what is not
    /// served any more is reported.
    #[test]
    fn a_flipped_byte_costs_what_it_hit_and_is_reported() {
        const PLACES: u64 = 250;
        let folder = tempfile::tempdir().unwrap();
        let expected = filled(folder.path());
        let whole = fs::read(folder.path().join("plumb.sqlite")).unwrap();
        let first_page = fs::read(folder.path().join("plumb.first-page")).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let (mut unserved, mut refused) = (0, 0);
        for place in 0..PLACES {
            // One place in ten lies in the first page, where the schema is.
            let end = if place % 10 == 0 { PAGE_BYTES } else { whole.len() };
            let at = random.random_range(0..end);
            let damaged = tempfile::tempdir().unwrap();
            let mut bytes = whole.clone();
            bytes[at] ^= random.random_range(1..=255u8);
            fs::write(damaged.path().join("plumb.sqlite"), bytes).unwrap();
            fs::write(damaged.path().join("plumb.first-page"), &first_page).unwrap();
            let (store, report) = match Store::open_or_repair(damaged.path(), 0) {
                Ok(opened) => opened,
                // The header's own version: it may be a newer program's.
                Err(StoreError::Newer { .. }) if (60..64).contains(&at) => {
                    refused += 1;
                    continue;
                }
                Err(error) => panic!("byte {at}: {error}"),
            };
            let found = served(&store);
            for (row, text) in &found {
                let is_reported = text.starts_with(REFUSED);
                let is_none = row == "current" && text == "None";
                let is_same = expected.get(row) == Some(text);
                assert!(is_none || is_reported || is_same, "byte {at}: {row} differs");
            }
            let missing = expected.len() - found.len()
                + usize::from(found.get("current") != expected.get("current"));
            unserved += u64::from(found.values().any(|text| text.starts_with(REFUSED)));
            if missing > 0 {
                unserved += 1;
                let lines = store.unreadable().len() + report.map_or(0, |report| report.lost.len());
                assert!(lines > 0, "byte {at}: {missing} rows are missing without a word");
                // At most what one page holds, and the pictures of its views.
                assert!(missing <= 40, "byte {at}: {missing} rows are missing");
            }
        }
        assert!(refused <= 2 && unserved > PLACES / 4, "{refused} refused, {unserved} with a loss");
    }

    /// As a kill leaves it: what was written last is in the log, and the first page is damaged.
    #[test]
    fn what_is_only_in_the_log_survives_a_damaged_first_page() {
        let (folder, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        filled(folder.path());
        let store = Store::open(folder.path()).unwrap();
        store.append_calibration(&calibration("last", 99)).unwrap();
        for file in fs::read_dir(folder.path()).unwrap() {
            let file = file.unwrap();
            fs::copy(file.path(), killed.path().join(file.file_name())).unwrap();
        }
        let path = killed.path().join("plumb.sqlite");
        let mut bytes = fs::read(&path).unwrap();
        bytes[..PAGE_BYTES].fill(0x5a);
        fs::write(&path, bytes).unwrap();
        let (repaired, report) = Store::open_or_repair(killed.path(), 0).unwrap();
        assert_eq!(served(&repaired), served(&store), "{report:?}");
        let left = fs::read_dir(killed.path()).unwrap().map(|file| file.unwrap().path());
        assert!(!left.into_iter().any(|path| path.is_dir()), "the copy is deleted");
    }

    #[test]
    fn the_damaged_file_is_kept_and_the_report_is_one_line() {
        let folder = tempfile::tempdir().unwrap();
        filled(folder.path());
        let path = folder.path().join("plumb.sqlite");
        let mut bytes = fs::read(&path).unwrap();
        bytes[0] ^= 1;
        fs::write(&path, &bytes).unwrap();
        let (store, report) = Store::open_or_repair(folder.path(), 0).unwrap();
        let report = report.unwrap();
        assert_eq!(report.lost, [""; 0]);
        assert_eq!(fs::read(&report.damaged).unwrap(), bytes);
        assert_eq!(store.sessions().unwrap().len(), SESSIONS as usize);
        let line = report.to_string();
        assert!(line.contains("is repaired: 98 rows kept, none lost; the damaged file"), "{line}");
        drop(store);
        assert_eq!(Store::open_or_repair(folder.path(), 0).unwrap().1, None);
    }

    #[test]
    fn a_file_that_is_no_store_is_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plumb.sqlite");
        fs::write(&path, vec![7; 10_000]).unwrap();
        let error = Store::open_or_repair(folder.path(), 0).unwrap_err();
        assert!(matches!(error, StoreError::Irreparable { .. }), "{error}");
        assert_eq!(fs::read(&path).unwrap(), vec![7; 10_000]);
    }
}
