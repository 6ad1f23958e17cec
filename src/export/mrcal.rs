//! mrcal's `.cameramodel`: a Python literal with comments.

use crate::export::number::list;
use crate::export::sensors::{Sensor, without_skew};
use crate::export::{ExportError, Format};
use crate::geometry::lens::LensModel;

/// The model at the reference's origin. mrcal's OPENCV4, 5 and 8 take OpenCV's coefficients in
/// OpenCV's order; it has no fisheye of OpenCV's kind.
pub(super) fn camera_model(sensor: &Sensor<'_>) -> Result<String, ExportError> {
    without_skew(sensor, Format::Mrcal)?;
    let lens = sensor.lens;
    let mut coefficients = lens.distortion.coefficients();
    let model = match lens.model() {
        LensModel::Pinhole => "LENSMODEL_PINHOLE",
        LensModel::Radial => {
            coefficients.resize(4, 0.0);
            "LENSMODEL_OPENCV4"
        }
        LensModel::Brown => "LENSMODEL_OPENCV5",
        LensModel::Rational => "LENSMODEL_OPENCV8",
        model @ LensModel::KannalaBrandt => {
            return Err(ExportError::Lens {
                format: Format::Mrcal,
                model,
                instead: "rational or brown",
            });
        }
    };
    let k = lens.matrix;
    let mut intrinsics = vec![k.fx, k.fy, k.cx, k.cy];
    intrinsics.extend(coefficients);
    Ok(format!(
        "{{\n    'lensmodel': '{model}',\n\n    # fx, fy, cx, cy, then the coefficients\n    'intrinsics': [ {} ],\n\n    \
         # the camera is the reference\n    'extrinsics': [ 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 ],\n\n    'imagersize': [ {}, {} ],\n}}\n",
        list(&intrinsics),
        sensor.image_size.width,
        sensor.image_size.height,
    ))
}
