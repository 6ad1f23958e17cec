//! An image sensor besides color (the right infrared one of a stereo depth camera): its lens and
//! pose. It is solved with color only, as a rig of two cameras. Depth is measured in the view of
//! the left one, so this sensor adds nothing to depth.

use crate::calibration::result::{CalibratedSensor, Calibration, Grade};
use crate::calibration::solve::observations::CameraFrameSets;
use crate::calibration::solve::rig_input::RigInput;
use crate::calibration::solve::solve_rig::{RigError, SolvedRig, solve_rig};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::LensChoice;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// Solves color and the sensor `kind` of one camera together, both with the lens model of
/// `options`.
///
/// # Errors
/// [`RigError`]: one of them cannot be calibrated, or they never saw the board together.
fn solve_with_color(
    board: Target,
    camera: &CameraFrameSets,
    kind: SensorKind,
    options: &CameraOptions,
) -> Result<SolvedRig, RigError> {
    let of = |sensor: SensorKind| {
        camera.as_rig_sensor(sensor.name().to_owned(), sensor, |index, _| index)
    };
    let mut sensors = vec![of(SensorKind::Color), of(kind)];
    sensors.iter_mut().for_each(|sensor| sensor.given = None);
    solve_rig(&RigInput { board, sensors }, options)
}

/// `calibration`, which has color, extended by the sensor `kind` and its pose. If that cannot be
/// calibrated, color stays as it is and the verdict says why.
pub(super) fn with_image_sensor(
    mut calibration: Calibration,
    board: Target,
    camera: &CameraFrameSets,
    kind: SensorKind,
    options: &CameraOptions,
) -> Calibration {
    let lens = calibration.color().map(|color| LensChoice::Model(color.lens.model()));
    let options = CameraOptions { lens: lens.unwrap_or(options.lens), ..options.clone() };
    match solve_with_color(board, camera, kind, &options) {
        Ok(SolvedRig { sensors, extrinsics, .. }) => {
            let sensor = sensors.into_iter().find(|(id, _)| id.kind == kind);
            if let Some((id, sensor)) = sensor {
                calibration.add_sensor(CalibratedSensor::image(id, sensor));
            }
            calibration.extrinsics.extend(extrinsics);
        }
        Err(reason) => {
            let name = kind.name();
            calibration.verdict.lower(Grade::Usable, format!("{name} is not calibrated: {reason}"));
        }
    }
    calibration
}
