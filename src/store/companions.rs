//! What a view's other sensors gave in its frame set, as rows of the table of views.

use crate::calibration::sensor::SensorId;
use crate::calibration::view::FrameFacts;
use crate::detection::board_detection::Detection;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::views::{Picture, SensorView};

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
    /// Writes down what other sensors of an instrument that is one camera gave together with views
    /// that are stored already, all or none.
    ///
    /// # Errors
    /// [`StoreError::Missing`] for a view that is not there; [`StoreError::Failed`], [`StoreError::Unstorable`] for a
    /// detection with a number that is none.
    pub fn append_companions(
        &self,
        session_id: &str,
        companions: &[Companion],
    ) -> Result<(), StoreError> {
        let numbered = self.sensor_views(session_id)?;
        let with_view = |companion: &Companion| {
            let view = numbered.iter().find(|view| view.number == Some(companion.number));
            let row = || format!("view {} of session {session_id}", companion.number);
            let view = view.ok_or_else(|| StoreError::Missing { row: row() })?;
            let sensor_view = SensorView {
                frame_set: view.frame_set,
                sensor: SensorId { kind: companion.sensor, ..view.sensor.clone() },
                number: None,
                frame: FrameFacts { image_size: companion.image_size, ..view.frame.clone() },
                unit_m: companion.unit_m,
                detection: companion.detection.clone(),
            };
            Ok((sensor_view, companion.picture.clone()))
        };
        let views = companions.iter().map(with_view).collect::<Result<Vec<_>, _>>()?;
        self.append_sensor_views(session_id, &views)
    }

    /// What other sensors gave together with a session's views, view by view; nothing for a camera
    /// with one sensor.
    ///
    /// # Errors
    /// [`StoreError::Failed`], [`StoreError::Unreadable`].
    pub fn companions(&self, session_id: &str) -> Result<Vec<Companion>, StoreError> {
        let views = self.sensor_views(session_id)?;
        let companion = |view: &SensorView| {
            let of_camera = |other: &&SensorView| {
                other.frame_set == view.frame_set && other.sensor.camera == view.sensor.camera
            };
            let number = views.iter().filter(of_camera).find_map(|other| other.number)?;
            Some(self.sensor_picture(session_id, view.frame_set, &view.sensor).map(|picture| {
                Some(Companion {
                    number,
                    sensor: view.sensor.kind,
                    image_size: view.frame.image_size,
                    unit_m: view.unit_m,
                    detection: view.detection.clone(),
                    picture: picture?,
                })
            }))
        };
        let others = views.iter().filter(|view| view.number.is_none());
        others.filter_map(companion).filter_map(Result::transpose).collect()
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
            Err(StoreError::Missing { .. })
        ));
        assert_eq!(store.companions("s1").unwrap(), []);
    }
}
