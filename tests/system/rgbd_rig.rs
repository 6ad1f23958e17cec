//! Two cameras with color, infrared and depth as one rig, through the daemon and on the command
//! line: every sensor of both is placed, and held to the truth that the recordings were made of.
//! `benches/rig_of_devices.py` does the same for any number of seeds.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumb::geometry::pose::Pose;
use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::Served;

const SCENE: &str = "frames = 60\nfps = 5\n[camera]\njpeg_quality = 87\n[board]\nsquare_m = 0.04\n[walk]\nstill_s = 0.3\ntravel_s = 0.3\nwidth = [0.3, 0.6]\n[depth]\nnoise_per_m = 0.0015\nstep_per_m = 0.004\n";
/// Standard deviations that a figure may be off by: of 30 figures of ten seeds one is beyond 3.5 by
/// chance in 7 runs of 100.
const MOST_STD: f64 = 3.5;

fn pose(document: &Value) -> Pose {
    let [w, x, y, z] = ["w", "x", "y", "z"].map(|k| document["rotation"][k].as_f64().unwrap());
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let at = |k: usize| document["translation"][k].as_f64().unwrap();
    Pose::new(rotation, Vector3::new(at(0), at(1), at(2)))
}

/// A camera's recording, and what is true of it.
struct Device {
    path: String,
    truth: Value,
}

impl Device {
    fn simulate(folder: &Path, seed: u64, seat: usize, name: &str) -> Self {
        let (scene, file) =
            (folder.join(format!("{name}.toml")), folder.join(format!("{name}.mcap")));
        std::fs::write(&scene, format!("seed = {seed}\nseat = {seat}\n{SCENE}")).unwrap();
        let [config, out] = [&scene, &file].map(|path| path.to_str().unwrap().to_owned());
        let simulated = plumb(["simulate", "--config", &config, "--out", &out]);
        assert_eq!(simulated.code, Some(0), "{}", simulated.stderr);
        let truth = std::fs::read(file.with_extension("truth.json")).unwrap();
        Self { path: out, truth: serde_json::from_slice(&truth).unwrap() }
    }

    fn color_from(&self, sensor: &str) -> Pose {
        let name = format!("color_from_{sensor}");
        let extrinsics = self.truth["extrinsics"].as_array().unwrap();
        pose(extrinsics.iter().find(|pose| pose["name"] == *name).unwrap())
    }

    fn color_from_board(&self) -> Pose {
        pose(&self.truth["frames"][0]["camera_from_board"])
    }
}

fn configuration(devices: &[(&str, &Device)]) -> String {
    let camera = |(name, device): &(&str, &Device)| {
        let path = &device.path;
        format!(
            "[[camera]]\nname = {name:?}\nsource = {{ kind = \"recording\", path = {path:?}, pace = \"fastest\" }}\n"
        )
    };
    devices.iter().map(camera).collect::<String>()
        + "[[rig]]\nname = \"head\"\ncameras = [\"left\", \"right\"]\n"
}

/// The calibration of a session over the recordings.
fn calibrate(served: &Served, request: &Value) -> Value {
    let mut events = served.events("?camera=head", Some("0"));
    let started = served.post("/v1/rigs/head/sessions", request);
    assert_eq!(started.status, 201, "{}", started.text());
    let id = started.json()["id"].as_str().unwrap().to_owned();
    events.until(|event| {
        let ended =
            event.data["reason"].as_str().is_some_and(|reason| reason.contains("has ended"));
        event.name == "session" && event.data["id"] == *id && ended
    });
    let session = served.post_nothing(&format!("/v1/sessions/{id}/stop")).json();
    assert_eq!(session["state"], "finished", "{session}");
    served.get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap())).json()
}

/// The figures of a pose over their standard deviations.
fn errors_in_std(found: &Value, truth: &Pose) -> Vec<f64> {
    let found_pose = pose(found);
    let rotation = (found_pose.rotation() * truth.rotation().inverse()).scaled_axis();
    let translation = found_pose.translation() - truth.translation();
    let std = |key: &str, axis: usize| found[key][axis].as_f64().unwrap();
    let figures = (0..3).flat_map(|axis| {
        [
            rotation[axis] / std("rotation_std", axis),
            translation[axis] / std("translation_std", axis),
        ]
    });
    figures.collect()
}

/// The calibration by the command line.
fn calibrated_offline(devices: &[(&str, &Device)]) -> Value {
    let source =
        |(name, device): &(&str, &Device)| ["--rig".to_owned(), format!("{name}={}", device.path)];
    let board = ["calibrate", "--json", "--board", "9x6", "--square", "40mm", "--lens", "brown"];
    let board = board.map(str::to_owned).into_iter();
    let ran = plumb(board.chain(devices.iter().flat_map(source)).collect::<Vec<_>>());
    assert_eq!(ran.code, Some(0), "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

#[test]
fn every_sensor_of_two_depth_cameras_is_placed() {
    let mut squares = Vec::new();
    for seed in [31, 32] {
        let folder = tempfile::tempdir().unwrap();
        let [left, right] = ["left", "right"]
            .map(|name| Device::simulate(folder.path(), seed, usize::from(name == "right"), name));
        let devices = [("left", &left), ("right", &right)];
        let served = Served::start(folder.path(), &configuration(&devices));
        let request = json!({"target": left.truth["target"], "lens": "brown"});
        let left_from_right = left.color_from_board() * right.color_from_board().inverse();
        let truth = [
            ("left.color_from_left.infrared", left.color_from("infrared")),
            ("left.color_from_left.depth", left.color_from("depth")),
            ("left.color_from_right.color", left_from_right),
            ("left.color_from_right.infrared", left_from_right * right.color_from("infrared")),
            ("left.color_from_right.depth", left_from_right * right.color_from("depth")),
        ];
        let ways = [
            ("HTTP", calibrate(&served, &request)),
            ("command line", calibrated_offline(&devices)),
        ];
        for (way, calibration) in ways {
            let extrinsics = calibration["extrinsics"].as_array().unwrap();
            let names: Vec<&str> =
                extrinsics.iter().map(|pose| pose["name"].as_str().unwrap()).collect();
            assert_eq!(names.len(), truth.len(), "{names:?}; {}", calibration["verdict"]);
            for (name, truth) in &truth {
                let found = extrinsics.iter().find(|pose| pose["name"] == **name);
                let found = found.unwrap_or_else(|| panic!("no {name} in {names:?}"));
                let errors = errors_in_std(found, truth);
                let most = errors.iter().fold(0.0_f64, |most, error| most.max(error.abs()));
                assert!(most < MOST_STD, "{way}, seed {seed} {name}: {errors:.2?} deviations");
                squares.extend(errors.iter().map(|error| error * error));
            }
        }
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((0.5..1.5).contains(&rms), "{rms:.2} rms of {} numbers", squares.len());
}
