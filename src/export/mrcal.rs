//! mrcal's `.cameramodel`: a Python literal with comments.

use crate::calibration::result::Calibration;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::format::models;
use crate::export::number::list;
use crate::export::sensors::{Sensor, one_sensor, without_skew};
use crate::export::{ExportError, ExportOptions, Format};
use crate::geometry::lens::model::ForeignModel;

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "mrcal",
    description: "mrcal .cameramodel",
    media_type: "text/plain; charset=utf-8",
    file_name: FileName::WithSuffix(".cameramodel"),
    holds_all: false,
    write,
};

fn write(calibration: &Calibration, options: &ExportOptions) -> Result<Formatted, ExportError> {
    let (sensor, note) = one_sensor(calibration, Format::Mrcal, options.sensor.as_deref())?;
    let name = sensor.frame_name(camera_name(calibration));
    Ok(Formatted::one_file(&name, camera_model(&sensor)?, note))
}

/// The model at the reference's origin. mrcal's OPENCV4, 5 and 8 take OpenCV's coefficients in
/// OpenCV's order; it has no fisheye of OpenCV's kind.
fn camera_model(sensor: &Sensor<'_>) -> Result<String, ExportError> {
    without_skew(sensor, Format::Mrcal)?;
    let lens = sensor.lens;
    let ForeignModel { name: model, coefficients } =
        lens.model().facts().mrcal.ok_or_else(|| ExportError::Lens {
            format: Format::Mrcal,
            model: lens.model(),
            instead: models(|model| model.facts().mrcal.is_some()),
        })?;
    let k = lens.matrix;
    let mut intrinsics = vec![k.fx, k.fy, k.cx, k.cy];
    intrinsics.extend(lens.distortion.padded_coefficients(coefficients));
    Ok(format!(
        "{{\n    'lensmodel': '{model}',\n\n    # fx, fy, cx, cy, then the coefficients\n    'intrinsics': [ {} ],\n\n    \
         # the camera is the reference\n    'extrinsics': [ 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 ],\n\n    'imagersize': [ {}, {} ],\n}}\n",
        list(&intrinsics),
        sensor.image_size.width,
        sensor.image_size.height,
    ))
}
