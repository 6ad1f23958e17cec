//! The schema, version by version. A new version is a new file here and one line below; what was
//! released never changes.

use std::path::Path;

use rusqlite::Connection;

use crate::store::error::StoreError;

/// What leads from each version to the next: the first makes an empty database version 1.
const UPGRADES: &[&str] = &[
    include_str!("upgrades/001.sql"),
    include_str!("upgrades/002.sql"),
    include_str!("upgrades/003.sql"),
    include_str!("upgrades/004.sql"),
];

/// Marks the file as Plumb's: "Plmb" in ASCII.
const APPLICATION_ID: i64 = 0x506c_6d62;

/// Checks that the database is Plumb's and whole, and applies the upgrades it lacks, all or none.
///
/// # Errors
/// [`StoreError::Newer`], [`StoreError::Damaged`].
pub(super) fn bring_up_to_date(connection: &mut Connection, path: &Path) -> Result<(), StoreError> {
    let damaged = |detail: String| StoreError::Damaged { path: path.to_owned(), detail };
    let broken = |error: rusqlite::Error| damaged(error.to_string());
    let found: i64 =
        connection.pragma_query_value(None, "user_version", |row| row.get(0)).map_err(broken)?;
    let application: i64 =
        connection.pragma_query_value(None, "application_id", |row| row.get(0)).map_err(broken)?;
    let tables: i64 = connection
        .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))
        .map_err(broken)?;
    if application != APPLICATION_ID && tables > 0 {
        return Err(damaged("it is another program's database".into()));
    }
    let known = UPGRADES.len() as i64;
    if found > known {
        return Err(StoreError::Newer { path: path.to_owned(), found, known });
    }
    let verdict: String =
        connection.pragma_query_value(None, "quick_check", |row| row.get(0)).map_err(broken)?;
    if verdict != "ok" {
        return Err(damaged(verdict.lines().next().unwrap_or_default().to_owned()));
    }
    upgrade(connection, found).map_err(broken)
}

fn upgrade(connection: &mut Connection, found: i64) -> Result<(), rusqlite::Error> {
    let missing = UPGRADES.get(usize::try_from(found).unwrap_or(0)..).unwrap_or_default();
    if missing.is_empty() {
        return Ok(());
    }
    let transaction = connection.transaction()?;
    for upgrade in missing {
        transaction.execute_batch(upgrade)?;
    }
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.pragma_update(None, "user_version", UPGRADES.len() as i64)?;
    transaction.commit()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use crate::store::calibrations::tests::calibration;
    use crate::store::sessions::tests::record;
    use crate::store::views::tests::view;

    /// A store at an older version, with a session, a view and a calibration in it.
    fn older_store(folder: &Path, version: usize) {
        let store = Store::open(folder).unwrap();
        store.begin_session(&record("s1")).unwrap();
        store.append_view("s1", &view(0), "image/jpeg", b"jpeg").unwrap();
        store.append_calibration(&calibration("c1", 5)).unwrap();
        drop(store);
        let newest = Connection::open(folder.join("plumb.sqlite")).unwrap();
        let older = Connection::open(folder.join("older.sqlite")).unwrap();
        UPGRADES[..version].iter().for_each(|upgrade| older.execute_batch(upgrade).unwrap());
        older.pragma_update(None, "application_id", APPLICATION_ID).unwrap();
        older.pragma_update(None, "user_version", version as i64).unwrap();
        drop(older);
        newest
            .execute("ATTACH ?1 AS older", [folder.join("older.sqlite").to_str().unwrap()])
            .unwrap();
        for table in ["sessions", "views", "calibrations"] {
            newest
                .execute_batch(&format!("INSERT INTO older.{table} SELECT * FROM main.{table}"))
                .unwrap();
        }
        newest.execute_batch("DETACH older").unwrap();
        drop(newest);
        std::fs::rename(folder.join("older.sqlite"), folder.join("plumb.sqlite")).unwrap();
    }

    #[test]
    fn every_older_store_is_brought_up_to_date_with_what_it_held() {
        for version in 1..UPGRADES.len() {
            let folder = tempfile::tempdir().unwrap();
            older_store(folder.path(), version);
            let store = Store::open(folder.path()).unwrap();
            assert_eq!(store.unfinished_sessions().unwrap(), [(record("s1"), vec![view(0)])]);
            assert_eq!(store.picture("s1", 0).unwrap().unwrap().bytes, b"jpeg");
            assert_eq!(store.calibration("c1").unwrap(), Some(calibration("c1", 5)));
            store.set_current("front", "c1").unwrap();
            assert_eq!(store.current_calibration_id("front").unwrap().as_deref(), Some("c1"));
        }
    }

    #[test]
    fn an_upgrade_that_fails_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        older_store(folder.path(), 1);
        let path = folder.path().join("plumb.sqlite");
        Connection::open(&path)
            .unwrap()
            .execute_batch("CREATE TABLE current_calibrations (other)")
            .unwrap();
        assert!(Store::open(folder.path()).is_err());
        let version: i64 = Connection::open(&path)
            .unwrap()
            .pragma_query_value(None, "user_version", |row| row.get(0))
            .unwrap();
        assert_eq!(version, 1);
    }
}
