//! Kalibr's camera chain YAML: `pinhole` with `none`, `radtan` (k1, k2, p1, p2) or `equidistant`.

use crate::calibration::result::Calibration;
use crate::calibration::sensor::SensorId;
use crate::export::facts::{FileName, FormatFacts, Formatted, camera_name};
use crate::export::format::models;
use crate::export::number::list;
use crate::export::sensors::{self, Sensor, asked_sensors, left_out, without_skew};
use crate::export::{ExportError, ExportOptions, Format, refit};
use crate::geometry::lens::model::KalibrModel;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

pub(super) const FACTS: FormatFacts = FormatFacts {
    name: "kalibr",
    description: "Kalibr camera chain YAML",
    media_type: "application/yaml",
    file_name: FileName::WithSuffix("-camchain.yaml"),
    holds_all: false,
    write,
};

/// A refit that is further off than this anywhere in the image is refused.
const WORST_REFIT_PX: f64 = 0.5;

fn write(calibration: &Calibration, options: &ExportOptions) -> Result<Formatted, ExportError> {
    let (cameras, left_out) = match &options.sensor {
        Some(asked) => (asked_sensors(calibration, Format::Kalibr, asked)?, None),
        None => chain_of(calibration)?,
    };
    let camera = camera_name(calibration);
    let (text, note) = camera_chain(camera, &cameras, left_out)?;
    Ok(Formatted::one_file(camera, text, note))
}

/// The cameras of a chain: color and infrared (the depth sensor where there is no infrared
/// image), or a rig's; and which are left out, because their places are not known.
fn chain_of(calibration: &Calibration) -> Result<(Vec<Sensor<'_>>, Option<String>), ExportError> {
    let none = ExportError::NoSensor { format: Format::Kalibr };
    let mut cameras = sensors::all(calibration);
    let seen_by = |sensor: &Sensor<'_>| {
        let infrared = SensorId { kind: SensorKind::Infrared, ..sensor.id.clone() };
        calibration.sensor(&infrared).is_some()
    };
    cameras.retain(|sensor| sensor.id.kind != SensorKind::Depth || !seen_by(sensor));
    match cameras.as_slice() {
        [] => Err(none),
        [only] if only.rms_px.is_none() => Err(none),
        [_] => Ok((cameras, None)),
        _ => {
            let (placed, open): (Vec<_>, Vec<_>) =
                cameras.into_iter().partition(|sensor| sensor.first_from_sensor.is_some());
            let note = left_out(placed.first().ok_or(none)?, &open);
            Ok((placed, note))
        }
    }
}

/// The chain of `cameras`, and what its reader must know, `left_out` before all. A lens with more
/// coefficients than `radtan` has is refitted.
fn camera_chain(
    camera: &str,
    cameras: &[Sensor<'_>],
    left_out: Option<String>,
) -> Result<(String, Option<String>), ExportError> {
    let (mut text, mut notes) = (String::new(), Vec::from_iter(left_out));
    for (k, sensor) in cameras.iter().enumerate() {
        without_skew(sensor, Format::Kalibr)?;
        let (model, lens, note) = held_lens(sensor)?;
        notes.extend(
            note.map(
                |note| if cameras.len() > 1 { format!("{}: {note}", sensor.name) } else { note },
            ),
        );
        let others: Vec<String> =
            (0..cameras.len()).filter(|other| *other != k).map(|k| k.to_string()).collect();
        text += &format!("cam{k}:\n");
        if let Some(before) = k.checked_sub(1).and_then(|k| cameras[k].first_from_sensor)
            && let Some(first_from_sensor) = sensor.first_from_sensor
        {
            text += &step(&(first_from_sensor.inverse() * before));
        }
        text +=
            &format!("  cam_overlaps: [{}]\n{}", others.join(", "), entry(sensor, &lens, model));
        text += &format!("  rostopic: {}\n", serde_json::Value::from(sensor.topic(camera)));
    }
    let note = (!notes.is_empty()).then(|| notes.join("; "));
    let comment = note.as_ref().map_or_else(String::new, |note| format!("# {note}\n"));
    Ok((comment + &text, note))
}

fn entry(sensor: &Sensor<'_>, lens: &Lens, model: KalibrModel) -> String {
    let KalibrModel { camera, distortion, coefficients } = model;
    let k = lens.matrix;
    let mut intrinsics = vec![k.fx, k.fy, k.cx, k.cy];
    if !model.is_pinhole() {
        intrinsics.splice(0..0, lens.distortion.coefficients());
    }
    format!(
        "  camera_model: {camera}\n  distortion_coeffs: [{}]\n  distortion_model: {distortion}\n  \
         intrinsics: [{}]\n  resolution: [{}, {}]\n",
        list(&lens.distortion.padded_coefficients(coefficients)),
        list(&intrinsics),
        sensor.image_size.width,
        sensor.image_size.height,
    )
}

/// Where the camera before is in this one's frame, row by row.
fn step(this_from_before: &Pose) -> String {
    let (rotation, translation) =
        (this_from_before.rotation_matrix(), this_from_before.translation());
    let row = |k: usize| {
        format!(
            "  - [{}]\n",
            list(&[rotation[(k, 0)], rotation[(k, 1)], rotation[(k, 2)], translation[k]])
        )
    };
    format!("  T_cn_cnm1:\n{}{}{}  - [0.0, 0.0, 0.0, 1.0]\n", row(0), row(1), row(2))
}

/// Kalibr's name for the model; with the lens itself, or the nearest one that `radtan` holds.
fn held_lens(sensor: &Sensor<'_>) -> Result<(KalibrModel, Lens, Option<String>), ExportError> {
    let lens = *sensor.lens;
    let model = lens.model();
    let known = model.facts().kalibr.ok_or_else(|| ExportError::Lens {
        format: Format::Kalibr,
        model,
        instead: models(held_exactly),
    })?;
    let coefficients = lens.distortion.coefficients();
    let beyond = coefficients.get(known.coefficients..).unwrap_or_default();
    if !known.is_pinhole() || beyond.iter().all(|coefficient| *coefficient == 0.0) {
        return Ok((known, lens, None));
    }
    let refused = |worst_px| ExportError::Refit {
        format: Format::Kalibr,
        model,
        worst_px,
        instead: models(held_exactly),
    };
    let refit = refit::with_four_coefficients(&lens, sensor.image_size)
        .ok_or_else(|| refused(f64::INFINITY))?;
    if refit.worst_px > WORST_REFIT_PX {
        return Err(refused(refit.worst_px));
    }
    let note = format!(
        "kalibr's radtan has only k1, k2, p1, p2: the {model} lens was refitted over the whole image, and differs by {:.4} px rms and {:.4} px at worst",
        refit.rms_px, refit.worst_px
    );
    Ok((known, refit.lens, Some(note)))
}

/// Whether Kalibr has every coefficient of the model.
fn held_exactly(model: LensModel) -> bool {
    let has = |known: KalibrModel| {
        !known.is_pinhole() || model.coefficient_names().len() <= known.coefficients
    };
    model.facts().kalibr.is_some_and(has)
}
