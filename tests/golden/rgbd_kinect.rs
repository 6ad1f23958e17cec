//! A real Kinect (raw disparity and colour): calibrated from ten views, judged by planes on eight others, beside the published
//! calibration of the same ten views (D. Herrera C., J. Kannala, J. Heikkilä, *Joint depth and color camera calibration with
//! distortion correction*, PAMI 2012), computed with its own colour lens, extrinsics and distortion map on the same pixels.

use std::path::Path;
use std::process::Command;

use nalgebra::{Point3, Vector3};
use plumb::calibration::calibration::Calibration;
use plumb::document::calibration::CalibrationDocument;
use plumb::estimation::board_pose::board_poses;
use plumb::estimation::problem::{BoardView, Correspondence};
use plumb::geometry::depth_camera::DepthCamera;
use plumb::geometry::pixel::Pixel;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::picture_file::frame_from_file;
use serde_json::Value;

use crate::shared_data::shared_data;

const FITTED: [u32; 10] = [0, 3, 8, 15, 16, 19, 24, 26, 31, 37];

/// Held-out views by distance, and there, by the published calibration, the rms distance from colour's plane in mm, and the
/// mean over a view in the mean over views, with its sign left out. Of the single farthest view (0.64 mm by chance) it is what
/// the dataset's notes give for far views.
const RANGES: [(&str, &[usize], f64, f64); 3] = [
    ("0.6 to 1.45 m", &[1, 5, 18, 28], 2.07, 0.68),
    ("1.45 to 2.2 m", &[10, 22, 33], 8.32, 4.15),
    ("2.2 to 2.8 m", &[12], 17.46, 7.7),
];

fn calibrated(data: &Path) -> Calibration {
    let folder = tempfile::tempdir().unwrap();
    for (sensor, ending, source) in [("color", "jpg", "c1.jpg"), ("depth", "pgm", "d.pgm")] {
        std::fs::create_dir(folder.path().join(sensor)).unwrap();
        for view in FITTED {
            let to = folder.path().join(sensor).join(format!("{view:04}.{ending}"));
            std::fs::copy(data.join(format!("{view:04}-{source}")), to).unwrap();
        }
    }
    let said = "[depth]\nkind = \"disparity\"\ninvalid = 2047\n";
    std::fs::write(folder.path().join("sensors.toml"), said).unwrap();
    let place = folder.path().display().to_string();
    let asked = ["calibrate", "--json", "--lens", "brown", "--board", "8x6", "--square", "40mm", &place];
    let output = Command::new(env!("CARGO_BIN_EXE_plumb")).args(asked).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: CalibrationDocument = serde_json::from_slice(&output.stdout).unwrap();
    Calibration::try_from(&document).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// The plane of the board as colour sees it: a unit normal and its distance, in the colour camera's frame.
fn plane(calibration: &Calibration, view: &Value) -> (Vector3<f64>, f64) {
    let points = view["object_m"].as_array().unwrap().iter().map(numbers);
    let pixels = view["color_corners_px"].as_array().unwrap().iter().map(numbers);
    let seen = points.zip(pixels).map(|(point, pixel)| Correspondence {
        point_in_board: Point3::new(point[0], point[1], 0.0),
        pixel: Pixel::new(pixel[0], pixel[1]),
        std_px: 1.0,
    });
    let view = BoardView { name: "held out".to_owned(), correspondences: seen.collect() };
    let lens = &calibration.color.as_ref().unwrap().lens;
    let color_from_board = board_poses(lens, &view).unwrap()[0].camera_from_board;
    let normal = color_from_board * Vector3::z();
    (normal, normal.dot(&color_from_board.translation()))
}

fn inside(polygon: &[Pixel], pixel: Pixel) -> bool {
    let sides = polygon.iter().zip(polygon.iter().cycle().skip(1));
    let left = sides.filter(|(a, b)| {
        (a.y <= pixel.y) != (b.y <= pixel.y) && a.x + (pixel.y - a.y) / (b.y - a.y) * (b.x - a.x) < pixel.x
    });
    left.count() % 2 == 1
}

/// Distances from the plane of every reading on it, in mm.
fn off(calibration: &Calibration, camera: &DepthCamera, data: &Path, (number, view): (usize, &Value)) -> Vec<f64> {
    let (normal, distance) = plane(calibration, view);
    let bytes = std::fs::read(data.join(format!("{number:04}-d.pgm"))).unwrap();
    let picture = DepthImage::from_frame(&frame_from_file(SensorKind::Depth, bytes)).unwrap();
    let corners = view["plane_polygon_depth_px"].as_array().unwrap().iter().map(numbers).collect::<Vec<_>>();
    let polygon: Vec<Pixel> = match corners.len() {
        2 => corners[0].iter().zip(&corners[1]).map(|(x, y)| Pixel::new(*x, *y)).collect(),
        _ => corners.iter().map(|corner| Pixel::new(corner[0], corner[1])).collect(),
    };
    let pose = &calibration.extrinsics.iter().find(|pose| pose.name == "color_from_depth").unwrap().target_from_source;
    let size = picture.size();
    let pixels =
        (0..size.width * size.height).map(|k| Pixel::new(f64::from(k % size.width), f64::from(k / size.width)));
    let each = pixels.zip(picture.readings()).filter(|(pixel, raw)| **raw < 2047 && inside(&polygon, *pixel));
    let point = |(pixel, raw): (Pixel, &u16)| camera.point_from_reading(pixel, f64::from(*raw));
    each.filter_map(point).map(|p| 1e3 * (normal.dot(&(*pose * p).coords) - distance)).collect()
}

#[test]
fn planes_of_held_out_views_lie_closer_than_by_the_published_calibration() {
    let Some(data) = shared_data("kinect1-herrera") else { return };
    let calibration = calibrated(&data);
    let reference: Value =
        serde_json::from_slice(&std::fs::read(data.join("full_set_reference.json")).unwrap()).unwrap();
    let views = reference["views"].as_array().unwrap();
    let corrected = &calibration.depth.as_ref().unwrap().camera;
    let uncorrected = DepthCamera { correction: None, ..corrected.clone() };
    for (range, numbers, published_rms_mm, published_mean_mm) in RANGES {
        let both = |camera: &DepthCamera| {
            let of_view = |number: &usize| {
                let view = views.iter().find(|view| view["index"] == *number).unwrap();
                let off = off(&calibration, camera, &data, (*number, view));
                let mean = off.iter().sum::<f64>() / off.len() as f64;
                (off.iter().map(|mm| mm * mm).sum::<f64>() / off.len() as f64, mean.abs())
            };
            let sums = numbers.iter().map(of_view).fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            ((sums.0 / numbers.len() as f64).sqrt(), sums.1 / numbers.len() as f64)
        };
        let ((rms, mean), before) = (both(corrected), both(&uncorrected));
        let line = format!(
            "{range}: {rms:.2} mm rms, {mean:.2} mm mean; published {published_rms_mm} and {published_mean_mm} mm; \
             without correction {:.2} and {:.2} mm",
            before.0, before.1
        );
        println!("{line}");
        assert!(rms <= published_rms_mm && mean <= published_mean_mm, "{line}");
    }
    // What planes alone leave open is told: the published answers lie within it.
    let depth = calibration.depth.as_ref().unwrap();
    for (axis, published) in [(0, 580.0..586.5), (1, 583.9..586.8)] {
        let (focal, std) = (depth.camera.lens.parameters()[axis], depth.lens_std[axis]);
        println!("f{axis}: {focal:.1} ± {std:.1}, published {published:?}");
        assert!(std > 0.005 * focal && focal - 2.0 * std < published.end && focal + 2.0 * std > published.start);
    }
    let told = calibration.verdict.reasons.join("\n");
    assert!(told.contains("fx is known to") && told.contains("stands back"), "{told}");
}
