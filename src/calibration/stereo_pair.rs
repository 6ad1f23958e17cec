//! Two cameras of a calibration as a stereo pair.

use crate::calibration::result::Calibration;
use crate::calibration::sensor::SensorId;
use crate::geometry::pose::Pose;
use crate::geometry::rectification::{RectificationError, StereoCamera, StereoRectification};
use crate::imaging::frame::SensorKind;

/// Two image sensors with a known relative pose.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoPair {
    /// Which.
    pub sensors: [SensorId; 2],
    /// Their names in documents.
    pub names: [String; 2],
    /// Their lenses and image sizes.
    pub cameras: [StereoCamera; 2],
    /// The pose of the first in the frame of the second.
    pub second_from_first: Pose,
}

/// Why a calibration gives no stereo pair.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StereoPairError {
    /// It is not clear which two are meant.
    #[error("stereo needs two cameras, and this calibration has {known}{}", if *several { ": say which two, as FIRST,SECOND" } else { "" })]
    NotTwo {
        /// The calibration's image sensors.
        known: String,
        /// Whether there are two or more.
        several: bool,
    },
    /// There is no such sensor.
    #[error("this calibration has no image sensor `{sensor}`: it has {known}")]
    Unknown {
        /// What was asked for.
        sensor: String,
        /// The calibration's image sensors.
        known: String,
    },
    /// Their relative pose is not known.
    #[error(
        "this calibration has no relative pose of `{second}` and `{first}`: calibrate them together as a rig"
    )]
    NoPose {
        /// The first sensor.
        first: String,
        /// The second.
        second: String,
    },
    /// The pair cannot be rectified.
    #[error(transparent)]
    Rectification(#[from] RectificationError),
}

impl StereoPair {
    /// The pair that is `asked` for by the names of two sensors or cameras; otherwise the two
    /// cameras of a rig of two, or the two infrared sensors of a camera.
    ///
    /// # Errors
    /// [`StereoPairError`].
    pub fn of(
        calibration: &Calibration,
        asked: Option<[&str; 2]>,
    ) -> Result<Self, StereoPairError> {
        let sensors = match asked {
            Some(names) => {
                let [first, second] = names.map(|name| named(calibration, name));
                [first?, second?]
            }
            None => own_pair(calibration).ok_or_else(|| StereoPairError::NotTwo {
                known: known(calibration),
                several: calibration.image_sensors().count() > 1,
            })?,
        };
        let names = sensors.each_ref().map(|id| calibration.name_of(id));
        let [first, second] = &sensors;
        let pose = calibration.relative_pose(second, first).filter(|_| first != second);
        let second_from_first = pose.ok_or_else(|| StereoPairError::NoPose {
            first: names[0].clone(),
            second: names[1].clone(),
        })?;
        let camera = |id: &SensorId| {
            let image = calibration.sensor(id)?.as_image()?;
            Some(StereoCamera { lens: image.lens, image_size: image.image_size })
        };
        let cameras = camera(first)
            .zip(camera(second))
            .ok_or_else(|| StereoPairError::NotTwo { known: known(calibration), several: false })?;
        Ok(Self { sensors, names, cameras: cameras.into(), second_from_first })
    }

    /// Its rectification; see [`StereoRectification::new`].
    ///
    /// # Errors
    /// [`RectificationError`].
    pub fn rectify(&self, alpha: f64) -> Result<StereoRectification, RectificationError> {
        StereoRectification::new(&self.cameras, &self.second_from_first, alpha)
    }

    /// The same with the left (or the upper) camera first, as other programs expect it, together
    /// with its rectification.
    ///
    /// # Errors
    /// [`RectificationError`].
    pub fn left_first(self, alpha: f64) -> Result<(Self, StereoRectification), RectificationError> {
        let stereo = self.rectify(alpha)?;
        if stereo.second_from_first_m < 0.0 {
            return Ok((self, stereo));
        }
        let Self { sensors: [a, b], names: [c, d], cameras: [e, f], second_from_first } = self;
        let exchanged = Self {
            sensors: [b, a],
            names: [d, c],
            cameras: [f, e],
            second_from_first: second_from_first.inverse(),
        };
        let stereo = exchanged.rectify(alpha)?;
        Ok((exchanged, stereo))
    }
}

/// The two cameras of a rig of two, each by its first image sensor; or a camera's two infrared
/// ones.
fn own_pair(calibration: &Calibration) -> Option<[SensorId; 2]> {
    let mut guides: Vec<&SensorId> = Vec::new();
    for (id, _) in calibration.image_sensors() {
        if !guides.iter().any(|other| other.camera == id.camera) {
            guides.push(id);
        }
    }
    match guides.as_slice() {
        [first, second] => Some([(*first).clone(), (*second).clone()]),
        [_] => {
            let infrared = SensorKind::STEREO_PAIR.map(SensorId::own);
            infrared.iter().all(|id| calibration.sensor(id).is_some()).then_some(infrared)
        }
        _ => None,
    }
}

/// The sensor of this name, or the first of the camera of this name.
fn named(calibration: &Calibration, name: &str) -> Result<SensorId, StereoPairError> {
    let mut ids = calibration.image_sensors().map(|(id, _)| id);
    let is_named =
        |id: &&SensorId| calibration.name_of(id) == name || id.camera.as_deref() == Some(name);
    ids.find(is_named).cloned().ok_or_else(|| StereoPairError::Unknown {
        sensor: name.to_owned(),
        known: known(calibration),
    })
}

fn known(calibration: &Calibration) -> String {
    let names: Vec<String> =
        calibration.image_sensors().map(|(id, _)| calibration.name_of(id)).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}
