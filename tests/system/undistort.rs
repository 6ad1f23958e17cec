//! Images through a calibration, from the command line: what goes in comes out, undistorted or
//! rectified, with the bits it had.

use std::fs;
use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageBuffer, Luma, RgbImage};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use plumb::imaging::timestamp::HostTime;
use plumb::recording::McapWriter;
use serde_json::{Value, json};

use crate::program::plumb;

/// Values that 8 bits do not hold, as a camera of 12 bits gives them.
fn deep() -> ImageBuffer<Luma<u16>, Vec<u16>> {
    ImageBuffer::from_fn(64, 48, |x, y| Luma([(1000 + 37 * x + 11 * y) as u16]))
}

fn color() -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| image::Rgb([(3 * x) as u8, (5 * y) as u8, 90]))
}

/// A sensor without distortion, whose undistorted images are the images.
fn sensor() -> Value {
    let lens = json!({"model": "pinhole", "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5});
    json!({
        "image_size": [64, 48], "lens": lens, "rms_px": 0.1, "views": [],
        "lens_std": {"fx": 0.1, "fy": 0.1, "cx": 0.1, "cy": 0.1},
        "uncertainty_px": {"center": 0.1, "median": 0.1, "worst": 0.1},
    })
}

fn calibration(folder: &Path, own: &Value) -> String {
    let mut document = json!({
        "id": "1", "camera": "front", "session": null, "created_at": "2026-01-01T00:00:00Z",
        "target": null, "sensors": {}, "extrinsics": [],
        "checks": {"split_half_ratio": null, "held_out_rms_px": null, "outlier_fraction": 0.0, "coverage": 1.0},
        "verdict": {"grade": "good", "reasons": []},
    });
    for (name, value) in own.as_object().unwrap() {
        document[name] = value.clone();
    }
    let file = folder.join("calibration.json");
    fs::write(&file, document.to_string()).unwrap();
    file.display().to_string()
}

fn done(arguments: &[&str]) {
    let finished = plumb(arguments);
    assert_eq!(finished.code, Some(0), "{arguments:?}: {}", finished.stderr);
}

/// The only PNG file of a folder.
fn written(folder: &Path) -> DynamicImage {
    let files: Vec<PathBuf> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    image::open(&files[0]).unwrap()
}

#[test]
fn sixteen_bits_come_out_of_files_folders_and_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let text = |path: PathBuf| path.display().to_string();
    let known =
        calibration(folder.path(), &json!({"sensors": {"color": sensor(), "infrared": sensor()}}));
    deep().save(at("deep.png")).unwrap();
    for (sensor, name) in [("color", "rgbd/color"), ("infrared", "rgbd/infrared")] {
        fs::create_dir_all(at(name)).unwrap();
        let file = at(name).join("00.png");
        if sensor == "color" { color().save(file) } else { deep().save(file) }.unwrap();
    }
    let bytes: Vec<u8> = deep().into_raw().into_iter().flat_map(u16::to_le_bytes).collect();
    let frame = |sensor, format, stride, bytes: &[u8]| Frame {
        sensor,
        size: ImageSize::new(64, 48),
        format,
        stride,
        bytes: bytes.into(),
    };
    let mut recording = McapWriter::create(&at("rgbd.mcap"), "front").unwrap();
    let frames = vec![
        frame(SensorKind::Color, PixelFormat::Rgb8, 3 * 64, color().as_raw()),
        frame(SensorKind::Infrared, PixelFormat::Mono16, 2 * 64, &bytes),
    ];
    let host_time = HostTime { utc_ns: 1_000_000_000 };
    let set = FrameSet { sequence: 0, host_time, device_time: None, name: None, frames };
    recording.write(&set).unwrap();
    recording.finish().unwrap();

    for (number, (source, sensor)) in [
        ("deep.png", "color"),
        ("deep.png", "infrared"),
        ("rgbd", "infrared"),
        ("rgbd.mcap", "infrared"),
        ("rgbd", "color"),
        ("rgbd.mcap", "color"),
    ]
    .into_iter()
    .enumerate()
    {
        let (out, source) = (at(&format!("out-{number}")), text(at(source)));
        let asked = ["undistort", "--calibration", &known, "--sensor", sensor, "--out"];
        done(&[&asked[..], &[&text(out.clone()), &source]].concat());
        let expected = match source.ends_with("deep.png") || sensor == "infrared" {
            true => DynamicImage::ImageLuma16(deep()),
            false => DynamicImage::ImageRgb8(color()),
        };
        assert!(written(&out) == expected, "{source}, {sensor}");
    }
}

#[test]
fn rectified_images_keep_sixteen_bits() {
    let folder = tempfile::tempdir().unwrap();
    let text = |name: &str| folder.path().join(name).display().to_string();
    let camera = |name: &str| json!({"name": name, "sensors": {"color": sensor()}});
    let pose = json!({
        "name": "left_from_right", "rotation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
        "translation": [0.1, 0.0, 0.0], "rotation_std": [0.0, 0.0, 0.0], "translation_std": [0.0, 0.0, 0.0],
    });
    let rig = json!({"camera": "head", "cameras": [camera("left"), camera("right")], "extrinsics": [pose]});
    let known = calibration(folder.path(), &rig);
    deep().save(text("deep.png")).unwrap();
    color().save(text("color.png")).unwrap();
    let out = text("out");
    done(&["rectify", "--rig", &known, "--out", &out, &text("deep.png"), &text("color.png")]);
    assert!(written(&Path::new(&out).join("left")) == DynamicImage::ImageLuma16(deep()));
    assert!(written(&Path::new(&out).join("right")) == DynamicImage::ImageRgb8(color()));
}
