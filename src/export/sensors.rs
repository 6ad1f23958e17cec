//! The sensors of a calibration, as formats hold them.

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::result::{CalibratedSensor, Calibration, SensorResult};
use crate::calibration::sensor::SensorId;
use crate::export::{ExportError, Format};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

/// A sensor with its lens.
#[derive(Debug, Clone)]
pub(super) struct Sensor<'a> {
    pub id: &'a SensorId,
    /// What documents call it.
    pub name: String,
    /// Whether it is its camera's only one in a rig, and goes by the camera's name.
    pub is_camera: bool,
    pub image_size: ImageSize,
    pub lens: &'a Lens,
    /// Reprojection error, of an image sensor.
    pub rms_px: Option<f64>,
    /// What is known of its readings, of a depth sensor.
    pub depth: Option<&'a DepthCalibration>,
    /// Where it is in the first sensor's frame, where that is known.
    pub first_from_sensor: Option<Pose>,
}

impl Sensor<'_> {
    /// The camera that it is of; `camera` is the instrument's name.
    fn camera<'a>(&'a self, camera: &'a str) -> &'a str {
        self.id.camera.as_deref().unwrap_or(camera)
    }

    /// What other programs call it: the camera's name for its color image, and for a camera with
    /// one sensor in a rig.
    pub fn frame_name(&self, camera: &str) -> String {
        let camera = self.camera(camera);
        match self.id.kind {
            _ if self.is_camera => camera.to_owned(),
            SensorKind::Color => camera.to_owned(),
            kind => format!("{camera}_{}", kind.name()),
        }
    }

    /// The ROS name of its optical frame (REP 103: x right, y down, z forward).
    pub fn optical_frame(&self, camera: &str) -> String {
        self.id.kind.optical_frame(self.camera(camera))
    }

    /// The topic that Plumb's recordings have it on.
    pub fn topic(&self, camera: &str) -> String {
        format!("/{}/{}", self.camera(camera), self.id.kind.name())
    }
}

/// Every sensor, in the order of documents.
pub(super) fn all(calibration: &Calibration) -> Vec<Sensor<'_>> {
    let first = calibration.image_sensors().next().map(|(id, _)| id);
    let place = |id: &SensorId| match first {
        Some(first) if first == id => Some(Pose::identity()),
        Some(first) => calibration.pose(first, id).map(|known| known.target_from_source),
        None => None,
    };
    let one_each = calibration.has_one_sensor_each();
    fn held(
        sensor: &CalibratedSensor,
    ) -> (ImageSize, &Lens, Option<f64>, Option<&DepthCalibration>) {
        match &sensor.result {
            SensorResult::Image(image) => (image.image_size, &image.lens, Some(image.rms_px), None),
            SensorResult::Depth(depth) => {
                (depth.camera.image_size, &depth.camera.lens, None, Some(depth))
            }
        }
    }
    let each = calibration.sensors.iter().map(|sensor| {
        let (image_size, lens, rms_px, depth) = held(sensor);
        Sensor {
            id: &sensor.id,
            name: calibration.name_of(&sensor.id),
            is_camera: one_each && sensor.id.camera.is_some(),
            image_size,
            lens,
            rms_px,
            depth,
            first_from_sensor: place(&sensor.id),
        }
    });
    each.collect()
}

/// The image sensors.
pub(super) fn images(calibration: &Calibration) -> Vec<Sensor<'_>> {
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
    let known = || names(&sensors);
    if let Some(asked) = asked {
        let found = sensors.iter().find(|sensor| sensor.name == asked).cloned();
        let unknown = || ExportError::UnknownSensor { sensor: asked.to_owned(), known: known() };
        return found.map(|sensor| (sensor, None)).ok_or_else(unknown);
    }
    match sensors.as_slice() {
        [] => Err(ExportError::NoSensor { format }),
        [only] if only.rms_px.is_some() => Ok((only.clone(), None)),
        several => {
            match several.iter().find(|sensor| *sensor.id == SensorId::own(SensorKind::Color)) {
                Some(color) => {
                    let note = format!(
                        "only the color sensor of several ({}) is exported: name the others to export them, and use the format urdf or tf for their poses",
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

/// The sensors that are asked for by names with commas between them, in that order.
///
/// # Errors
/// As [`one_sensor`]; [`ExportError::NoPlaces`] of several that are not placed.
pub(super) fn asked_sensors<'a>(
    calibration: &'a Calibration,
    format: Format,
    asked: &str,
) -> Result<Vec<Sensor<'a>>, ExportError> {
    let each = asked.split(',').map(|name| one_sensor(calibration, format, Some(name.trim())));
    let sensors = each.map(|one| Ok(one?.0)).collect::<Result<Vec<_>, ExportError>>()?;
    if sensors.len() > 1 && sensors.iter().any(|sensor| sensor.first_from_sensor.is_none()) {
        return Err(ExportError::NoPlaces { format });
    }
    Ok(sensors)
}

/// The depth sensor that is asked for, or the only one.
pub(super) fn depth_sensor<'a>(
    calibration: &'a Calibration,
    asked: Option<&str>,
) -> Result<(Sensor<'a>, &'a DepthCalibration), ExportError> {
    let sensors = all(calibration);
    let with_depth = sensors.iter().filter_map(|sensor| Some((sensor.clone(), sensor.depth?)));
    let mut wanted =
        with_depth.filter(|(sensor, _)| asked.is_none_or(|asked| asked == sensor.name));
    match (wanted.next(), wanted.next()) {
        (Some(only), None) => Ok(only),
        (Some(_), Some(_)) => {
            Err(ExportError::SeveralSensors { format: Format::Depth, known: names(&sensors) })
        }
        (None, _) => Err(ExportError::NoDepth),
    }
}

fn names(sensors: &[Sensor<'_>]) -> String {
    sensors.iter().map(|sensor| sensor.name.as_str()).collect::<Vec<_>>().join(", ")
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
    let note = left_out(&placed[0], &open);
    Ok((placed, note))
}

/// That the `open` sensors are left out, whose places in the frame of the `first` one are not
/// known; `None` of none.
pub(super) fn left_out(first: &Sensor<'_>, open: &[Sensor<'_>]) -> Option<String> {
    let note = || {
        let (first, open) = (&first.name, names(open));
        format!("left out, because the pose relative to {first} is unknown: {open}")
    };
    (!open.is_empty()).then(note)
}

/// # Errors
/// [`ExportError::Skew`] of a lens with skew: the format takes the axes as square.
pub(super) fn without_skew(sensor: &Sensor<'_>, format: Format) -> Result<(), ExportError> {
    match sensor.lens.matrix.skew {
        0.0 => Ok(()),
        skew_px => Err(ExportError::Skew { format, skew_px }),
    }
}
