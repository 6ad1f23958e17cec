//! The bundled walk through `plumb calibrate`: against its exact truth, the same bytes every time,
//! and verified afterwards.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn recording(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings").join(name)
}

fn plumb(arguments: &[&str], recording: &Path) -> Value {
    let output =
        Command::new(env!("CARGO_BIN_EXE_plumb")).args(arguments).arg(recording).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn calibrate(threads: &str) -> Value {
    let board = ["--board", "9x6", "--square", "25mm", "--lens", "brown", "--threads", threads];
    plumb(&[&["calibrate", "--json"], board.as_slice()].concat(), &recording("walk.mcap"))
}

#[test]
fn the_truth_lies_within_the_predicted_uncertainty() {
    let truth: Value =
        serde_json::from_slice(&std::fs::read(recording("walk.truth.json")).unwrap()).unwrap();
    let sensor = &calibrate("2")["sensors"]["color"];
    for name in ["fx", "fy", "cx", "cy"] {
        let number = |of: &Value| of[name].as_f64().unwrap();
        let (found, std) = (number(&sensor["lens"]), number(&sensor["lens_std"]));
        let exact = number(&truth["sensors"]["color"]["lens"]);
        let error = (found - exact).abs();
        assert!(
            error < 3.0 * std && error < 0.001 * exact,
            "{name}: {found} ± {std}, truth {exact}"
        );
    }
}

#[test]
fn ten_replays_with_one_thread_and_two_are_the_same_to_the_byte() {
    let strip = |mut calibration: Value| {
        for unique in ["id", "created_at"] {
            calibration[unique].take();
        }
        calibration.to_string()
    };
    let first = strip(calibrate("1"));
    for replay in 1..10 {
        let again = strip(calibrate(if replay % 2 == 0 { "1" } else { "2" }));
        assert!(again == first, "replay {replay} differs");
    }
}

#[test]
fn a_calibration_is_verified_until_the_lens_changes() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("front.json");
    let mut calibration = calibrate("2");
    let mut verify = |fx_factor: f64| {
        let fx = calibration["sensors"]["color"]["lens"]["fx"].as_f64().unwrap();
        calibration["sensors"]["color"]["lens"]["fx"] = (fx * fx_factor).into();
        std::fs::write(&file, calibration.to_string()).unwrap();
        let asked = ["verify", "--json", "--board", "9x6", "--calibration", file.to_str().unwrap()];
        plumb(&asked, &recording("walk.mcap"))
    };
    let same = verify(1.0);
    assert_eq!(same["holds"], true, "{same}");
    let refocused = verify(1.01);
    assert!(refocused["holds"] == false && refocused["reasons"][0].is_string(), "{refocused}");
    // A calibration that is uncertain by itself contradicts little, and that is reported.
    calibration["sensors"]["color"]["uncertainty_px"]["median"] = 2.0.into();
    std::fs::write(&file, calibration.to_string()).unwrap();
    let asked = ["verify", "--json", "--board", "9x6", "--calibration", file.to_str().unwrap()];
    let uncertain = plumb(&asked, &recording("walk.mcap"));
    let reasons = uncertain["reasons"].to_string();
    let said = reasons.contains("less than 7.1 px cannot be detected")
        && reasons.contains("calibrate again with more views, tilted more strongly");
    assert!(uncertain["holds"] == true && said, "{uncertain}");
}
