//! The schema, version by version. A new version is a new file here and one more line below; a
//! released version never changes.

use std::path::Path;

use rusqlite::{Connection, Transaction};

use crate::store::error::StoreError;

/// The upgrades from each version to the next: the first creates version 1 in an empty database.
const UPGRADES: &[&str] = &[
    include_str!("upgrades/001.sql"),
    include_str!("upgrades/002.sql"),
    include_str!("upgrades/003.sql"),
    include_str!("upgrades/004.sql"),
    include_str!("upgrades/005.sql"),
    include_str!("upgrades/006.sql"),
    include_str!("upgrades/007.sql"),
];

/// The application id in the database file: "Plmb" in ASCII.
const APPLICATION_ID: i64 = 0x506c_6d62;

/// Checks that the database is an intact one of Plumb's, and applies the missing upgrades, all or
/// none.
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
        connection.pragma_query_value(None, "integrity_check", |row| row.get(0)).map_err(broken)?;
    if verdict != "ok" {
        return Err(damaged(verdict.lines().next().unwrap_or_default().to_owned()));
    }
    if found > 0 && version_of(connection).is_none_or(|version| version as i64 != found) {
        return Err(damaged(format!("its tables are not those of schema {found}")));
    }
    upgrade(connection, found).map_err(broken)
}

/// The newest version.
pub(super) fn known() -> usize {
    UPGRADES.len()
}

/// The version of a store, derived from its tables and columns, not from its header; `None` if they
/// match no known version.
pub(super) fn version_of(connection: &Connection) -> Option<usize> {
    let found = columns_of(connection).ok()?;
    (1..=UPGRADES.len()).rev().find(|version| {
        let mut made = Connection::open_in_memory();
        let of_version = made.as_mut().ok().and_then(|made| {
            let transaction = made.transaction().ok()?;
            make_version(&transaction, *version).ok()?;
            columns_of(&transaction).ok()
        });
        of_version.is_some_and(|of_version| of_version == found)
    })
}

/// Each table with its columns.
fn columns_of(connection: &Connection) -> Result<Vec<(String, String)>, rusqlite::Error> {
    let sql = "SELECT tables.name, columns.name FROM sqlite_schema AS tables,
        pragma_table_info(tables.name) AS columns
        WHERE tables.type = 'table' AND tables.name NOT LIKE 'sqlite_%' ORDER BY tables.name, columns.cid";
    let mut statement = connection.prepare(sql)?;
    let columns = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    columns.collect()
}

/// Creates the tables of a version in an empty database.
///
/// # Errors
/// Where the database cannot be written.
pub(super) fn make_version(
    transaction: &Transaction<'_>,
    version: usize,
) -> Result<(), rusqlite::Error> {
    for upgrade in &UPGRADES[..version] {
        transaction.execute_batch(upgrade)?;
    }
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.pragma_update(None, "user_version", version as i64)
}

/// The tables, each after the tables that it refers to.
///
/// # Errors
/// Where the schema cannot be read.
pub(super) fn tables_of(connection: &Connection) -> Result<Vec<String>, rusqlite::Error> {
    // A table refers only to older ones; but a table that was recreated comes last by rowid.
    let sql = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'
        ORDER BY name = 'sessions' DESC, name = 'calibrations' DESC, name = 'views' DESC, rowid";
    let mut statement = connection.prepare(sql)?;
    let names = statement.query_map([], |row| row.get(0))?;
    names.collect()
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
    use crate::calibration::sensor::SensorId;
    use crate::imaging::depth_encoding::DepthEncoding;
    use crate::imaging::frame::SensorKind;
    use crate::store::example_tests::{calibration, keep, numbered, record, view, views};
    use crate::store::{Picture, SensorView, Store};

    /// The views of version 6.
    const VIEWS_WITH_UNITS: &str = "INSERT INTO older.views SELECT session, frame_set, camera, sensor, number, sequence,
        name, host_time_ns, device_time_ns, width, height, depth_encoding ->> 'unit_m', detection, media_type, picture,
        NULL, NULL FROM main.views";
    /// The views of version 5.
    const VIEWS_UNCHECKED: &str = "INSERT INTO older.views SELECT session, frame_set, camera, sensor, number, sequence,
        name, host_time_ns, device_time_ns, width, height, depth_encoding ->> 'unit_m', detection, media_type, picture
        FROM main.views";
    /// The views of versions 1 to 4.
    const OLD_VIEWS: &str = "INSERT INTO older.views SELECT session, number, sequence, name, host_time_ns, device_time_ns,
        width, height, detection, media_type, picture FROM main.views WHERE number IS NOT NULL";
    /// The depth and infrared of versions 3 and 4.
    const OLD_AUXILIARY: &str =
        "INSERT INTO older.companions SELECT session, frame_set, sensor, width, height,
        depth_encoding ->> 'unit_m', detection, media_type, picture FROM main.views WHERE number IS NULL";
    /// The rigs of version 4.
    const OLD_RIGS: &str =
        "INSERT INTO older.rig_views SELECT session, number, camera, frame_set FROM main.views
        WHERE camera <> ''";

    /// What a session of a depth camera and one of a rig hold.
    fn held(store: &Store) -> [Vec<SensorView>; 2] {
        ["s1", "s2"].map(|session| store.sensor_views(session).unwrap())
    }

    /// A store at an older version, with sessions, views and a calibration in it.
    fn older_store(folder: &Path, version: usize) -> [Vec<SensorView>; 2] {
        let store = Store::open(folder).unwrap();
        store.begin_session(&record("s1")).unwrap();
        keep(&store, "s1", &view(0), "image/jpeg", b"jpeg").unwrap();
        let picture = Picture { media_type: "image/png".to_owned(), bytes: vec![5; 5] };
        let depth = SensorView {
            number: None,
            depth_encoding: Some(DepthEncoding::metric(0.1 / 3.0)),
            detection: None,
            ..numbered(&view(0), 0, SensorId::own(SensorKind::Depth))
        };
        store.keep_views(&record("s1"), &[(depth, picture.clone())]).unwrap();
        if version >= 4 {
            store.begin_session(&record("s2")).unwrap();
            for (number, camera) in [(0, "left"), (1, "right")] {
                let color = SensorId::of(camera, SensorKind::Color);
                let view = (numbered(&view(number), 7, color), picture.clone());
                store.keep_views(&record("s2"), &[view]).unwrap();
            }
        }
        store.append_calibration(&calibration("c1", 5)).unwrap();
        let held = held(&store);
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
        let tables = [
            ("sessions", "id, camera, state, started_at_ns, collecting_s, document"),
            ("calibrations", "id, camera, session, created_at_ns, document"),
        ];
        for (table, columns) in tables {
            let copy =
                format!("INSERT INTO older.{table} ({columns}) SELECT {columns} FROM main.{table}");
            newest.execute_batch(&copy).unwrap();
        }
        let copies: &[(usize, &str)] = match version {
            6.. => &[(6, VIEWS_WITH_UNITS)],
            5 => &[(5, VIEWS_UNCHECKED)],
            _ => &[(1, OLD_VIEWS), (3, OLD_AUXILIARY), (4, OLD_RIGS)],
        };
        for (_, copy) in copies.iter().filter(|(first, _)| version >= *first) {
            newest.execute_batch(copy).unwrap();
        }
        newest.execute_batch("DETACH older").unwrap();
        drop(newest);
        std::fs::rename(folder.join("older.sqlite"), folder.join("plumb.sqlite")).unwrap();
        let [mut of_camera, of_rig] = held;
        // Before there was depth.
        of_camera.retain(|view| version >= 3 || view.number.is_some());
        [of_camera, of_rig]
    }

    #[test]
    fn every_older_store_is_brought_up_to_date_with_what_it_held() {
        for version in 1..UPGRADES.len() {
            let folder = tempfile::tempdir().unwrap();
            let expected = older_store(folder.path(), version);
            let store = Store::open(folder.path()).unwrap();
            let unfinished = store.unfinished_sessions().unwrap();
            assert_eq!(unfinished[0], record("s1"));
            assert_eq!(views(&store, "s1"), [view(0)]);
            assert_eq!(held(&store), expected, "from version {version}");
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
