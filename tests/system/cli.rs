//! The command line's own rules: help, one JSON document on stdout, exit codes, closed pipes.

use serde_json::Value;

use crate::program::plumb;
use crate::served::recording;

const COMMANDS: &[&str] = &[
    "serve",
    "detect",
    "calibrate",
    "solve",
    "devices",
    "export",
    "simulate",
    "record",
    "rectify",
    "verify",
    "focus",
    "uncertainty",
    "board",
    "target",
];

#[test]
fn every_command_has_help() {
    let listed = plumb(["--help"]);
    assert_eq!((listed.code, listed.stderr.as_str()), (Some(0), ""));
    for command in COMMANDS {
        assert!(listed.stdout.contains(command), "{command} is not listed: {}", listed.stdout);
        let help = plumb([command, "--help"]);
        assert_eq!((help.code, help.stderr.as_str()), (Some(0), ""), "{command}");
        assert!(
            help.stdout.contains("Usage: plumb ") && help.stdout.contains("--help"),
            "{}",
            help.stdout
        );
    }
}

#[test]
fn the_version_is_the_package_s() {
    assert_eq!(plumb(["--version"]).stdout, concat!("plumb ", env!("CARGO_PKG_VERSION"), "\n"));
}

#[test]
fn the_focus_of_a_machine_vision_lens() {
    let asked = [
        "focus",
        "--json",
        "--focal",
        "8mm",
        "--f-number",
        "2",
        "--pixel",
        "3.45um",
        "--focus",
        "1m",
    ];
    let answer: serde_json::Value = serde_json::from_str(&plumb(asked).stdout).unwrap();
    let number = |path: &str| answer.pointer(path).and_then(serde_json::Value::as_f64).unwrap();
    // H = f²/(N c) + f, near = s (H − f)/(H + s − 2 f), far = s (H − f)/(H − s).
    let hyperfocal_m = 0.008 * 0.008 / (2.0 * 3.45e-6) + 0.008;
    assert!((number("/hyperfocal_m") - hyperfocal_m).abs() < 1e-9, "{answer}");
    assert!(
        (number("/depth_of_field/near_m") - (hyperfocal_m - 0.008) / (hyperfocal_m + 1.0 - 0.016))
            .abs()
            < 1e-9,
        "{answer}"
    );
    assert!(
        (number("/depth_of_field/far_m") - (hyperfocal_m - 0.008) / (hyperfocal_m - 1.0)).abs()
            < 1e-9,
        "{answer}"
    );
}

#[test]
fn the_order_of_images_ends_with_what_their_calibration_states() {
    let hard = recording("hard.mcap").display().to_string();
    let calibrate =
        ["calibrate", "--board", "9x6", "--square", "25mm", "--lens", "brown", "--json"];
    let document = |extra: &[&str]| -> Value {
        let finished = plumb([&calibrate[..], extra, &[&hard]].concat());
        assert_eq!(finished.code, Some(0), "{}", finished.stderr);
        serde_json::from_str(&finished.stdout).unwrap()
    };
    let calibration = document(&[]);
    let stated_px = calibration["sensors"]["color"]["uncertainty_px"]["worst"].as_f64().unwrap();
    let ordered = document(&["--order"]);
    let last = ordered["order"].as_array().unwrap().last().unwrap();
    for (what, figure) in [("last", last), ("next", &ordered["next"])] {
        let figure_px = figure["uncertainty_px"].as_f64().unwrap();
        assert!((figure_px / stated_px - 1.0).abs() < 1e-9, "{what}: {figure_px}, {stated_px}");
    }
}
