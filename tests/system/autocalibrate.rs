//! `plumb autocalibrate` as its users run it: a rendered room with exact truth, and images that
//! determine nothing.

use std::fs;
use std::path::{Path, PathBuf};

use image::GrayImage;
use plumb::geometry::pose::Pose;
use serde_json::Value;

use crate::program::{Finished, plumb};
use crate::room::{RoomCamera, camera, rendered};

const FOCAL_PX: f64 = 380.0;

fn moving() -> Vec<Pose> {
    (0..7)
        .map(|k| {
            let part = f64::from(k) / 3.0 - 1.0;
            let height = if k % 2 == 0 { 0.5 } else { -0.5 };
            let roll = if k % 3 == 1 { 1.5 } else { 0.0 };
            camera([1.3 * part, height, -0.4 * part], [0.08 * height, 0.25 * part], roll)
        })
        .collect()
}

fn rotating() -> Vec<Pose> {
    (0..7)
        .map(|k| {
            let angle = f64::from(k) * 0.9;
            let roll = if k % 3 == 1 { 1.5 } else { 0.0 };
            camera([0.2, 0.1, -1.0], [0.16 * angle.sin(), 0.24 * angle.cos()], roll)
        })
        .collect()
}

fn render(camera_from_room: &Pose) -> GrayImage {
    let camera = RoomCamera { size: [400, 300], focal_px: FOCAL_PX, center_px: [203.0, 147.0] };
    rendered(camera_from_room, &camera)
}

fn written(folder: &Path, images: &[GrayImage]) -> Vec<PathBuf> {
    let write = |(k, image): (usize, &GrayImage)| {
        let path = folder.join(format!("{k:02}.png"));
        image.save(&path).unwrap();
        path
    };
    images.iter().enumerate().map(write).collect()
}

fn autocalibrate(more: &[&str], images: &[PathBuf]) -> Finished {
    let images = images.iter().map(|path| path.to_str().unwrap());
    plumb(["autocalibrate"].into_iter().chain(more.iter().copied()).chain(images))
}

/// One line on standard error, exit code 1, and nothing on standard output.
fn assert_refused(finished: &Finished, naming: &str) {
    assert_eq!(finished.code, Some(1), "{finished:?}");
    assert!(finished.stdout.is_empty() && finished.stderr.contains(naming), "{finished:?}");
    assert_eq!(finished.stderr.trim_end().lines().count(), 1, "{finished:?}");
}

/// The document of a solve, less what differs from run to run.
fn document(threads: &str, images: &[PathBuf], cloud: &str) -> Value {
    let arguments = ["--lens", "radial", "--json", "--threads", threads, "--points", cloud];
    let finished = autocalibrate(&arguments, images);
    assert_eq!(finished.code, Some(0), "{finished:?}");
    let mut document: Value = serde_json::from_str(&finished.stdout).unwrap();
    for own in ["id", "created_at", "elapsed_ms"] {
        document.as_object_mut().unwrap().remove(own);
    }
    document
}

#[test]
fn a_camera_that_only_rotates_gives_its_focal_length_whatever_the_threads() {
    let folder = tempfile::tempdir().unwrap();
    let images: Vec<GrayImage> = rotating().iter().map(render).collect();
    let images = written(folder.path(), &images);
    let cloud = folder.path().join("cloud.ply");
    let document = ["1", "2"].map(|threads| document(threads, &images, cloud.to_str().unwrap()));
    assert_eq!(document[0], document[1]);
    let document = &document[0];
    assert_eq!(document["target"], serde_json::json!({"kind": "scene"}));
    assert_eq!(document["scene_unit"], Value::Null);
    let color = &document["sensors"]["color"];
    let [value, std] = ["lens", "lens_std"].map(|of| color[of]["fx"].as_f64().unwrap());
    assert!((value - FOCAL_PX).abs() < 3.5 * std && std < 0.03 * FOCAL_PX, "{value} ± {std}");
    let reasons = document["verdict"]["reasons"].to_string();
    assert!(reasons.contains("the camera only rotated"), "{reasons}");
}

#[test]
fn the_robot_in_view_is_no_part_of_the_scene() {
    // The lowest fifth of each image shows what is fixed to the camera.
    let mut random = 1_u32;
    let blocks: Vec<u8> = (0..80 * 12)
        .map(|_| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 24) as u8
        })
        .collect();
    let with_robot = |mut image: GrayImage| {
        for (x, y, pixel) in image.enumerate_pixels_mut().filter(|(_, y, _)| *y >= 240) {
            pixel.0[0] = blocks[(y - 240) as usize / 5 * 80 + x as usize / 5];
        }
        image
    };
    let folder = tempfile::tempdir().unwrap();
    let images: Vec<GrayImage> = rotating().iter().map(render).map(with_robot).collect();
    let images = written(folder.path(), &images);
    let cloud = folder.path().join("cloud.ply");
    let document = document("2", &images, cloud.to_str().unwrap());
    let color = &document["sensors"]["color"];
    let [value, std] = ["lens", "lens_std"].map(|of| color[of]["fx"].as_f64().unwrap());
    assert!((value - FOCAL_PX).abs() < 3.5 * std && std < 0.03 * FOCAL_PX, "{value} ± {std}");
}

#[test]
fn a_calibration_is_verified_against_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let images: Vec<GrayImage> = rotating().iter().map(render).collect();
    let images = written(folder.path(), &images);
    let file = folder.path().join("calibration.json");
    let file = file.to_str().unwrap();
    let made = autocalibrate(&["--lens", "radial", "--out", file], &images);
    assert_eq!(made.code, Some(0), "{made:?}");
    let verify = || {
        let images = images.iter().map(|path| path.to_str().unwrap());
        let asked = ["verify", "--scene", "--json", "--calibration", file];
        let finished = plumb(asked.into_iter().chain(images));
        assert_eq!(finished.code, Some(0), "{finished:?}");
        serde_json::from_str::<Value>(&finished.stdout).unwrap()
    };
    let same = verify();
    assert_eq!((&same["holds"], &same["views"]), (&Value::Bool(true), &Value::from(7)), "{same}");
    assert!(same["moved_px"].as_f64().unwrap() < 1e-6, "{same}");
    // A lens that is a fifth longer is another one, whatever the images leave open.
    let mut document: Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
    for name in ["fx", "fy"] {
        let focal = &mut document["sensors"]["color"]["lens"][name];
        *focal = Value::from(1.2 * focal.as_f64().unwrap());
    }
    fs::write(file, document.to_string()).unwrap();
    let other = verify();
    assert_eq!(other["holds"], Value::Bool(false), "{other}");
    assert!(other["reasons"].to_string().contains("calibrate again"), "{other}");
}

#[test]
fn a_single_wall_is_refused_as_one_plane() {
    // From these places the field of view ends within the wall at the far end.
    let folder = tempfile::tempdir().unwrap();
    let images: Vec<GrayImage> = moving().iter().map(render).collect();
    let images = written(folder.path(), &images);
    assert_refused(&autocalibrate(&["--lens", "radial"], &images), "one plane is all");
}

#[test]
fn what_determines_no_lens_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let image = render(&camera([0.0; 3], [0.0; 2], 0.0));
    let same = written(folder.path(), &vec![image.clone(); 8]);
    assert_refused(&autocalibrate(&[], &same[..2]), "2 images are too few");
    assert_refused(&autocalibrate(&[], &same), "the camera stood still");
    let other = folder.path().join("other.png");
    image::imageops::rotate90(&image).save(&other).unwrap();
    let mixed = [same[0].clone(), same[1].clone(), other];
    assert_refused(&autocalibrate(&[], &mixed), "other.png` is 300x400, the others are 400x300");
    let missing = [same[0].clone(), same[1].clone(), folder.path().join("missing.png")];
    assert_refused(&autocalibrate(&[], &missing), "missing.png: there is no such file");
    let words = folder.path().join("words.png");
    fs::write(&words, b"no image at all").unwrap();
    assert_refused(&autocalibrate(&[], &[same[0].clone(), same[1].clone(), words]), "words.png");
    let other_lens = autocalibrate(&["--lens", "pinhole", "--given", "k1=1"], &same);
    assert_refused(&other_lens, "a pinhole lens has no parameter `k1`");
}

#[test]
fn arguments_that_mean_nothing_are_usage_errors() {
    let lens = [["--lens", "nonsense"]];
    let given = ["fx=abc", "foo=0.1", "fx=-3", "fy=0", "fx=nan"].map(|given| ["--given", given]);
    for wrong in lens.into_iter().chain(given) {
        let finished = autocalibrate(&wrong, &[PathBuf::from("a.png")]);
        assert_eq!(finished.code, Some(2), "{finished:?}");
        assert!(wrong.iter().all(|word| finished.stderr.contains(word)), "{finished:?}");
    }
    let folder = tempfile::tempdir().unwrap();
    let image = render(&camera([0.0; 3], [0.0; 2], 0.0));
    let finished = autocalibrate(&["--given", "fx=1e9"], &written(folder.path(), &vec![image; 3]));
    assert_eq!(finished.code, Some(2), "{finished:?}");
    assert!(finished.stderr.contains("--given: fx = 1000000000 px"), "{finished:?}");
}

#[test]
fn a_given_focal_length_that_the_images_contradict_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let images: Vec<GrayImage> = rotating().iter().map(render).collect();
    let images = written(folder.path(), &images);
    // Of a focal length that is far off there may be no fit at all.
    let answer = |focal_px: f64| {
        let given = format!("fx={focal_px}");
        let finished = autocalibrate(&["--lens", "radial", "--json", "--given", &given], &images);
        let is_poor = finished.stdout.contains("\"grade\": \"poor\"")
            || finished.stdout.contains("\"grade\":\"poor\"");
        (is_poor || finished.code == Some(1), finished.stdout + &finished.stderr)
    };
    for off in [0.8, 1.25] {
        let (is_poor, said) = answer(off * FOCAL_PX);
        assert!(is_poor && said.contains("the images contradict the given fx"), "{said}");
    }
    let (_, said) = answer(FOCAL_PX);
    assert!(!said.contains("contradict"), "{said}");
}
