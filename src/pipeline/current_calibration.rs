//! A current calibration, a camera's own or that of a rig it is in, held against the images that
//! the camera gives now.

use std::collections::BTreeMap;

use crate::calibration::drift::Drift;
use crate::calibration::provenance::Provenance;
use crate::calibration::sensor::SensorId;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, SensorKind};
use crate::store::Store;
use crate::store::error::StoreError;

/// What is known of the images that come now.
#[derive(Debug, Default)]
pub(super) struct ImagesNow {
    /// What has moved since a session held it.
    pub(super) moved: Option<String>,
    /// The size of each sensor's images; a sensor may be missing from a frame set.
    pub(super) sizes: BTreeMap<SensorKind, ImageSize>,
}

impl ImagesNow {
    /// Takes in a frame set's sizes; whether a sensor has another one now. A frame that could not
    /// be read has none.
    pub(super) fn take_sizes(&mut self, frames: &[Frame]) -> bool {
        let mut resized = false;
        for Frame { sensor, size, .. } in frames {
            if size.width > 0 && size.height > 0 {
                resized |= self.sizes.insert(*sensor, *size) != Some(*size);
            }
        }
        resized
    }
}

/// A current calibration, as far as it concerns one camera.
#[derive(Debug)]
pub(super) struct CurrentCalibration {
    /// Of the camera or of a rig: its name.
    instrument: String,
    /// What to call it.
    name: String,
    id: String,
    rms_px: f64,
    provenance: Provenance,
    /// What was said last of the images that come now.
    said: Option<String>,
}

impl CurrentCalibration {
    /// That of `camera`, or of the rig `instrument`, with this `id`; `None` where it cannot be
    /// read.
    pub(super) fn read(store: &Store, id: &str, instrument: &str, camera: &str) -> Option<Self> {
        let read = || -> Result<Option<Self>, StoreError> {
            let Some(calibration) = store.calibration(id)? else { return Ok(None) };
            let session = calibration.session.as_ref();
            let record = session.map_or(Ok(None), |session| store.session(session))?;
            let mut sensors = calibration.image_sensors();
            let own = |id: &SensorId| id.camera.as_ref().is_none_or(|of| *of == *camera);
            let Some((_, sensor)) = sensors.find(|(id, _)| own(id)) else { return Ok(None) };
            let name = match instrument == camera {
                true => "the calibration".to_owned(),
                false => format!("the calibration of rig `{instrument}`"),
            };
            Ok(Some(Self {
                instrument: instrument.to_owned(),
                name,
                id: id.to_owned(),
                rms_px: sensor.rms_px,
                provenance: Provenance::of(&calibration, camera, record.as_ref()),
                said: None,
            }))
        };
        read().unwrap_or_else(|error| {
            tracing::error!(calibration = id, "which images it is of is not known: {error}");
            None
        })
    }

    /// The camera or the rig that it is of.
    pub(super) fn instrument(&self) -> &str {
        &self.instrument
    }

    /// Why it may not hold for the images that were compared last.
    pub(super) fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    /// Why it may not hold for images of `now`; and the same as drift where it was not said yet.
    pub(super) fn change(&mut self, now: &Provenance) -> (Option<String>, Option<Drift>) {
        let change = self.provenance.change(now, &self.name);
        let is_new = change != self.said;
        self.said.clone_from(&change);
        let drift = change.clone().filter(|_| is_new).map(|reason| Drift {
            calibration: self.id.clone(),
            reason,
            rms_px: None,
            expected_px: self.rms_px,
        });
        (change, drift)
    }
}
