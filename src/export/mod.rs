//! Calibrations in other programs' formats, one file a format. Uses geometry, calibration and
//! document.
//!
//! **Never truncates.** A lens that a format cannot hold exactly is refused by name
//! ([`ExportError::Lens`], [`ExportError::Skew`]), or refitted where the format's users would
//! otherwise have nothing, with the refit's error stated in the file and in [`Exported::note`].
//! Numbers are written with every digit of their double.
//!
//! A calibration of several sensors goes whole into the formats that hold several; of the others,
//! it is one sensor's: color's unless [`ExportOptions::sensor`] says another.

mod colmap;
pub mod colmap_scene;
mod depth;
mod error;
mod exported;
mod format;
mod kalibr;
mod mrcal;
mod number;
mod opencv;
pub mod other_images;
mod refit;
mod ros;
mod sensors;
mod stereo;
mod transforms;

pub use error::ExportError;
pub use exported::{ExportOptions, Exported, ExportedFile};
pub use format::Format;

use crate::calibration::result::{Calibration, SensorResult};
use crate::document::calibration::CalibrationDocument;
use crate::document::reading::to_json_pretty;
use crate::export::sensors::{Sensor, asked_sensors, depth_sensor, one_sensor, placed_sensors};
use crate::geometry::rectification::RectifiedCamera;

/// Writes `calibration` in `format`. A skew that is rounding alone is none, but in `json`.
///
/// # Errors
/// [`ExportError`] where the format cannot hold it.
pub fn export(
    calibration: &Calibration,
    format: Format,
    options: &ExportOptions,
) -> Result<Exported, ExportError> {
    let calibration = &match format {
        Format::Json => calibration.clone(),
        _ => without_rounding(calibration),
    };
    let camera = calibration.camera.as_deref().unwrap_or("camera");
    let one = || one_sensor(calibration, format, options.sensor.as_deref());
    let mut files = Vec::new();
    if format.holds_all()
        && let Some(asked) = options.sensor.as_ref().filter(|names| names.contains(','))
    {
        return Err(ExportError::Order { format, asked: asked.clone() });
    }
    let (text, file, note) = match format {
        Format::Json => (json(calibration)?, camera.to_owned(), None),
        Format::Ros | Format::Opencv | Format::Mrcal => {
            let (sensor, note) = one()?;
            let text = match format {
                Format::Ros => {
                    let Sensor { lens, image_size, .. } = sensor;
                    let rectified = RectifiedCamera::framed(lens, image_size, options.alpha);
                    ros::camera_info(&sensor.frame_name(camera), &sensor, &rectified)?
                }
                Format::Opencv => opencv::file_storage(calibration, &sensor)?,
                _ => mrcal::camera_model(&sensor)?,
            };
            (text, sensor.frame_name(camera), note)
        }
        Format::RosStereo => {
            let (text, each) = stereo::camera_infos(camera, calibration, options)?;
            files = each;
            (text, camera.to_owned(), None)
        }
        Format::OpencvStereo => {
            (stereo::opencv_matrices(calibration, options)?, camera.to_owned(), None)
        }
        Format::Kalibr => {
            let (cameras, left_out) = match &options.sensor {
                Some(asked) => (asked_sensors(calibration, format, asked)?, None),
                None => kalibr::chain_of(calibration)?,
            };
            let (text, note) = kalibr::camera_chain(camera, &cameras, left_out)?;
            (text, camera.to_owned(), note)
        }
        Format::Colmap => {
            (colmap::cameras(&sensors::images(calibration))?, camera.to_owned(), None)
        }
        Format::Urdf | Format::Tf => {
            let (placed, note) = placed_sensors(calibration, format)?;
            let text = if format == Format::Urdf {
                transforms::urdf(camera, &placed)
                    .map_err(|error| ExportError::Text { format, reason: error.to_string() })?
            } else {
                transforms::stamped(camera, &placed)
            };
            (text, camera.to_owned(), note)
        }
        Format::Depth => {
            let (sensor, depth) = depth_sensor(calibration, options.sensor.as_deref())?;
            let camera = sensor.id.camera.as_deref().unwrap_or(camera);
            (depth::correction_file(camera, depth), camera.to_owned(), None)
        }
    };
    let file_name = format.file_name(&file);
    let (bytes, media_type) = (text.into_bytes(), format.media_type());
    Ok(Exported { bytes, files, media_type, file_name, note })
}

/// The same with a skew of exactly 0 where there is none.
fn without_rounding(calibration: &Calibration) -> Calibration {
    let mut rounded = calibration.clone();
    for sensor in &mut rounded.sensors {
        let matrix = match &mut sensor.result {
            SensorResult::Image(image) => &mut image.lens.matrix,
            SensorResult::Depth(depth) => &mut depth.camera.lens.matrix,
        };
        if !matrix.has_skew() {
            matrix.skew = 0.0;
        }
    }
    rounded
}

fn json(calibration: &Calibration) -> Result<String, ExportError> {
    let document = CalibrationDocument::from(calibration);
    to_json_pretty(&document)
        .map_err(|error| ExportError::Text { format: Format::Json, reason: error.to_string() })
}

#[cfg(test)]
#[path = "export_tests.rs"]
mod tests;
