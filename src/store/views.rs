//! The table of views: what each sensor delivered in a frame set that a session kept, with its
//! image.

use rusqlite::{Connection, Row, params};

use crate::calibration::sensor::SensorId;
use crate::calibration::session::KeptView;
use crate::calibration::session_record::SessionRecord;
use crate::calibration::view::{FrameFacts, View};
use crate::detection::board_detection::Detection;
use crate::document::depth_encoding::DepthEncodingDocument;
use crate::document::detection::DetectionDocument;
use crate::geometry::pixel::ImageSize;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::frame::SensorKind;
use crate::store::database::Store;
use crate::store::error::StoreError;
use crate::store::{checksum, json, sessions};

/// A stored image, unchanged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// The format of `bytes`, such as `image/jpeg`.
    pub media_type: String,
    /// The encoded image; a depth image is encoded without loss.
    pub bytes: Vec<u8>,
}

/// What a sensor delivered in a frame set that was kept.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorView {
    /// The frame set; views that were taken together have the same.
    pub frame_set: u32,
    /// The sensor.
    pub sensor: SensorId,
    /// Its number among the session's views, for the sensor in whose images boards are searched;
    /// `None` for the camera's other sensors.
    pub number: Option<u32>,
    /// The frame, with the size of this sensor's image.
    pub frame: FrameFacts,
    /// The encoding of the depth readings, where the device states it.
    pub depth_encoding: Option<DepthEncoding>,
    /// The board in it, where it was found.
    pub detection: Option<Detection>,
}

impl SensorView {
    /// The view of a camera as its session continues with it; `camera` is the camera's place in the
    /// instrument. `None` for a sensor in whose images no board is searched.
    pub fn to_kept(&self, camera: usize) -> Option<(KeptView, View)> {
        let (number, detection) = (self.number?, self.detection.clone()?);
        let kept = KeptView { number, camera, frame_set: self.frame_set, view: 0 };
        Some((kept, View { number, frame: self.frame.clone(), detection }))
    }
}

impl Store {
    /// Stores the views of a frame set that a session keeps, with their images and the session's
    /// new state, all or none; all are on disk when this returns.
    ///
    /// # Errors
    /// [`StoreError::NoRoom`]; [`StoreError::Failed`], also for a number or place that is taken;
    /// [`StoreError::Missing`] for a session that was never stored; [`StoreError::Unstorable`] for
    /// a detection that contains NaN or infinity.
    pub fn keep_views(
        &self,
        record: &SessionRecord,
        views: &[(SensorView, Picture)],
    ) -> Result<(), StoreError> {
        let stored = |(view, _): &(SensorView, Picture)| StoredView::of(&record.id, view);
        let rows = views.iter().map(stored).collect::<Result<Vec<_>, _>>()?;
        let session = sessions::document(record)?;
        self.has_room(views.iter().map(|(_, picture)| picture.bytes.len() as u64).sum())?;
        let mut connection = self.connection();
        let mut insert = || {
            let transaction = connection.transaction()?;
            let updated = sessions::update_session(&transaction, record, &session)?;
            if updated > 0 {
                for ((_, picture), row) in views.iter().zip(&rows) {
                    row.insert(&transaction, picture)?;
                }
                transaction.commit()?;
            }
            Ok(updated)
        };
        self.saved(record, insert())
    }

    /// What every sensor delivered in the frame sets of a session, frame set by frame set, the
    /// sensors with a number first; empty for a session that does not exist. Views that cannot be
    /// read are left out and listed by [`Store::unreadable`].
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn sensor_views(&self, session_id: &str) -> Result<Vec<SensorView>, StoreError> {
        let sql = format!(
            "SELECT {FACTS}, checksum FROM views WHERE session = ?1
            ORDER BY frame_set, number IS NULL, number, camera, sensor"
        );
        let rows = self.select("views", &sql, &[&session_id], StoredView::from_row)?;
        let views = rows.into_iter().map(|row| row.and_then(|row| row.into_view(session_id)));
        Ok(self.readable(views))
    }

    /// The image that a sensor delivered in a session's frame set.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn sensor_picture(
        &self,
        session_id: &str,
        frame_set: u32,
        sensor: &SensorId,
    ) -> Result<Option<Picture>, StoreError> {
        let place = params![session_id, frame_set, camera_column(sensor), sensor.kind.name()];
        self.select_picture("frame_set = ?2 AND camera = ?3 AND sensor = ?4", place)
    }

    /// The image of a session's view.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn picture(&self, session_id: &str, number: u32) -> Result<Option<Picture>, StoreError> {
        self.select_picture("number = ?2", params![session_id, number])
    }

    fn select_picture(
        &self,
        place: &str,
        values: &[&dyn rusqlite::ToSql],
    ) -> Result<Option<Picture>, StoreError> {
        let sql = format!(
            "SELECT media_type, picture, picture_checksum, frame_set, sensor FROM views
            WHERE session = ?1 AND {place}"
        );
        let rows = self.select("views", &sql, values, StoredPicture::from_row)?;
        rows.into_iter().map(|row| row.and_then(StoredPicture::into_picture)).next().transpose()
    }
}

/// The columns of a view without its image.
const FACTS: &str =
    "session, frame_set, camera, sensor, number, sequence, name, host_time_ns, device_time_ns,
    width, height, unit_m, detection, depth_encoding";

struct StoredPicture {
    picture: Picture,
    checksum: Option<u32>,
    row: String,
}

impl StoredPicture {
    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        let (frame_set, sensor): (u32, String) = (row.get(3)?, row.get(4)?);
        Ok(Self {
            picture: Picture { media_type: row.get(0)?, bytes: row.get(1)? },
            checksum: row.get(2)?,
            row: format!("the picture of {sensor} in frame set {frame_set}"),
        })
    }

    fn into_picture(self) -> Result<Picture, StoreError> {
        let Self { picture, checksum, row } = self;
        checksum::check(checksum, picture_checksum(&picture), || row.clone())?;
        Ok(picture)
    }
}

fn picture_checksum(picture: &Picture) -> u32 {
    checksum::of_columns(&[picture.media_type.as_bytes(), &picture.bytes])
}

/// A camera's name as it is stored in its column.
fn camera_column(sensor: &SensorId) -> &str {
    sensor.camera.as_deref().unwrap_or_default()
}

fn row_name(session_id: &str, frame_set: u32, sensor: &str) -> String {
    format!("{sensor} in frame set {frame_set} of session {session_id}")
}

/// A view as it is stored in its columns, without its image.
struct StoredView {
    session: String,
    camera: String,
    sensor: String,
    frame_set: u32,
    number: Option<u32>,
    frame: FrameFacts,
    /// Used instead of `depth_encoding` in rows of older stores.
    unit_m: Option<f64>,
    detection: Option<String>,
    depth_encoding: Option<String>,
    checksum: Option<u32>,
}

impl StoredView {
    fn of(session_id: &str, view: &SensorView) -> Result<Self, StoreError> {
        let sensor = view.sensor.kind.name();
        let row = || row_name(session_id, view.frame_set, sensor);
        let detection = view.detection.as_ref().map(DetectionDocument::from);
        let encoding = view.depth_encoding.as_ref().map(DepthEncodingDocument::from);
        Ok(Self {
            session: session_id.to_owned(),
            camera: camera_column(&view.sensor).to_owned(),
            sensor: sensor.to_owned(),
            frame_set: view.frame_set,
            number: view.number,
            frame: view.frame.clone(),
            unit_m: None,
            detection: detection.map(|document| json::write(&document, row)).transpose()?,
            depth_encoding: encoding.map(|document| json::write(&document, row)).transpose()?,
            checksum: None,
        })
    }

    fn insert(&self, connection: &Connection, picture: &Picture) -> Result<usize, rusqlite::Error> {
        let frame = &self.frame;
        let row = params![
            self.session,
            self.frame_set,
            self.camera,
            self.sensor,
            self.number,
            // SQLite has no unsigned integers: the bits are stored as a signed one.
            frame.sequence as i64,
            frame.name,
            frame.host_time_ns,
            frame.device_time_ns,
            frame.image_size.width,
            frame.image_size.height,
            self.unit_m,
            self.detection,
            self.depth_encoding,
            picture.media_type,
            picture.bytes,
            self.computed_checksum(),
            picture_checksum(picture)
        ];
        let sql = format!(
            "INSERT INTO views ({FACTS}, media_type, picture, checksum, picture_checksum)
            VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18)"
        );
        connection.execute(&sql, row)
    }

    fn from_row(row: &Row<'_>) -> Result<Self, rusqlite::Error> {
        let frame = FrameFacts {
            sequence: row.get::<_, i64>(5)? as u64,
            name: row.get(6)?,
            host_time_ns: row.get(7)?,
            device_time_ns: row.get(8)?,
            image_size: ImageSize::new(row.get(9)?, row.get(10)?),
        };
        Ok(Self {
            session: row.get(0)?,
            frame_set: row.get(1)?,
            camera: row.get(2)?,
            sensor: row.get(3)?,
            number: row.get(4)?,
            frame,
            unit_m: row.get(11)?,
            detection: row.get(12)?,
            depth_encoding: row.get(13)?,
            checksum: row.get(14)?,
        })
    }

    /// The checksum of the columns without the image.
    fn computed_checksum(&self) -> u32 {
        let FrameFacts { sequence, name, host_time_ns, device_time_ns, image_size } = &self.frame;
        let ImageSize { width, height } = image_size;
        let numbers = format!(
            "{} {:?} {sequence} {name:?} {host_time_ns} {device_time_ns:?} {width} {height} {:?}",
            self.frame_set,
            self.number,
            self.unit_m.map(f64::to_bits)
        );
        let detection = self.detection.as_deref().unwrap_or_default();
        let mut texts = vec![&self.session, &self.camera, &self.sensor, &numbers, detection];
        // Rows of older stores do not have it, so their checksums do not include it.
        texts.extend(self.depth_encoding.as_deref());
        let columns: Vec<&[u8]> = texts.into_iter().map(str::as_bytes).collect();
        checksum::of_columns(&columns)
    }

    fn into_view(self, session_id: &str) -> Result<SensorView, StoreError> {
        let computed = self.computed_checksum();
        let Self { camera, sensor, frame_set, number, frame, checksum, .. } = self;
        let row = || row_name(session_id, frame_set, &sensor);
        checksum::check(checksum, computed, row)?;
        let unreadable = |detail: String| StoreError::Unreadable { row: row(), detail };
        let kind = SensorKind::from_name(&sensor)
            .ok_or_else(|| unreadable("no such sensor".to_owned()))?;
        let document: Option<DetectionDocument> =
            self.detection.map(|text| json::read(&text, row)).transpose()?;
        let detection = document.map(|document| Detection::try_from(&document)).transpose();
        let detection = detection.map_err(|e| unreadable(e.to_string()))?;
        let document: Option<DepthEncodingDocument> =
            self.depth_encoding.map(|text| json::read(&text, row)).transpose()?;
        let encoding = document.map(|document| DepthEncoding::try_from(&document)).transpose();
        let depth_encoding = encoding
            .map_err(|e| unreadable(e.to_string()))?
            .or_else(|| self.unit_m.map(DepthEncoding::metric));
        let sensor = SensorId { camera: (!camera.is_empty()).then_some(camera), kind };
        Ok(SensorView { frame_set, sensor, number, frame, depth_encoding, detection })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::example_tests::{keep, numbered, record, view, views};

    #[test]
    fn views_come_back_to_the_bit_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        {
            let store = Store::open(folder.path()).unwrap();
            store.begin_session(&record("s1")).unwrap();
            keep(&store, "s1", &view(0), "image/jpeg", b"first").unwrap();
            keep(&store, "s1", &view(1), "image/png", b"second").unwrap();
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(views(&store, "s1"), [view(0), view(1)]);
        let picture = store.picture("s1", 1).unwrap().unwrap();
        assert_eq!(
            (picture.media_type.as_str(), picture.bytes.as_slice()),
            ("image/png", b"second".as_slice())
        );
        assert_eq!(store.picture("s1", 2).unwrap(), None);
        assert_eq!(views(&store, "s2"), []);
    }

    #[test]
    fn sensors_of_a_frame_set_come_back_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.begin_session(&record("s1")).unwrap();
        let of = |camera: &str, number: u32| {
            let color = numbered(&view(number), 3, SensorId::of(camera, SensorKind::Color));
            let depth = SensorView {
                sensor: SensorId::of(camera, SensorKind::Depth),
                number: None,
                depth_encoding: Some(DepthEncoding::metric(0.1 / 3.0)),
                detection: None,
                ..color.clone()
            };
            [color, depth]
        };
        let picture = |view: SensorView| {
            let bytes = view.sensor.kind.name().as_bytes().to_vec();
            (view, Picture { media_type: "image/png".to_owned(), bytes })
        };
        let (left, right) = (of("left", 0).map(picture), of("right", 1).map(picture));
        store.keep_views(&record("s1"), &left).unwrap();
        store.keep_views(&record("s1"), &right).unwrap();
        let again = [right[1].clone(), left[0].clone()];
        assert!(store.keep_views(&record("s1"), &again).is_err(), "their places are taken");
        let expected = [&left[0], &right[0], &left[1], &right[1]].map(|(view, _)| view.clone());
        assert_eq!(store.sensor_views("s1").unwrap(), expected);
        let (depth, picture) = &right[1];
        let found = store.sensor_picture("s1", 3, &depth.sensor).unwrap();
        assert_eq!(found.as_ref(), Some(picture));
        assert_eq!(store.sensor_picture("s1", 2, &depth.sensor).unwrap(), None);
    }

    #[test]
    fn a_process_that_never_closes_loses_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let copy = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.begin_session(&record("s1")).unwrap();
        keep(&store, "s1", &view(0), "image/jpeg", b"first").unwrap();
        // The files as a kill would leave them.
        for file in std::fs::read_dir(folder.path()).unwrap() {
            let file = file.unwrap();
            std::fs::copy(file.path(), copy.path().join(file.file_name())).unwrap();
        }
        let store = Store::open(copy.path()).unwrap();
        assert_eq!(store.unfinished_sessions().unwrap(), [record("s1")]);
        assert_eq!(views(&store, "s1"), [view(0)]);
    }

    #[test]
    fn what_cannot_come_back_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        assert!(matches!(
            keep(&store, "s1", &view(0), "image/jpeg", b""),
            Err(StoreError::Missing { .. })
        ));
        store.begin_session(&record("s1")).unwrap();
        let mut nan = view(0);
        nan.detection.corners[0].std_px = f64::NAN;
        assert!(matches!(
            keep(&store, "s1", &nan, "image/jpeg", b""),
            Err(StoreError::Unstorable { .. })
        ));
        keep(&store, "s1", &view(0), "image/jpeg", b"").unwrap();
        assert!(matches!(
            keep(&store, "s1", &view(0), "image/jpeg", b""),
            Err(StoreError::Failed { .. })
        ));
    }
}
