//! Which camera of a rig a view is of, as the table of views has it.

use crate::calibration::sensor::SensorId;
use crate::calibration::view::View;
use crate::imaging::frame::SensorKind;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::views::{Picture, SensorView, numbered};

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
    /// As [`Store::append_sensor_views`].
    pub fn append_rig_view(
        &self,
        session_id: &str,
        place: &RigPlace,
        view: &View,
        picture: &Picture,
    ) -> Result<(), StoreError> {
        let view = View { number: place.number, ..view.clone() };
        let sensor = SensorId::of(&place.camera, SensorKind::Color);
        let sensor_view = numbered(&view, place.moment, sensor);
        self.append_sensor_views(session_id, &[(sensor_view, picture.clone())])
    }

    /// Where the views of a rig's session belong, in the order they were kept; nothing for one
    /// camera's session.
    ///
    /// # Errors
    /// [`StoreError::Failed`].
    pub fn rig_places(&self, session_id: &str) -> Result<Vec<RigPlace>, StoreError> {
        let place = |view: SensorView| {
            let (number, camera) = (view.number?, view.sensor.camera?);
            Some(RigPlace { number, camera, moment: view.frame_set })
        };
        let views = self.sensor_views(session_id)?.into_iter();
        let mut places: Vec<RigPlace> = views.filter_map(place).collect();
        places.sort_by_key(|place| place.number);
        Ok(places)
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
