//! COLMAP's `cameras.txt`, a camera for each picture sensor.

use crate::export::number::decimal;
use crate::export::sensors::{Sensor, without_skew};
use crate::export::{ExportError, Format};
use crate::geometry::lens::{Lens, LensModel};

/// COLMAP puts (0, 0) at the image's corner, half a pixel up and left of the first pixel's center:
/// its cx and cy are ours plus one half.
pub(super) const CORNER_TO_CENTER_PX: f64 = 0.5;

/// One line a sensor, numbered from 1 in the order of documents.
pub(super) fn cameras(sensors: &[Sensor<'_>]) -> Result<String, ExportError> {
    if sensors.is_empty() {
        return Err(ExportError::NoSensor { format: Format::Colmap });
    }
    let mut text = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for (k, sensor) in sensors.iter().enumerate() {
        without_skew(sensor, Format::Colmap)?;
        let (model, parameters) = camera(sensor.lens);
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
pub(super) fn camera(lens: &Lens) -> (&'static str, Vec<f64>) {
    let k = lens.matrix;
    let mut coefficients = lens.distortion.coefficients();
    let (model, count) = match lens.model() {
        LensModel::Pinhole => ("PINHOLE", 0),
        LensModel::Radial => ("OPENCV", 4),
        LensModel::KannalaBrandt => ("OPENCV_FISHEYE", 4),
        // k1, k2, p1, p2, k3, k4, k5, k6
        LensModel::Brown | LensModel::Rational => ("FULL_OPENCV", 8),
    };
    coefficients.resize(count, 0.0);
    let mut parameters = vec![k.fx, k.fy, k.cx + CORNER_TO_CENTER_PX, k.cy + CORNER_TO_CENTER_PX];
    parameters.extend(coefficients);
    (model, parameters)
}
