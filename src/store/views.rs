//! The table of kept views, each with its picture.

use rusqlite::{Connection, OptionalExtension, Row, params};

use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;
use crate::document::detection::DetectionDocument;
use crate::geometry::pixel::ImageSize;
use crate::store::error::StoreError;
use crate::store::{Store, json};

/// A kept picture, as it was given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// What `bytes` are, as in `image/jpeg`.
    pub media_type: String,
    /// The encoded picture.
    pub bytes: Vec<u8>,
}

impl Store {
    /// Writes a kept view down with its picture; both are on disk when this returns.
    ///
    /// # Errors
    /// [`StoreError::Failed`], also for a session that was never begun or a number that is taken;
    /// [`StoreError::Unstorable`] for a detection with a number that is none.
    pub fn append_view(
        &self,
        session_id: &str,
        view: &View,
        media_type: &str,
        picture: &[u8],
    ) -> Result<(), StoreError> {
        let insert = insert_view(session_id, view, media_type, picture)?;
        insert(&self.connection()).map_err(|e| self.failed(&e))?;
        Ok(())
    }

    /// The views of a session in the order they were kept; none for a session that is not there.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn views(&self, session_id: &str) -> Result<Vec<View>, StoreError> {
        let rows = || {
            let connection = self.connection();
            let mut statement = connection.prepare(
                "SELECT number, sequence, name, host_time_ns, device_time_ns, width, height, detection
                FROM views WHERE session = ?1 ORDER BY number",
            )?;
            let rows = statement.query_map([session_id], StoredView::from_row)?;
            rows.collect::<Result<Vec<_>, _>>()
        };
        let rows = rows().map_err(|e| self.failed(&e))?;
        rows.into_iter().map(|row| row.into_view(session_id)).collect()
    }

    /// The picture of a session's view.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn picture(&self, session_id: &str, number: u32) -> Result<Option<Picture>, StoreError> {
        let sql = "SELECT media_type, picture FROM views WHERE session = ?1 AND number = ?2";
        self.connection()
            .query_row(sql, params![session_id, number], |row| {
                Ok(Picture { media_type: row.get(0)?, bytes: row.get(1)? })
            })
            .optional()
            .map_err(|e| self.failed(&e))
    }
}

/// What writes a view down, on whatever connection or transaction.
pub(super) fn insert_view<'a>(
    session_id: &'a str,
    view: &'a View,
    media_type: &'a str,
    picture: &'a [u8],
) -> Result<impl Fn(&Connection) -> Result<usize, rusqlite::Error> + 'a, StoreError> {
    let detection = json::write(&DetectionDocument::from(&view.detection), || {
        row_name(session_id, view.number)
    })?;
    let frame = &view.frame;
    Ok(move |connection: &Connection| {
        let row = params![
            session_id,
            view.number,
            // SQLite has no unsigned integers: the bits are kept.
            frame.sequence as i64,
            frame.name,
            frame.host_time_ns,
            frame.device_time_ns,
            frame.image_size.width,
            frame.image_size.height,
            detection,
            media_type,
            picture
        ];
        let sql = "INSERT INTO views (session, number, sequence, name, host_time_ns, device_time_ns, width, height,
            detection, media_type, picture) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)";
        connection.execute(sql, row)
    })
}

fn row_name(session_id: &str, number: u32) -> String {
    format!("view {number} of session {session_id}")
}

struct StoredView {
    number: u32,
    frame: FrameFacts,
    detection: String,
}

impl StoredView {
    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        let frame = FrameFacts {
            sequence: row.get::<_, i64>(1)? as u64,
            name: row.get(2)?,
            host_time_ns: row.get(3)?,
            device_time_ns: row.get(4)?,
            image_size: ImageSize::new(row.get(5)?, row.get(6)?),
        };
        Ok(Self { number: row.get(0)?, frame, detection: row.get(7)? })
    }

    fn into_view(self, session_id: &str) -> Result<View, StoreError> {
        let row = || row_name(session_id, self.number);
        let document: DetectionDocument = json::read(&self.detection, row)?;
        let detection = Detection::try_from(&document);
        let detection =
            detection.map_err(|e| StoreError::Unreadable { row: row(), detail: e.to_string() })?;
        Ok(View { number: self.number, frame: self.frame, detection })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::document::detection::tests::example;
    use crate::store::sessions::tests::record;

    /// A view whose numbers have no short decimals.
    pub(in crate::store) fn view(number: u32) -> View {
        let frame = FrameFacts {
            sequence: u64::MAX - u64::from(number),
            name: (number == 0).then(|| "left01.jpg".to_owned()),
            host_time_ns: 1_770_000_000_123_456_789,
            device_time_ns: Some(i64::MIN),
            image_size: ImageSize::new(640, 480),
        };
        View { number, frame, detection: example() }
    }

    #[test]
    fn views_come_back_to_the_bit_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        {
            let store = Store::open(folder.path()).unwrap();
            store.begin_session(&record("s1")).unwrap();
            store.append_view("s1", &view(0), "image/jpeg", b"first").unwrap();
            store.append_view("s1", &view(1), "image/png", b"second").unwrap();
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.views("s1").unwrap(), [view(0), view(1)]);
        let picture = store.picture("s1", 1).unwrap().unwrap();
        assert_eq!(
            (picture.media_type.as_str(), picture.bytes.as_slice()),
            ("image/png", b"second".as_slice())
        );
        assert_eq!(store.picture("s1", 2).unwrap(), None);
        assert_eq!(store.views("s2").unwrap(), []);
    }

    #[test]
    fn a_process_that_never_closes_loses_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let copy = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.begin_session(&record("s1")).unwrap();
        store.append_view("s1", &view(0), "image/jpeg", b"first").unwrap();
        // The files as a kill would leave them.
        for file in std::fs::read_dir(folder.path()).unwrap() {
            let file = file.unwrap();
            std::fs::copy(file.path(), copy.path().join(file.file_name())).unwrap();
        }
        let found = Store::open(copy.path()).unwrap().unfinished_sessions().unwrap();
        assert_eq!(found, [(record("s1"), vec![view(0)])]);
    }

    #[test]
    fn what_cannot_come_back_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        assert!(matches!(
            store.append_view("s1", &view(0), "image/jpeg", b""),
            Err(StoreError::Failed { .. })
        ));
        store.begin_session(&record("s1")).unwrap();
        let mut nan = view(0);
        nan.detection.corners[0].std_px = f64::NAN;
        assert!(matches!(
            store.append_view("s1", &nan, "image/jpeg", b""),
            Err(StoreError::Unstorable { .. })
        ));
        store.append_view("s1", &view(0), "image/jpeg", b"").unwrap();
        assert!(matches!(
            store.append_view("s1", &view(0), "image/jpeg", b""),
            Err(StoreError::Failed { .. })
        ));
    }
}
