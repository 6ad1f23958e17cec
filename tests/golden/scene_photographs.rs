//! Calibration without a target from real photographs, and from what can be wrong with them.

use image::GrayImage;
use image::imageops::{self, FilterType};
use plumb::calibration::result::Grade;
use plumb::calibration::scene::correspondence::SceneImage;
use plumb::calibration::scene::{SceneCalibration, SceneOptions, calibrate_scene};
use plumb::estimation::problem::{GivenParameter, LensChoice};
use plumb::geometry::lens::LensModel;
use plumb::imaging::gray::GrayImage as Gray;

use crate::shared_data::shared_data;

const WIDTH: u32 = 1024;

/// The photographs in a folder of the real images, in the order of their names, reduced where they
/// are larger.
fn photographs(folder: &str) -> Option<Vec<GrayImage>> {
    let entries = std::fs::read_dir(shared_data(folder)?).unwrap();
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| {
        let is =
            |extension: &str| path.extension().is_some_and(|of| of.eq_ignore_ascii_case(extension));
        is("jpg") || is("png")
    });
    paths.sort();
    let reduced = |path| {
        let image: GrayImage = image::open(path).unwrap().to_luma8();
        if image.width() <= WIDTH {
            return image;
        }
        let height = (image.height() * WIDTH + image.width() / 2) / image.width();
        imageops::resize(&image, WIDTH, height, FilterType::Triangle)
    };
    Some(paths.iter().map(reduced).collect())
}

fn calibrated(images: &[GrayImage]) -> SceneCalibration {
    calibrated_with(images, Vec::new())
}

fn calibrated_with(images: &[GrayImage], given: Vec<GivenParameter>) -> SceneCalibration {
    let scene_image = |(k, image): (usize, &GrayImage)| {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let gray = Gray::from_pixels(width, height, image.as_raw().clone()).unwrap();
        SceneImage::of(k.to_string(), gray.view())
    };
    let images: Vec<SceneImage> = images.iter().enumerate().map(scene_image).collect();
    let lens = LensChoice::Model(LensModel::Brown);
    let options = SceneOptions { lens, given, threads: 2, ..SceneOptions::default() };
    calibrate_scene(&images, &options).unwrap()
}

/// The focal length and principal point of Strecha's ground truth (2759.48 2764.16 1520.69 1006.81
/// for 3072 × 2048) in the reduced images.
const HERZJESU: [f64; 4] = [919.83, 921.84, 506.56, 335.44];

/// Each error over its stated standard deviation is at most `sigmas`.
fn expect_truth(found: &SceneCalibration, sigmas: f64) {
    let parameters = found.sensor.lens.parameters();
    for (k, truth) in HERZJESU.into_iter().enumerate() {
        let (value, std) = (parameters[k], found.sensor.lens_std[k]);
        assert!((value - truth).abs() < sigmas * std, "{k}: {value} ± {std}, not {truth}");
    }
}

#[test]
fn photographs_rotated_by_180_degrees_are_named() {
    let Some(images) = photographs("strecha-herzjesu/images") else { return };
    let upright = calibrated(&images);
    let differs = |of: &SceneCalibration| of.verdict.reasons.join("\n").contains("images differ");
    assert!(!differs(&upright), "{:?}", upright.verdict);
    expect_truth(&upright, 2.5);
    // Of two halves, either may be named.
    let halves: [&str; 2] = ["`1`, `3`, `5`, `7` by", "`0`, `2`, `4`, `6` by"];
    for (every, named) in [(2, halves.as_slice()), (5, &["`1`, `6` by"])] {
        let rotated: Vec<GrayImage> = images
            .iter()
            .enumerate()
            .map(
                |(k, image)| {
                    if k % every == 1 { imageops::rotate180(image) } else { image.clone() }
                },
            )
            .collect();
        let found = calibrated(&rotated);
        let reasons = found.verdict.reasons.join("\n");
        let is_named = named
            .iter()
            .any(|names| reasons.contains(&format!("images differ in principal point: {names}")));
        assert!(found.verdict.grade == Grade::Poor && is_named, "{reasons}");
        expect_truth(&found, 2.5);
    }
}

/// The camera of these photographs, a Kodak Z612, has an optical stabilizer, which moves the
/// principal point: by 5 px between these images.
#[test]
fn a_camera_that_stabilizes_its_images_is_named() {
    let Some(images) = photographs("sceaux") else { return };
    let reasons = calibrated(&images).verdict.reasons.join("\n");
    assert!(reasons.contains("images differ in principal point"), "{reasons}");
}

/// These photographs determine neither the focal length to 1 % nor the pixels' aspect.
#[test]
fn what_is_given_and_cannot_be_verified_is_named() {
    let Some(images) = photographs("temple-ring") else { return };
    // The truth is 1520.4.
    let given = GivenParameter { name: "fx".to_owned(), value: 1475.0 };
    let found = calibrated_with(&images, vec![given]);
    let reasons = found.verdict.reasons.join("\n");
    let named = "cannot verify what is given: alone they determine fx only as 15";
    assert!(found.verdict.grade != Grade::Good && reasons.contains(named), "{reasons}");
    assert!(reasons.contains("fy / fx beyond the prior"), "{reasons}");
    assert!(reasons.contains("square pixels"), "{reasons}");
}

#[test]
fn the_robot_in_view_is_no_part_of_the_scene() {
    let Some(mut images) = photographs("strecha-herzjesu/images") else { return };
    let Some(other) = photographs("sceaux") else { return };
    // The lowest fifth of every image shows the same, which is fixed to the camera.
    let (height, part) = (images[0].height(), images[0].height() / 5);
    let robot = imageops::crop_imm(&other[4], 0, other[4].height() - part, WIDTH, part).to_image();
    for image in &mut images {
        imageops::replace(image, &robot, 0, i64::from(height - part));
    }
    let found = calibrated(&images);
    assert!(found.views.iter().all(|view| view.reason.is_none()), "{:?}", found.views);
    expect_truth(&found, 2.5);
}
