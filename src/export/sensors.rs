//! The sensors of a calibration, as formats hold them.

use crate::calibration::calibration::{Calibration, SensorCalibration};
use crate::export::{ExportError, Format};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// A sensor with its lens.
#[derive(Debug, Clone)]
pub(super) struct Sensor<'a> {
    /// `color`, `infrared`, `infrared2`, `depth`, or the name of a rig's camera.
    pub name: &'a str,
    /// Whether `name` is a camera's own.
    pub is_camera: bool,
    pub image_size: ImageSize,
    pub lens: &'a Lens,
    /// Reprojection error, where there are pictures.
    pub rms_px: Option<f64>,
    /// Where it is in the first sensor's frame, where that is known.
    pub first_from_sensor: Option<Pose>,
}

impl Sensor<'_> {
    /// What other programs call it: the camera's name for its color picture, and for a rig's
    /// camera its own.
    pub fn frame_name(&self, camera: &str) -> String {
        match self.name {
            name if self.is_camera => name.to_owned(),
            "color" => camera.to_owned(),
            name => format!("{camera}_{name}"),
        }
    }

    /// The ROS name of its optical frame (REP 103: x right, y down, z forward).
    pub fn optical_frame(&self, camera: &str) -> String {
        let name = self.name;
        if self.is_camera {
            format!("{name}_optical_frame")
        } else {
            format!("{camera}_{name}_optical_frame")
        }
    }

    /// The topic that Plumb's recordings have it on.
    pub fn topic(&self, camera: &str) -> String {
        let name = self.name;
        if self.is_camera { format!("/{name}/color") } else { format!("/{camera}/{name}") }
    }
}

/// Every sensor, in the order of documents.
pub(super) fn all(calibration: &Calibration) -> Vec<Sensor<'_>> {
    let place = |name: &str| match first_name(calibration) {
        Some(first) if first == name => Some(Pose::identity()),
        Some(first) => {
            let wanted = format!("{first}_from_{name}");
            calibration
                .extrinsics
                .iter()
                .find(|known| known.name == wanted)
                .map(|known| known.target_from_source)
        }
        None => None,
    };
    let picture = |(name, sensor): (&'_ str, &SensorCalibration)| {
        (sensor.image_size, Some(sensor.rms_px), place(name))
    };
    let mut sensors: Vec<Sensor<'_>> = Vec::new();
    for (name, sensor) in calibration.picture_sensors() {
        let (image_size, rms_px, first_from_sensor) = picture((name, sensor));
        let is_camera = calibration.cameras.iter().any(|camera| camera.name == name);
        sensors.push(Sensor {
            name,
            is_camera,
            image_size,
            lens: &sensor.lens,
            rms_px,
            first_from_sensor,
        });
    }
    if let Some(depth) = &calibration.depth {
        let (image_size, lens) = (depth.camera.image_size, &depth.camera.lens);
        let first_from_sensor = place("depth");
        sensors.push(Sensor {
            name: "depth",
            is_camera: false,
            image_size,
            lens,
            rms_px: None,
            first_from_sensor,
        });
    }
    sensors
}

fn first_name(calibration: &Calibration) -> Option<&str> {
    calibration.picture_sensors().next().map(|(name, _)| name)
}

/// The sensors with pictures.
pub(super) fn pictures(calibration: &Calibration) -> Vec<Sensor<'_>> {
    all(calibration).into_iter().filter(|sensor| sensor.rms_px.is_some()).collect()
}

/// The sensor that is asked for, or the only one, or color's; with what is left out, where nothing
/// was asked for.
pub(super) fn one_sensor<'a>(
    calibration: &'a Calibration,
    format: Format,
    asked: Option<&str>,
) -> Result<(Sensor<'a>, Option<String>), ExportError> {
    let sensors = all(calibration);
    let known = || sensors.iter().map(|sensor| sensor.name).collect::<Vec<_>>().join(", ");
    if let Some(asked) = asked {
        let found = sensors.iter().find(|sensor| sensor.name == asked).cloned();
        let unknown = || ExportError::UnknownSensor { sensor: asked.to_owned(), known: known() };
        return found.map(|sensor| (sensor, None)).ok_or_else(unknown);
    }
    match sensors.as_slice() {
        [] => Err(ExportError::NoSensor { format }),
        [only] if only.rms_px.is_some() => Ok((only.clone(), None)),
        several => {
            match several.iter().find(|sensor| sensor.name == "color" && !sensor.is_camera) {
                Some(color) => {
                    let note = format!(
                        "this is the color sensor of several ({}): ask for the others by name, and for where they are by the format urdf or tf",
                        known()
                    );
                    Ok((color.clone(), Some(note)))
                }
                None if several.iter().all(|sensor| sensor.rms_px.is_none()) => {
                    Err(ExportError::NoSensor { format })
                }
                None => Err(ExportError::SeveralSensors { format, known: known() }),
            }
        }
    }
}

/// The sensors whose places are known, the first of them first, and which are left out.
pub(super) fn placed_sensors(
    calibration: &Calibration,
    format: Format,
) -> Result<(Vec<Sensor<'_>>, Option<String>), ExportError> {
    let (placed, open): (Vec<_>, Vec<_>) =
        all(calibration).into_iter().partition(|sensor| sensor.first_from_sensor.is_some());
    if placed.len() < 2 {
        return Err(ExportError::NoPlaces { format });
    }
    let names = open.iter().map(|sensor| sensor.name).collect::<Vec<_>>().join(", ");
    let note =
        format!("left out, because where it is against {} is not known: {names}", placed[0].name);
    Ok((placed, (!open.is_empty()).then_some(note)))
}
