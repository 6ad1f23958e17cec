//! `plumb autocalibrate` as its users run it: a rendered room with exact truth, and images that
//! determine nothing.

use std::fs;
use std::path::{Path, PathBuf};

use image::{GrayImage, Luma};
use nalgebra::Vector3;
use plumb::geometry::pose::Pose;
use serde_json::Value;

use crate::program::{Finished, plumb};

const WIDTH: u32 = 400;
const HEIGHT: u32 = 300;
const FOCAL_PX: f64 = 380.0;
const CENTER_PX: [f64; 2] = [203.0, 147.0];

/// Values at the corners of a grid, the same for the same place.
fn corner(x: i64, y: i64, salt: u64) -> f64 {
    let mut bits = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ salt.wrapping_mul(0x1656_67b1_9e37_79f9);
    for _ in 0..2 {
        bits = (bits ^ (bits >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    ((bits >> 40) as f64) / f64::from(1 << 24)
}

/// Smooth noise of several sizes.
fn texture(u: f64, v: f64, salt: u64) -> f64 {
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    [(2.3, 0.35), (5.1, 0.4), (11.7, 0.35), (23.0, 0.3)]
        .iter()
        .enumerate()
        .map(|(k, (frequency, amplitude))| {
            let (x, y) = (u * frequency, v * frequency);
            let (fx, fy) = (smooth(x - x.floor()), smooth(y - y.floor()));
            let at = |dx: i64, dy: i64| {
                corner(x.floor() as i64 + dx, y.floor() as i64 + dy, salt + 16 * k as u64)
            };
            let upper = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
            let lower = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
            amplitude * (upper * (1.0 - fy) + lower * fy)
        })
        .sum::<f64>()
        / 1.4
}

/// The inside of a box from -1.6 to 1.6, -1.2 to 1.2 and -3 to 3, seen from `center` along `ray`.
fn room(center: Vector3<f64>, ray: Vector3<f64>) -> f64 {
    let reach = [1.6, 1.2, 3.0];
    let hit = |k: usize| (reach[k] * ray[k].signum() - center[k]) / ray[k];
    let wall = (0..3).min_by(|a, b| hit(*a).total_cmp(&hit(*b))).unwrap();
    let at = center + ray * hit(wall);
    let [u, v] = [[1, 2], [0, 2], [0, 1]][wall].map(|k| at[k]);
    texture(u, v, wall as u64 * 2 + u64::from(ray[wall] > 0.0))
}

fn render(camera_from_room: &Pose) -> GrayImage {
    let room_from_camera = camera_from_room.inverse();
    let center = room_from_camera.translation();
    GrayImage::from_fn(WIDTH, HEIGHT, |column, row| {
        let sample = |k: u32| {
            let [dx, dy] = [f64::from(k % 2) * 0.5 - 0.25, f64::from(k / 2) * 0.5 - 0.25];
            let x = (f64::from(column) + dx - CENTER_PX[0]) / FOCAL_PX;
            let y = (f64::from(row) + dy - CENTER_PX[1]) / FOCAL_PX;
            room(center, room_from_camera.rotation() * Vector3::new(x, y, 1.0))
        };
        Luma([(255.0 * (0..4).map(sample).sum::<f64>() / 4.0) as u8])
    })
}

/// A camera at `center` rotated by `angles` (about x and y), then about its own axis by `roll`.
fn camera(center: [f64; 3], angles: [f64; 2], roll: f64) -> Pose {
    let pan = Pose::from_axis_angle(Vector3::new(angles[0], angles[1], 0.0), Vector3::zeros());
    let about_axis = Pose::from_axis_angle(Vector3::new(0.0, 0.0, roll), Vector3::zeros());
    let rotation = (about_axis * pan).rotation();
    Pose::new(rotation, -(rotation * Vector3::from(center)))
}

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
    let unknown = autocalibrate(&["--lens", "pinhole", "--given", "k9=1"], &same);
    assert_eq!(unknown.code, Some(1), "{unknown:?}");
}

#[test]
fn arguments_that_mean_nothing_are_usage_errors() {
    for wrong in [["--lens", "nonsense"], ["--given", "fx=abc"]] {
        let finished = autocalibrate(&wrong, &[PathBuf::from("a.png")]);
        assert_eq!(finished.code, Some(2), "{finished:?}");
        assert!(finished.stderr.contains(wrong[1]), "{finished:?}");
    }
}
