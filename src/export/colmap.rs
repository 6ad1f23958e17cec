//! COLMAP's `cameras.txt`, a camera for each image sensor.

use crate::calibration::result::Calibration;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::format::models;
use crate::export::number::decimal;
use crate::export::sensors::{Sensor, images, without_skew};
use crate::export::{ExportError, ExportOptions, Format};
use crate::geometry::lens::Lens;
use crate::geometry::lens::model::ForeignModel;

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "colmap",
    description: "COLMAP cameras.txt",
    media_type: "text/plain; charset=utf-8",
    file_name: FileName::Fixed("cameras.txt"),
    holds_all: true,
    write,
};

/// COLMAP puts (0, 0) at the image's corner, half a pixel up and left of the first pixel's center:
/// its cx and cy are ours plus one half.
pub(super) const CORNER_TO_CENTER_PX: f64 = 0.5;

fn write(calibration: &Calibration, _: &ExportOptions) -> Result<Formatted, ExportError> {
    Ok(Formatted::one_file(camera_name(calibration), cameras(&images(calibration))?, None))
}

/// One line a sensor, numbered from 1 in the order of documents.
fn cameras(sensors: &[Sensor<'_>]) -> Result<String, ExportError> {
    if sensors.is_empty() {
        return Err(ExportError::NoSensor { format: Format::Colmap });
    }
    let mut text = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for (k, sensor) in sensors.iter().enumerate() {
        without_skew(sensor, Format::Colmap)?;
        let (model, parameters) = camera(sensor.lens)?;
        let parameters: Vec<String> = parameters.into_iter().map(decimal).collect();
        let (width, height) = (sensor.image_size.width, sensor.image_size.height);
        text += &format!(
            "# {}\n{} {model} {width} {height} {}\n",
            sensor.name,
            k + 1,
            parameters.join(" ")
        );
    }
    Ok(text)
}

/// COLMAP's name for the model, and its parameters; skew is left out.
///
/// # Errors
/// [`ExportError::Lens`] for a model that COLMAP lacks.
pub(super) fn camera(lens: &Lens) -> Result<(&'static str, Vec<f64>), ExportError> {
    let k = lens.matrix;
    let ForeignModel { name, coefficients } =
        lens.model().facts().colmap.ok_or_else(|| ExportError::Lens {
            format: Format::Colmap,
            model: lens.model(),
            instead: models(|model| model.facts().colmap.is_some()),
        })?;
    let mut parameters = vec![k.fx, k.fy, k.cx + CORNER_TO_CENTER_PX, k.cy + CORNER_TO_CENTER_PX];
    parameters.extend(lens.distortion.padded_coefficients(coefficients));
    Ok((name, parameters))
}
