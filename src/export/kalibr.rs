//! Kalibr's camera chain YAML: `pinhole` with `none`, `radtan` (k1, k2, p1, p2) or `equidistant`.

use crate::calibration::calibration::SensorCalibration;
use crate::export::number::list;
use crate::export::{ExportError, Format, refit, without_skew};
use crate::geometry::lens::{Lens, LensModel};

/// A refit that is further off than this anywhere in the image is refused.
const WORST_REFIT_PX: f64 = 0.5;

/// The chain of one camera, and what its reader must know. A lens with more coefficients than `radtan` has is refitted.
pub(super) fn camera_chain(
    camera: &str,
    sensor_name: &str,
    sensor: &SensorCalibration,
) -> Result<(String, Option<String>), ExportError> {
    without_skew(sensor, Format::Kalibr)?;
    let (lens, note) = held_lens(sensor)?;
    let coefficients = lens.distortion.coefficients();
    let (distortion, coefficients) = match lens.model() {
        LensModel::Pinhole => ("none", Vec::new()),
        LensModel::KannalaBrandt => ("equidistant", coefficients),
        LensModel::Radial => ("radtan", vec![coefficients[0], 0.0, 0.0, 0.0]),
        LensModel::Brown | LensModel::Rational => ("radtan", coefficients[..4].to_vec()),
    };
    let k = lens.matrix;
    let comment = note.as_ref().map_or_else(String::new, |note| format!("# {note}\n"));
    let text = format!(
        "{comment}cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  distortion_coeffs: [{}]\n  distortion_model: {distortion}\n  \
         intrinsics: [{}]\n  resolution: [{}, {}]\n  rostopic: {}\n",
        list(&coefficients),
        list(&[k.fx, k.fy, k.cx, k.cy]),
        sensor.image_size.width,
        sensor.image_size.height,
        serde_json::Value::from(format!("/{camera}/{sensor_name}")),
    );
    Ok((text, note))
}

/// The lens itself, or the nearest one that `radtan` holds.
fn held_lens(sensor: &SensorCalibration) -> Result<(Lens, Option<String>), ExportError> {
    let lens = sensor.lens;
    let held = match lens.model() {
        LensModel::Pinhole | LensModel::Radial | LensModel::KannalaBrandt => true,
        LensModel::Brown => lens.distortion.coefficients()[4] == 0.0,
        LensModel::Rational => false,
    };
    if held {
        return Ok((lens, None));
    }
    let model = lens.model();
    let refused =
        |worst_px| ExportError::Refit { format: Format::Kalibr, model, worst_px, instead: "radial or kannala_brandt" };
    let refit = refit::with_four_coefficients(&lens, sensor.image_size).ok_or(refused(f64::INFINITY))?;
    if refit.worst_px > WORST_REFIT_PX {
        return Err(refused(refit.worst_px));
    }
    let note = format!(
        "kalibr's radtan lens has no {model} coefficients beyond k1, k2, p1, p2: refitted over the whole image, off by {:.4} px rms and {:.4} px at worst",
        refit.rms_px, refit.worst_px
    );
    Ok((refit.lens, Some(note)))
}
