//! `plumb calibrate --rig` on folders of images as people keep them: copies, images of another
//! size, without a board, or cut off.

use std::fs;
use std::path::Path;

use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode;
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::png_from_luma;
use plumb::recording::{ReadOptions, Recording};
use serde_json::Value;

use crate::program::{Finished, plumb};
use crate::served::recording;

/// Frame sets of the recordings that become images: few, as detection takes its time.
const SETS: usize = 8;

/// Images of both cameras, taken together, as `0.png` and so on in `left` and `right`.
fn write_images(folder: &Path) {
    for camera in ["left", "right"] {
        let path = recording(&format!("rig-{camera}.mcap"));
        let mut source = Recording::open(&path, &ReadOptions::default()).unwrap();
        let step = source.frame_set_count().unwrap() / SETS;
        fs::create_dir(folder.join(camera)).unwrap();
        let mut place = 0;
        while let Some(set) = source.next_frame_set().unwrap() {
            if place % step == 0 && place / step < SETS {
                let mut luma = GrayImage::default();
                decode::luma(&set.frames[0], &mut luma).unwrap();
                let name = format!("{camera}/{}.png", place / step);
                fs::write(folder.join(name), png_from_luma(luma.view())).unwrap();
            }
            place += 1;
        }
    }
}

fn calibrated(folder: &Path, more: &[&str]) -> Finished {
    let source = |camera: &str| format!("{camera}={}", folder.join(camera).display());
    let (left, right) = (source("left"), source("right"));
    let board = ["calibrate", "--json", "--board", "8x6", "--square", "30mm", "--lens", "brown"];
    let rig = ["--rig", &left, "--rig", &right];
    plumb(board.iter().chain(&rig).chain(more).map(|text| (*text).to_owned()))
}

fn document(ran: &Finished) -> Value {
    assert_eq!(ran.code, Some(0), "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

fn color(document: &Value, camera: usize) -> &Value {
    &document["cameras"][camera]["sensors"]["color"]
}

/// The reasons of the views that are not used, by their files' names.
fn unused(document: &Value, camera: usize) -> Vec<(String, String)> {
    let views = color(document, camera)["views"].as_array().unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let name = |view: &Value| text(&view["name"]).rsplit_once('/').unwrap().1.to_owned();
    let unused = views.iter().filter(|view| view["used"] == false);
    unused.map(|view| (name(view), text(&view["reason"]))).collect()
}

#[test]
fn copies_count_once_and_every_image_is_named() {
    let folder = tempfile::tempdir().unwrap();
    write_images(folder.path());
    let plain = document(&calibrated(folder.path(), &[]));
    for camera in ["left", "right"] {
        for set in 0..SETS {
            let copy = format!("{camera}/copy-{set}.png");
            fs::copy(folder.path().join(format!("{camera}/{set}.png")), folder.path().join(copy))
                .unwrap();
        }
    }
    let gray = GrayImage::from_pixels(640, 480, vec![90; 640 * 480]).unwrap();
    fs::write(folder.path().join("left/wall.png"), png_from_luma(gray.view())).unwrap();
    let whole = fs::read(folder.path().join("right/0.png")).unwrap();
    fs::write(folder.path().join("right/torn.png"), &whole[..whole.len() / 2]).unwrap();
    let with_copies = document(&calibrated(folder.path(), &[]));
    for camera in 0..2 {
        assert_eq!(color(&with_copies, camera)["lens"], color(&plain, camera)["lens"]);
        assert_eq!(color(&with_copies, camera)["lens_std"], color(&plain, camera)["lens_std"]);
        let before = unused(&plain, camera).len();
        let copies = unused(&with_copies, camera);
        let once = copies.iter().filter(|(_, reason)| reason.ends_with("it counts once"));
        assert_eq!((once.count(), copies.len()), (SETS - before, SETS + before + 1));
    }
    assert_eq!(with_copies["extrinsics"], plain["extrinsics"]);
    let has = |camera: usize, name: &str, part: &str| {
        let found = unused(&with_copies, camera).into_iter().find(|(known, _)| known == name);
        let reason = found.unwrap().1;
        assert!(reason.contains(part) && !reason.contains(name), "{reason}");
    };
    has(0, "wall.png", "contrast");
    has(1, "torn.png", "PNG");
}

#[test]
fn another_size_is_refused_and_so_is_a_lens_for_one() {
    let folder = tempfile::tempdir().unwrap();
    write_images(folder.path());
    let known = folder.path().join("known.json");
    let ran = calibrated(folder.path(), &["--out", known.to_str().unwrap()]);
    assert_eq!(ran.code, Some(0), "{}", ran.stderr);
    let smaller = folder.path().join("smaller.json");
    let [known, out] = [&known, &smaller].map(|path| path.display().to_string());
    let size = ["--width", "320", "--height", "240"];
    let export = ["export", "--format", "json", "--calibration", &known, "--out", &out];
    let ran = plumb(export.iter().chain(&size).map(|text| (*text).to_owned()));
    assert_eq!(ran.code, Some(0), "{}", ran.stderr);
    let ran = calibrated(folder.path(), &["--given", &format!("left.color={out}")]);
    assert_eq!(ran.code, Some(1), "{}", ran.stderr);
    assert!(ran.stderr.contains("the images are 640x480") && ran.stderr.contains("for 320x240"));
    let ran = calibrated(folder.path(), &["--given", "fx=1e9"]);
    assert_eq!(ran.code, Some(2), "{}", ran.stderr);
    assert!(ran.stderr.contains("--given: fx = 1000000000 px"), "{}", ran.stderr);
    let first = folder.path().join("left/0.png");
    let half = image::open(&first).unwrap().thumbnail_exact(320, 240);
    half.save(&first).unwrap();
    let ran = calibrated(folder.path(), &[]);
    assert_eq!(ran.code, Some(1), "{}", ran.stderr);
    let [small, large] = [ImageSize::new(320, 240), ImageSize::new(640, 480)];
    assert!(ran.stderr.contains(&format!("1.png is {large}")), "{}", ran.stderr);
    assert!(ran.stderr.contains(&format!("0.png is {small}")), "{}", ran.stderr);
}
