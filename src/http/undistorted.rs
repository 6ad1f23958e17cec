//! Pictures through a camera's current calibration: the maps that undistort them, kept for the next
//! picture.

use std::sync::Arc;

use crate::http::kept::Kept;
use crate::http::problem::Problem;
use crate::http::{Shared, on_a_blocking_thread};
use crate::imaging::frame::SensorKind;
use crate::imaging::undistort::{UndistortOptions, Undistortion};

/// The maps used lately, by calibration and sensor.
pub(super) type Undistortions = Kept<(String, SensorKind), Undistortion>;

/// How to undistort the pictures of a camera's sensor with its current calibration.
///
/// # Errors
/// 404 for an unknown camera; 409 without a current calibration of this sensor.
pub(super) async fn undistortion(
    shared: &Shared,
    camera: &str,
    sensor: SensorKind,
) -> Result<Arc<Undistortion>, Problem> {
    let none = || {
        let name = sensor.name();
        Problem::conflict(format!(
            "camera `{camera}` has no approved calibration of {name} to undistort with; run a session"
        ))
    };
    let id = shared.fleet.camera(camera)?.calibration.ok_or_else(none)?;
    let key = (id, sensor);
    if let Some(known) = shared.undistortions.get(&key) {
        return Ok(known);
    }
    let asked = key.0.clone();
    let calibration =
        shared.stored(move |store| store.calibration(&asked)).await?.ok_or_else(none)?;
    let calibrated = calibration.image(sensor).cloned().ok_or_else(none)?;
    let made = on_a_blocking_thread(move || {
        Undistortion::new(&calibrated.lens, calibrated.image_size, &UndistortOptions::default())
    });
    Ok(shared.undistortions.keep(key, made.await?))
}
