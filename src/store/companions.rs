//! The table of what a view's other sensors gave at the same moment.

use rusqlite::{Row, params};

use crate::detection::board_detection::Detection;
use crate::document::detection::DetectionDocument;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;
use crate::store::error::StoreError;
use crate::store::views::Picture;
use crate::store::{Store, json};

/// What another sensor gave together with a kept view.
#[derive(Debug, Clone, PartialEq)]
pub struct Companion {
    /// The view's number in its session.
    pub number: u32,
    /// Which sensor.
    pub sensor: SensorKind,
    /// The size of its picture.
    pub image_size: ImageSize,
    /// Metres per unit of depth, where the device states it.
    pub unit_m: Option<f64>,
    /// The board in it, where it was found.
    pub detection: Option<Detection>,
    /// The picture, without loss for depth.
    pub picture: Picture,
}

impl Store {
    /// Writes down what other sensors gave together with views that are stored already, all or
    /// none.
    ///
    /// # Errors
    /// [`StoreError::Failed`], also for a view that is not there; [`StoreError::Unstorable`] for a
    /// detection with a number that is none.
    pub fn append_companions(
        &self,
        session_id: &str,
        companions: &[Companion],
    ) -> Result<(), StoreError> {
        let stored = |companion: &Companion| {
            let detection = companion.detection.as_ref().map(DetectionDocument::from);
            detection
                .map(|detection| json::write(&detection, || row_name(session_id, companion)))
                .transpose()
        };
        let detections = companions.iter().map(stored).collect::<Result<Vec<_>, _>>()?;
        let mut connection = self.connection();
        let insert = || {
            let transaction = connection.transaction()?;
            for (companion, detection) in companions.iter().zip(&detections) {
                let Companion { number, sensor, image_size, unit_m, picture, .. } = companion;
                let row = params![
                    session_id,
                    number,
                    sensor.name(),
                    image_size.width,
                    image_size.height,
                    unit_m,
                    detection,
                    picture.media_type,
                    picture.bytes
                ];
                let sql =
                    "INSERT INTO companions (session, number, sensor, width, height, unit_m, detection, media_type,
                    picture) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)";
                transaction.execute(sql, row)?;
            }
            transaction.commit()
        };
        let inserted: Result<(), rusqlite::Error> = { insert }();
        inserted.map_err(|e| self.failed(&e))
    }

    /// What other sensors gave together with a session's views, view by view; nothing for a camera
    /// with one sensor.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn companions(&self, session_id: &str) -> Result<Vec<Companion>, StoreError> {
        let rows = || {
            let connection = self.connection();
            let mut statement = connection.prepare(
                "SELECT number, sensor, width, height, unit_m, detection, media_type, picture
                FROM companions WHERE session = ?1 ORDER BY number, sensor",
            )?;
            let rows = statement.query_map([session_id], StoredCompanion::from_row)?;
            rows.collect::<Result<Vec<_>, _>>()
        };
        let rows = rows().map_err(|e| self.failed(&e))?;
        rows.into_iter().map(|row| row.into_companion(session_id)).collect()
    }
}

fn row_name(session_id: &str, companion: &Companion) -> String {
    format!("{} of view {} of session {session_id}", companion.sensor.name(), companion.number)
}

struct StoredCompanion {
    number: u32,
    sensor: String,
    image_size: ImageSize,
    unit_m: Option<f64>,
    detection: Option<String>,
    picture: Picture,
}

impl StoredCompanion {
    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        Ok(Self {
            number: row.get(0)?,
            sensor: row.get(1)?,
            image_size: ImageSize::new(row.get(2)?, row.get(3)?),
            unit_m: row.get(4)?,
            detection: row.get(5)?,
            picture: Picture { media_type: row.get(6)?, bytes: row.get(7)? },
        })
    }

    fn into_companion(self, session_id: &str) -> Result<Companion, StoreError> {
        let Self { number, sensor, image_size, unit_m, detection, picture } = self;
        let row = || format!("{sensor} of view {number} of session {session_id}");
        let unreadable = |detail: String| StoreError::Unreadable { row: row(), detail };
        let kind = SensorKind::from_name(&sensor)
            .ok_or_else(|| unreadable("no such sensor".to_owned()))?;
        let document: Option<DetectionDocument> =
            detection.map(|text| json::read(&text, row)).transpose()?;
        let detection = document.map(|document| Detection::try_from(&document)).transpose();
        let detection = detection.map_err(|e| unreadable(e.to_string()))?;
        Ok(Companion { number, sensor: kind, image_size, unit_m, detection, picture })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::detection::tests::example;
    use crate::store::sessions::tests::record;
    use crate::store::views::tests::view;

    fn companion(number: u32, sensor: SensorKind, detection: Option<Detection>) -> Companion {
        let picture = Picture { media_type: "image/png".to_owned(), bytes: vec![number as u8; 5] };
        Companion {
            number,
            sensor,
            image_size: ImageSize::new(64, 48),
            unit_m: Some(0.1 / 3.0),
            detection,
            picture,
        }
    }

    #[test]
    fn companions_come_back_to_the_bit_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let first = [
            companion(0, SensorKind::Depth, None),
            companion(0, SensorKind::Infrared, Some(example())),
        ];
        let second = [companion(1, SensorKind::Depth, None)];
        {
            let store = Store::open(folder.path()).unwrap();
            store.begin_session(&record("s1")).unwrap();
            store.append_view("s1", &view(0), "image/jpeg", b"first").unwrap();
            store.append_view("s1", &view(1), "image/jpeg", b"second").unwrap();
            store.append_companions("s1", &first).unwrap();
            store.append_companions("s1", &second).unwrap();
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.companions("s1").unwrap(), [first.to_vec(), second.to_vec()].concat());
        assert_eq!(store.companions("s2").unwrap(), []);
    }

    #[test]
    fn a_companion_of_no_view_is_refused_with_its_neighbors() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.begin_session(&record("s1")).unwrap();
        store.append_view("s1", &view(0), "image/jpeg", b"first").unwrap();
        let companions =
            [companion(0, SensorKind::Depth, None), companion(7, SensorKind::Depth, None)];
        assert!(matches!(
            store.append_companions("s1", &companions),
            Err(StoreError::Failed { .. })
        ));
        assert_eq!(store.companions("s1").unwrap(), []);
    }
}
