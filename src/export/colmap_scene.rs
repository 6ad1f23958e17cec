//! COLMAP's text model: `cameras.txt`, `images.txt`, `points3D.txt`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Component, Path};

use crate::calibration::scene::SceneCalibration;
use crate::export::colmap::{CORNER_TO_CENTER_PX, camera};
use crate::export::error::ExportError;
use crate::export::number::decimal;

/// A scene as COLMAP's files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColmapScene {
    /// The three files with their names.
    pub files: [(&'static str, String); 3],
    /// Which images COLMAP does not find by the names that `images.txt` has.
    pub note: Option<String>,
}

/// The scene's files. Images are numbered from 1 in the order of views, and named by their paths
/// from the folder that all views are in: COLMAP's image folder.
///
/// # Errors
/// [`ExportError::Lens`] for a lens model that COLMAP lacks.
pub fn colmap_scene(calibration: &SceneCalibration) -> Result<ColmapScene, ExportError> {
    let sensor = &calibration.sensor;
    let (model, parameters) = camera(&sensor.lens)?;
    let parameters: Vec<String> = parameters.into_iter().map(decimal).collect();
    let cameras = format!(
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} {} {} {}\n",
        sensor.image_size.width,
        sensor.image_size.height,
        parameters.join(" ")
    );
    let paths: Vec<&str> = calibration.views.iter().map(|view| view.name.as_str()).collect();
    let (names, note) = image_names(&paths);
    let files = [
        ("cameras.txt", cameras),
        ("images.txt", images(calibration, &names)),
        ("points3D.txt", points(calibration)),
    ];
    Ok(ColmapScene { files, note })
}

/// COLMAP's name of each image, and what its reader must know of them.
fn image_names(paths: &[&str]) -> (Vec<String>, Option<String>) {
    let split = |path: &&str| -> Vec<String> {
        let parts = Path::new(path).components().filter(|part| *part != Component::CurDir);
        parts.map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
    };
    let split: Vec<Vec<String>> = paths.iter().map(split).collect();
    let mut folders = split.iter().map(|parts| &parts[..parts.len().saturating_sub(1)]);
    let first = folders.next().unwrap_or_default();
    let shared = |folder: &[String]| first.iter().zip(folder).take_while(|(a, b)| a == b).count();
    let common = folders.map(shared).min().unwrap_or(first.len());
    let inside: Vec<String> = split.iter().map(|parts| parts[common..].join("/")).collect();
    let blanks: Vec<&String> =
        inside.iter().filter(|path| path.contains(char::is_whitespace)).collect();
    // COLMAP reads names up to a blank.
    let names: Vec<String> =
        inside.iter().map(|path| path.replace(char::is_whitespace, "_")).collect();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    names.iter().for_each(|name| *counts.entry(name).or_default() += 1);
    let repeated = counts.iter().find(|(_, count)| **count > 1);
    let blanks = blanks.first().map(|first| {
        let count = blanks.len();
        format!(
            "COLMAP reads names only up to the first space, so images.txt has _ for spaces: rename the images accordingly ({count} in all, the first is `{first}`)"
        )
    });
    let repeated = repeated.map(|(name, count)| {
        format!("{count} images have the name {name}, and COLMAP needs one for each")
    });
    let notes: Vec<String> = blanks.into_iter().chain(repeated).collect();
    let note = (!notes.is_empty()).then(|| notes.join("; "));
    (names, note)
}

fn images(calibration: &SceneCalibration, names: &[String]) -> String {
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
        let name = &names[k];
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_named_from_the_folder_that_all_are_in() {
        let table = [
            (["scene/a.png", "scene/b.png"], ["a.png", "b.png"]),
            (["scene/1/a.png", "scene/2/a.png"], ["1/a.png", "2/a.png"]),
            (["/x/1/a.png", "/x/a.png"], ["1/a.png", "a.png"]),
            (["/x/a.png", "/y/a.png"], ["x/a.png", "y/a.png"]),
            (["./scene/a.png", "scene/b.png"], ["a.png", "b.png"]),
            (["room.mcap#1", "room.mcap#31"], ["room.mcap#1", "room.mcap#31"]),
            (["my photos/a.png", "my photos/b.png"], ["a.png", "b.png"]),
        ];
        for (paths, expected) in table {
            let (names, note) = image_names(&paths);
            assert_eq!((names, note), (expected.map(str::to_owned).to_vec(), None), "{paths:?}");
        }
    }

    #[test]
    fn names_that_colmap_misreads_are_stated() {
        let (names, note) = image_names(&["x/a b.png", "x/a_b.png", "x/c.png"]);
        assert_eq!(names, ["a_b.png", "a_b.png", "c.png"]);
        let note = note.unwrap();
        assert!(
            note.contains("rename the images accordingly (1 in all, the first is `a b.png`); "),
            "{note}"
        );
        assert!(note.ends_with("2 images have the name a_b.png, and COLMAP needs one for each"));
        assert_eq!(image_names(&[]), (Vec::new(), None));
    }
}
