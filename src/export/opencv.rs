//! OpenCV `FileStorage` YAML, with the field names of OpenCV's own calibration sample.

use crate::calibration::result::Calibration;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::format::models;
use crate::export::number::{decimal, list};
use crate::export::sensors::{Sensor, one_sensor, without_skew};
use crate::export::{ExportError, ExportOptions, Format};
use crate::geometry::board::Chessboard;
use crate::geometry::lens::Lens;
use crate::geometry::target::Target;

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "opencv",
    description: "OpenCV FileStorage YAML",
    media_type: "application/yaml",
    file_name: FileName::WithSuffix("-opencv.yaml"),
    holds_all: false,
    write,
};

fn write(calibration: &Calibration, options: &ExportOptions) -> Result<Formatted, ExportError> {
    let (sensor, note) = one_sensor(calibration, Format::Opencv, options.sensor.as_deref())?;
    let name = sensor.frame_name(camera_name(calibration));
    Ok(Formatted::one_file(&name, file_storage(calibration, &sensor)?, note))
}

/// What `cv::FileStorage` opens: `camera_matrix`, `distortion_coefficients` and `fisheye_model` (1:
/// the coefficients are those of `cv::fisheye`), for `cv::projectPoints`, `cv::undistort` and their
/// fisheye twins.
fn file_storage(calibration: &Calibration, sensor: &Sensor<'_>) -> Result<String, ExportError> {
    without_skew(sensor, Format::Opencv)?;
    let lens = sensor.lens;
    let (is_fisheye, coefficients) = coefficients(lens, Format::Opencv)?;
    let k = lens.matrix;
    let mut text = String::from("%YAML:1.0\n---\n");
    text += &format!(
        "image_width: {}\nimage_height: {}\n",
        sensor.image_size.width, sensor.image_size.height
    );
    let board = calibration.target.and_then(|target| target.board());
    if let Some(Target::Chessboard(Chessboard { size, square_m })) = board {
        text += &format!("board_width: {}\nboard_height: {}\n", size.cols, size.rows);
        text += &format!("square_size: {}\n", decimal(square_m));
    }
    text += &format!("fisheye_model: {}\n", i32::from(is_fisheye));
    text += &matrix("camera_matrix", 3, &[k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0]);
    text += &matrix("distortion_coefficients", coefficients.len(), &coefficients);
    if let Some(rms_px) = sensor.rms_px {
        text += &format!("avg_reprojection_error: {}\n", decimal(rms_px));
    }
    Ok(text)
}

/// Whether the lens is one of `cv::fisheye`, and its coefficients in OpenCV's order.
///
/// # Errors
/// [`ExportError::Lens`] of a lens that OpenCV has not.
pub(super) fn coefficients(lens: &Lens, format: Format) -> Result<(bool, Vec<f64>), ExportError> {
    let known = lens.model().facts().opencv.ok_or_else(|| ExportError::Lens {
        format,
        model: lens.model(),
        instead: models(|model| model.facts().opencv.is_some()),
    })?;
    Ok((known.fisheye, lens.distortion.padded_coefficients(known.coefficients)))
}

pub(super) fn matrix(name: &str, rows: usize, values: &[f64]) -> String {
    let cols = values.len() / rows;
    format!(
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {} ]\n",
        list(values)
    )
}
