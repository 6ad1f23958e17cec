//! Color and depth that are not taken at the same time, through `plumb calibrate`: against exact
//! truth.

use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;

fn plumb(arguments: &[&str]) -> Vec<u8> {
    let output = Command::new(env!("CARGO_BIN_EXE_plumb")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// The calibration of a recording, and what is true of it.
fn calibrated(recording: &Path) -> (Value, Value) {
    let source = recording.display().to_string();
    let asked = ["calibrate", "--json", "--board", "9x6", "--square", "40mm", &source];
    let truth = std::fs::read(recording.with_extension("truth.json")).unwrap();
    (serde_json::from_slice(&plumb(&asked)).unwrap(), serde_json::from_slice(&truth).unwrap())
}

fn rotation(pose: &Value) -> UnitQuaternion<f64> {
    let [w, x, y, z] = ["w", "x", "y", "z"].map(|k| pose["rotation"][k].as_f64().unwrap());
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

fn vector(numbers: &Value) -> Vector3<f64> {
    Vector3::from_iterator((0..3).map(|k| numbers[k].as_f64().unwrap()))
}

/// The sensors' pose within 3 σ of the truth on each axis, and within 0.3 mm and 0.02°; the time
/// within 3 σ and 2 ms.
fn expect((calibration, truth): &(Value, Value)) {
    let named = |all: &Value| {
        all["extrinsics"]
            .as_array()
            .unwrap()
            .iter()
            .find(|pose| pose["name"] == "color_from_depth")
            .unwrap()
            .clone()
    };
    let (found, exact) = (named(calibration), named(truth));
    let rotated = (rotation(&found) * rotation(&exact).inverse()).scaled_axis();
    let moved = vector(&found["translation"]) - vector(&exact["translation"]);
    for (off, std) in
        [(rotated, vector(&found["rotation_std"])), (moved, vector(&found["translation_std"]))]
    {
        assert!((0..3).all(|k| off[k].abs() < 3.0 * std[k]), "{off:?} ± {std:?}");
    }
    assert!(
        moved.norm() < 3e-4 && rotated.norm().to_degrees() < 0.02,
        "{moved:?} m, {rotated:?} rad"
    );
    let depth = &calibration["sensors"]["depth"];
    let offset_ms = depth["time_offset_ms"].as_f64().unwrap();
    let std_ms = depth["time_offset_std_ms"].as_f64().unwrap();
    let exact_ms = truth["depth"]["time_offset_s"].as_f64().unwrap() * 1e3;
    let off_ms = (offset_ms - exact_ms).abs();
    assert!(off_ms < 2.0 && off_ms < 3.0 * std_ms, "{offset_ms} ± {std_ms} ms, truth {exact_ms}");
    println!("{moved:?} m, {rotated:?} rad, {offset_ms} ± {std_ms} ms, truth {exact_ms}");
}

#[test]
fn the_bundled_recording() {
    expect(&calibrated(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("recordings/rgbd.mcap")));
}

#[test]
fn a_board_that_is_carried_about_before_another_rig() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    let text = "seed = 22\nframes = 90\nfps = 15\n[board]\nsquare_m = 0.04\n[walk]\nstill_s = 0.2\ntravel_s = 0.6\n\
                [depth]\ntime_offset_ms = -25.0\n";
    std::fs::write(&scene, text).unwrap();
    let out = folder.path().join("rig.mcap");
    plumb(&["simulate", "--config", scene.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    expect(&calibrated(&out));
}
