//! rosbag2 in SQLite: the tables `topics` and `messages` of a .db3 file.
//!
//! The file is foreign: only plain tables are read, and no value may be longer than the file.

use std::path::Path;

use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};

use crate::recording::RecordingError;
use crate::recording::bag::storage::{
    BagMessage, BagStorage, BagTopic, MessageEncoding, one_type_name,
};
use crate::recording::records::{Broken, LONGEST_RECORD};

/// Room for a row beside its longest value, and for the schema of a small file.
const SMALLEST_LIMIT: u64 = 1 << 20;
/// More topics than any robot has.
const MOST_TOPICS: usize = 65_535;

/// A .db3 file.
pub(super) struct SqliteStorage {
    database: Connection,
    topics: Vec<BagTopic>,
    /// The database's number of each topic.
    topic_ids: Vec<i64>,
    /// The next row after (time, number of the row).
    after: (i64, i64),
    by_time: bool,
}

impl SqliteStorage {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`] for what is no such database.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let damaged = |reason: String| RecordingError::Damaged {
            path: path.to_owned(),
            frame_sets: 0,
            reason,
        };
        let of_sqlite = |error: rusqlite::Error| damaged(in_words(&error));
        let length = std::fs::metadata(path)
            .map_err(|source| RecordingError::Io { path: path.to_owned(), source })?
            .len();
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let database = Connection::open_with_flags(path, flags).map_err(of_sqlite)?;
        let longest = length.clamp(SMALLEST_LIMIT, LONGEST_RECORD) as i32;
        database.set_limit(Limit::SQLITE_LIMIT_LENGTH, longest).map_err(of_sqlite)?;
        if !has_plain_tables(&database).map_err(of_sqlite)? {
            return Err(damaged(
                "it has no tables `topics` and `messages` as rosbag2 writes".into(),
            ));
        }
        let by_time = has_index_by_time(&database).map_err(of_sqlite)?;
        let (topics, topic_ids) = read_topics(&database).map_err(of_sqlite)?;
        Ok(Self { database, topics, topic_ids, after: (i64::MIN, i64::MIN), by_time })
    }

    /// Number, topic and time of the row after the last.
    fn next_row(&self) -> rusqlite::Result<Option<(i64, i64, i64)>> {
        let sql = if self.by_time {
            "SELECT id, topic_id, timestamp FROM messages WHERE (timestamp, id) > (?1, ?2) \
             ORDER BY timestamp, id LIMIT 1"
        } else {
            "SELECT id, topic_id, timestamp FROM messages WHERE id > ?2 AND ?1 IS NOT NULL \
             ORDER BY id LIMIT 1"
        };
        let mut statement = self.database.prepare_cached(sql)?;
        let row = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
        statement.query_row(params![self.after.0, self.after.1], row).optional()
    }

    fn data(&self, id: i64) -> rusqlite::Result<Vec<u8>> {
        let mut statement =
            self.database.prepare_cached("SELECT data FROM messages WHERE id = ?1")?;
        statement.query_row([id], |row| row.get(0))
    }
}

/// Whether both are tables, without columns that are computed: these would be computed as long as
/// their maker likes.
fn has_plain_tables(database: &Connection) -> rusqlite::Result<bool> {
    const TABLES: &str = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' \
        AND name IN ('topics', 'messages') AND sql NOT LIKE 'CREATE VIRTUAL%'";
    const COMPUTED: &str = "SELECT (SELECT count(*) FROM pragma_table_xinfo('messages') WHERE hidden <> 0) \
        + (SELECT count(*) FROM pragma_table_xinfo('topics') WHERE hidden <> 0)";
    let tables: i64 = database.query_row(TABLES, [], |row| row.get(0))?;
    let computed: i64 = database.query_row(COMPUTED, [], |row| row.get(0))?;
    Ok(tables == 2 && computed == 0)
}

/// Whether rows can be found by their time without reading them all.
fn has_index_by_time(database: &Connection) -> rusqlite::Result<bool> {
    const INDEXES: &str = "SELECT count(*) FROM pragma_index_list('messages') AS list, \
        pragma_index_info(list.name) AS info WHERE info.seqno = 0 AND info.name = 'timestamp' \
        AND list.partial = 0";
    database.query_row(INDEXES, [], |row| row.get::<_, i64>(0)).map(|indexes| indexes > 0)
}

fn read_topics(database: &Connection) -> rusqlite::Result<(Vec<BagTopic>, Vec<i64>)> {
    let (mut topics, mut ids) = (Vec::new(), Vec::new());
    let mut statement =
        database.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        let (message_type, format): (String, String) = (row.get(2)?, row.get(3)?);
        if format == "cdr" && topics.len() < MOST_TOPICS {
            ids.push(row.get(0)?);
            let (name, message_type) = (row.get(1)?, one_type_name(&message_type));
            topics.push(BagTopic { name, message_type, layout: MessageEncoding::Cdr });
        }
    }
    Ok((topics, ids))
}

impl BagStorage for SqliteStorage {
    fn topics(&self) -> &[BagTopic] {
        &self.topics
    }

    fn next_message(&mut self, wanted: &[bool]) -> Result<Option<BagMessage>, Broken> {
        let damaged = |error: rusqlite::Error| Broken::Damaged(in_words(&error));
        while let Some((id, topic_id, log_time_ns)) = self.next_row().map_err(damaged)? {
            if (log_time_ns, id) <= self.after && self.by_time
                || id <= self.after.1 && !self.by_time
            {
                return Err(Broken::Damaged("its index contradicts its rows".into()));
            }
            self.after = (log_time_ns, id);
            let topic = self.topic_ids.iter().position(|known| *known == topic_id);
            if let Some(topic) = topic.filter(|topic| wanted.get(*topic) == Some(&true)) {
                let bytes = self.data(id).map_err(damaged)?;
                return Ok(Some(BagMessage { topic, log_time_ns, bytes }));
            }
        }
        Ok(None)
    }

    fn rewind(&mut self) -> Result<(), Broken> {
        self.after = (i64::MIN, i64::MIN);
        Ok(())
    }
}

fn in_words(error: &rusqlite::Error) -> String {
    let words = match error {
        rusqlite::Error::SqliteFailure(code, Some(words)) => format!("SQLite says {words}, {code}"),
        other => format!("SQLite says {other}"),
    };
    words.lines().next().unwrap_or_default().chars().take(200).collect()
}
