//! The table that says which camera of a rig a view is of.

use rusqlite::params;

use crate::calibration::view::View;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::views::{Picture, insert_view};

/// Where a view of a rig's session belongs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigPlace {
    /// The view's number in its session.
    pub number: u32,
    /// The camera.
    pub camera: String,
    /// The moment; views of the same one were seen together.
    pub moment: u32,
}

impl Store {
    /// Writes a kept view of a rig down with its picture and its place, all or none; `view.number`
    /// is the place's.
    ///
    /// # Errors
    /// As [`Store::append_view`].
    pub fn append_rig_view(
        &self,
        session_id: &str,
        place: &RigPlace,
        view: &View,
        picture: &Picture,
    ) -> Result<(), StoreError> {
        let view = View { number: place.number, ..view.clone() };
        let insert = insert_view(session_id, &view, &picture.media_type, &picture.bytes)?;
        let mut connection = self.connection();
        let mut write = || {
            let transaction = connection.transaction()?;
            insert(&transaction)?;
            let sql =
                "INSERT INTO rig_views (session, number, camera, moment) VALUES (?1, ?2, ?3, ?4)";
            transaction
                .execute(sql, params![session_id, place.number, place.camera, place.moment])?;
            transaction.commit()
        };
        write().map_err(|e| self.failed(&e))
    }

    /// Where the views of a rig's session belong, in the order they were kept; nothing for one
    /// camera's session.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn rig_places(&self, session_id: &str) -> Result<Vec<RigPlace>, StoreError> {
        let rows = || {
            let connection = self.connection();
            let mut statement = connection.prepare(
                "SELECT number, camera, moment FROM rig_views WHERE session = ?1 ORDER BY number",
            )?;
            let place = |row: &rusqlite::Row<'_>| {
                Ok(RigPlace { number: row.get(0)?, camera: row.get(1)?, moment: row.get(2)? })
            };
            statement.query_map([session_id], place)?.collect::<Result<Vec<_>, _>>()
        };
        rows().map_err(|e| self.failed(&e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::sessions::tests::record;
    use crate::store::views::tests::view;

    #[test]
    fn a_rig_s_views_come_back_with_their_places() {
        let folder = tempfile::tempdir().unwrap();
        let picture = Picture { media_type: "image/jpeg".into(), bytes: b"jpeg".to_vec() };
        let places = ["left", "right"].map(|camera| RigPlace {
            number: u32::from(camera == "right"),
            camera: camera.into(),
            moment: 3,
        });
        {
            let store = Store::open(folder.path()).unwrap();
            store.begin_session(&record("s1")).unwrap();
            for place in &places {
                store.append_rig_view("s1", place, &view(0), &picture).unwrap();
            }
            assert!(
                store.append_rig_view("s1", &places[0], &view(0), &picture).is_err(),
                "the number is taken"
            );
        }
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.rig_places("s1").unwrap(), places);
        assert_eq!(store.views("s1").unwrap(), [view(0), View { number: 1, ..view(0) }]);
        assert_eq!(store.picture("s1", 1).unwrap(), Some(picture));
        assert_eq!(store.rig_places("s2").unwrap(), []);
    }
}
