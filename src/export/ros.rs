//! ROS `camera_info` YAML, as `camera_info_manager` and `camera_calibration_parsers` read it.

use crate::calibration::result::Calibration;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::format::models;
use crate::export::number::list;
use crate::export::sensors::{Sensor, one_sensor, without_skew};
use crate::export::{ExportError, ExportOptions, Format};
use crate::geometry::lens::Lens;
use crate::geometry::rectification::RectifiedCamera;

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "ros",
    description: "ROS camera_info YAML",
    media_type: "application/yaml",
    file_name: FileName::WithSuffix(".yaml"),
    holds_all: false,
    write,
};

fn write(calibration: &Calibration, options: &ExportOptions) -> Result<Formatted, ExportError> {
    let (sensor, note) = one_sensor(calibration, Format::Ros, options.sensor.as_deref())?;
    let name = sensor.frame_name(camera_name(calibration));
    let rectified = RectifiedCamera::framed(sensor.lens, sensor.image_size, options.alpha);
    Ok(Formatted::one_file(&name, camera_info(&name, &sensor, &rectified)?, note))
}

/// `sensor_msgs/CameraInfo` as YAML, with the rotation and the projection matrix of `rectified`.
pub(super) fn camera_info(
    name: &str,
    sensor: &Sensor<'_>,
    rectified: &RectifiedCamera,
) -> Result<String, ExportError> {
    without_skew(sensor, Format::Ros)?;
    let (model, coefficients) = distortion(sensor.lens)?;
    let k = sensor.lens.matrix;
    let camera_matrix = list(&[k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0]);
    let rectification = list(rectified.rectified_from_camera.transpose().as_slice());
    let projection = list(rectified.projection.transpose().as_slice());
    Ok(format!(
        "image_width: {width}\n\
         image_height: {height}\n\
         camera_name: {name}\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{camera_matrix}]\n\
         distortion_model: {model}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {count}\n  data: [{coefficients}]\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [{rectification}]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{projection}]\n",
        width = sensor.image_size.width,
        height = sensor.image_size.height,
        name = serde_json::Value::from(name),
        count = coefficients.len(),
        coefficients = list(&coefficients),
    ))
}

/// ROS's name and coefficients; those that a lens lacks are 0.
fn distortion(lens: &Lens) -> Result<(&'static str, Vec<f64>), ExportError> {
    let known = lens.model().facts().camera_info.ok_or_else(|| ExportError::Lens {
        format: Format::Ros,
        model: lens.model(),
        instead: models(|model| model.facts().camera_info.is_some()),
    })?;
    Ok((known.ros, lens.distortion.padded_coefficients(known.coefficients)))
}
