//! A current calibration, of a camera itself or of a rig that it is in, compared with the images
//! that the camera delivers now.

use std::collections::BTreeMap;

use crate::calibration::drift::Drift;
use crate::calibration::provenance::Provenance;
use crate::calibration::sensor::SensorId;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::{Frame, SensorKind};
use crate::store::Store;
use crate::store::error::StoreError;

/// What is known about the present images.
#[derive(Debug, Default)]
pub(super) struct ImagesNow {
    /// Which setting has changed since a session fixed it.
    pub(super) moved: Option<String>,
    /// The size of each sensor's images; a sensor may be missing from a frame set.
    pub(super) sizes: BTreeMap<SensorKind, ImageSize>,
}

impl ImagesNow {
    /// Records the sizes in a frame set. Returns whether the size of a sensor changed. A frame that
    /// could not be read has none.
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

/// A current calibration, as far as one camera needs it.
#[derive(Debug)]
pub(super) struct CurrentCalibration {
    /// The name of the camera or rig that it is of.
    instrument: String,
    /// How it is called in messages.
    name: String,
    id: String,
    rms_px: f64,
    provenance: Provenance,
    /// The result of the last comparison with the images.
    said: Option<String>,
}

impl CurrentCalibration {
    /// The calibration `id` of `camera`, or of the rig `instrument`; `None` where it cannot be
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

    /// Why it may not be valid for the images that were compared last.
    pub(super) fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    /// Why it may not be valid for images of `now`; and the same as drift if it was not reported
    /// yet.
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
