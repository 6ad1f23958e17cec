//! COLMAP's text model: `cameras.txt`, `images.txt`, `points3D.txt`.

use std::fmt::Write;
use std::path::Path;

use crate::calibration::scene::SceneCalibration;
use crate::export::colmap::{CORNER_TO_CENTER_PX, camera};
use crate::export::error::ExportError;
use crate::export::number::decimal;

/// The three files with their names. Images are numbered from 1 in the order of views.
///
/// # Errors
/// [`ExportError::Lens`] for a lens model that COLMAP lacks.
pub fn files(calibration: &SceneCalibration) -> Result<[(&'static str, String); 3], ExportError> {
    let sensor = &calibration.sensor;
    let (model, parameters) = camera(&sensor.lens)?;
    let parameters: Vec<String> = parameters.into_iter().map(decimal).collect();
    let cameras = format!(
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} {} {} {}\n",
        sensor.image_size.width,
        sensor.image_size.height,
        parameters.join(" ")
    );
    Ok([
        ("cameras.txt", cameras),
        ("images.txt", images(calibration)),
        ("points3D.txt", points(calibration)),
    ])
}

fn images(calibration: &SceneCalibration) -> String {
    let mut seen_in = vec![Vec::new(); calibration.views.len()];
    for (k, point) in calibration.points.iter().enumerate() {
        for (view, pixel) in &point.seen {
            seen_in[*view].push((k + 1, *pixel));
        }
    }
    let mut text = String::from(
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n",
    );
    for (k, view) in calibration.views.iter().enumerate() {
        let Some(camera_from_scene) = view.camera_from_scene else { continue };
        let q = camera_from_scene.rotation().into_inner();
        let t = camera_from_scene.translation();
        let name = Path::new(&view.name)
            .file_name()
            .map_or_else(|| view.name.clone(), |name| name.to_string_lossy().into_owned());
        // COLMAP reads names up to a blank.
        let name = name.replace(char::is_whitespace, "_");
        let _ = writeln!(
            text,
            "{} {} {} {} {} {} {} {} 1 {name}",
            k + 1,
            q.w,
            q.i,
            q.j,
            q.k,
            t.x,
            t.y,
            t.z
        );
        let points: Vec<String> = seen_in[k]
            .iter()
            .map(|(point, pixel)| {
                let (x, y) = (pixel.x + CORNER_TO_CENTER_PX, pixel.y + CORNER_TO_CENTER_PX);
                format!("{x} {y} {point}")
            })
            .collect();
        text += &points.join(" ");
        text.push('\n');
    }
    text
}

fn points(calibration: &SceneCalibration) -> String {
    let mut numbers = vec![0_usize; calibration.views.len()];
    let mut text =
        String::from("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    for (k, point) in calibration.points.iter().enumerate() {
        let at = point.point;
        let _ = write!(text, "{} {} {} {} 128 128 128 {}", k + 1, at.x, at.y, at.z, point.rms_px);
        for (view, _) in &point.seen {
            let _ = write!(text, " {} {}", view + 1, numbers[*view]);
            numbers[*view] += 1;
        }
        text.push('\n');
    }
    text
}
