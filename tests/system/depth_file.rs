//! The exported depth correction, read by the readers that are given away with it: the numbers of
//! the library itself.

use std::path::{Path, PathBuf};
use std::process::Command;

use plumb::calibration::result::{Calibration, SensorResult};
use plumb::document::calibration::CalibrationDocument;
use plumb::export::{ExportOptions, Format, export};
use plumb::geometry::depth_camera::{DepthCamera, DepthReading};
use plumb::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use plumb::geometry::pixel::ImageSize;
use plumb::geometry::pose::Pose;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::registration::DepthRegistration;

use crate::not_tested::not_tested;

const SIZE: ImageSize = ImageSize::new(40, 30);

fn readers() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/depth-correction")
}

/// A document with a lens; what is read is set by each case.
fn calibration(camera: impl FnOnce(&mut DepthCamera), invalid: Option<u16>) -> Calibration {
    let lens =
        r#"{"model": "pinhole", "fx": 36.0, "fy": 36.0, "cx": 19.5, "cy": 14.5, "skew": 0.0}"#;
    let std = r#"{"fx": 0.1, "fy": 0.1, "cx": 0.1, "cy": 0.1, "skew": 0.0}"#;
    let json = format!(
        r#"{{"id": "1", "camera": "front", "session": null, "created_at": "2026-01-01T00:00:00Z", "target": null,
        "sensors": {{"depth": {{"image_size": [40, 30], "kind": "depth", "unit_m": 0.001, "lens": {lens}, "lens_std": {std},
            "correction": null, "bias_m": {{"ranges": []}}, "noise_m": {{"constant": 0.0, "quadratic": 0.0}}}}}},
        "extrinsics": [], "checks": {{"split_half_ratio": null, "held_out_rms_px": null, "outlier_fraction": 0.0, "coverage": 1.0}},
        "verdict": {{"grade": "good", "reasons": []}}}}"#
    );
    let document: CalibrationDocument = serde_json::from_str(&json).unwrap();
    let mut calibration = Calibration::try_from(&document).unwrap();
    let Some(SensorResult::Depth(depth)) = calibration.sensors.first_mut().map(|s| &mut s.result)
    else {
        panic!("no depth: {calibration:?}")
    };
    camera(&mut depth.camera);
    depth.invalid = invalid;
    calibration
}

fn correction(quantity: CorrectedQuantity, grid: SplineGrid, terms: usize) -> DepthCorrection {
    let mut correction = DepthCorrection::none(quantity, terms, grid, [0.6, 2.5]);
    for (k, node) in correction.coefficients.iter_mut().enumerate() {
        *node = 0.02 * (1.7 * k as f64).sin();
    }
    correction
}

/// Calibrations of every kind, each with an image that has readings outside what was seen, none,
/// and the invalid one.
fn cases() -> Vec<(Calibration, DepthImage)> {
    let grid = SplineGrid { size: SIZE, cols: 5, rows: 4 };
    let image = |reading: &dyn Fn(usize) -> u16| {
        DepthImage::new(SIZE, (0..1200).map(reading).collect()).unwrap()
    };
    let metric = |k: usize| if k.is_multiple_of(7) { 0 } else { 300 + 3 * k as u16 };
    let disparity = |k: usize| if k.is_multiple_of(5) { 2047 } else { 400 + (k / 2) as u16 };
    vec![
        (calibration(|_| {}, None), image(&metric)),
        (
            calibration(
                |camera| {
                    camera.correction = Some(correction(CorrectedQuantity::InverseDepth, grid, 2));
                },
                None,
            ),
            image(&metric),
        ),
        (
            calibration(
                |camera| {
                    camera.correction =
                        Some(correction(CorrectedQuantity::Depth, SplineGrid::constant(SIZE), 3));
                },
                Some(306),
            ),
            image(&metric),
        ),
        (
            calibration(
                |camera| {
                    camera.reading = DepthReading::Disparity { offset: 3.1, slope: -0.0028 };
                    camera.correction = Some(correction(CorrectedQuantity::InverseDepth, grid, 3));
                },
                Some(2047),
            ),
            image(&disparity),
        ),
    ]
}

/// Writes each case as a file and its readings as text, runs `read` on both, and compares with the
/// library.
fn compared(folder: &Path, read: impl Fn(&Path, &Path) -> Command) {
    for (calibration, image) in cases() {
        let (file, readings) = (folder.join("depth.txt"), folder.join("raw.txt"));
        std::fs::write(
            &file,
            export(&calibration, Format::Depth, &ExportOptions::default()).unwrap().bytes,
        )
        .unwrap();
        let rows = (0..SIZE.height as usize)
            .map(|y| image.row(y).iter().map(ToString::to_string).collect::<Vec<_>>().join(" "));
        std::fs::write(&readings, rows.collect::<Vec<_>>().join("\n") + "\n").unwrap();
        let ran = read(&file, &readings).output().unwrap();
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        let text = String::from_utf8(ran.stdout).unwrap();
        let theirs: Vec<f64> =
            text.split_whitespace().map(|number| number.parse().unwrap()).collect();
        let depth = calibration.depth().unwrap();
        let registration =
            DepthRegistration::new(&depth.camera, &depth.camera.lens, SIZE, &Pose::identity());
        let ours = registration.depths_m(&image, depth.invalid);
        assert_eq!(theirs.len(), ours.len());
        assert!(ours.contains(&0.0) && ours.iter().filter(|depth| **depth > 0.0).count() > 900);
        for (k, (theirs, ours)) in theirs.iter().zip(&ours).enumerate() {
            // Images are corrected in single precision.
            assert!(
                (theirs - f64::from(*ours)).abs() < 1e-6 * theirs.max(1.0),
                "pixel {k}: {theirs}, but {ours}"
            );
        }
    }
}

fn runs(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|ran| ran.status.success())
}

/// A Python with numpy: the system's, or the one that `make python-test` sets up.
fn python() -> Option<PathBuf> {
    let set_up = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/venv/bin/python");
    let has_numpy = |python: &PathBuf| runs(&python.display().to_string(), &["-c", "import numpy"]);
    [PathBuf::from("python3"), set_up].into_iter().find(has_numpy)
}

#[test]
fn the_python_reader_gives_the_library_s_numbers() {
    let Some(python) = python() else {
        not_tested("the Python reader of depth corrections: no python3 with numpy");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let script = "import sys, numpy\nsys.path.insert(0, sys.argv[1])\nimport depth_correction as d\n\
        print(*d.meters(d.read(sys.argv[2]), numpy.loadtxt(sys.argv[3])).ravel().tolist())";
    compared(folder.path(), |file, readings| {
        let mut command = Command::new(&python);
        command.args(["-B", "-c", script]).arg(readers()).arg(file).arg(readings);
        command
    });
}

#[test]
fn the_cpp_reader_gives_the_library_s_numbers() {
    if !runs("g++", &["--version"]) {
        not_tested("the C++ reader of depth corrections: no g++");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let main = r#"#include "depth_correction.hpp"
        #include <cstdio>
        int main(int, char** argv) {
          DepthCorrection correction(argv[1]);
          std::ifstream raw(argv[2]);
          for (int v = 0; v < correction.height; ++v)
            for (int u = 0, reading; u < correction.width && raw >> reading; ++u)
              std::printf("%.17g ", correction.meters(u, v, reading));
        }"#;
    let (source, program) = (folder.path().join("main.cpp"), folder.path().join("reader"));
    std::fs::write(&source, main).unwrap();
    let built = Command::new("g++")
        .args(["-std=c++17", "-Wall", "-Wextra", "-Werror", "-I"])
        .arg(readers())
        .arg(&source)
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    compared(folder.path(), |file, readings| {
        let mut command = Command::new(&program);
        command.arg(file).arg(readings);
        command
    });
}
