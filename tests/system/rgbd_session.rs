//! Colour, infrared and depth through the daemon: a rendered camera, calibrated over HTTP, against what is true of it.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::{Served, recording};

fn rotation(pose: &Value) -> UnitQuaternion<f64> {
    let [w, x, y, z] = ["w", "x", "y", "z"].map(|k| pose["rotation"][k].as_f64().unwrap());
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

fn vector(numbers: &Value) -> Vector3<f64> {
    Vector3::from_iterator((0..3).map(|k| numbers[k].as_f64().unwrap()))
}

fn named<'a>(extrinsics: &'a Value, name: &str) -> &'a Value {
    extrinsics.as_array().unwrap().iter().find(|pose| pose["name"] == name).unwrap()
}

#[test]
fn colour_and_depth_are_calibrated_together_through_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rgbd.mcap");
    let scene = recording("rgbd.toml");
    let simulated = plumb(["simulate", "--config", scene.to_str().unwrap(), "--out", file.to_str().unwrap()]);
    assert_eq!(simulated.code, Some(0), "{}", simulated.stderr);
    let truth: Value = serde_json::from_slice(&std::fs::read(folder.path().join("rgbd.truth.json")).unwrap()).unwrap();

    let path = file.display().to_string();
    let source = format!("{{ kind = \"recording\", path = {path:?}, pace = \"fastest\" }}");
    let served = Served::start(folder.path(), &format!("[[camera]]\nname = \"front\"\nsource = {source}\n"));
    let mut events = served.events("", Some("0"));
    let request = json!({"target": truth["target"], "lens": "brown"});
    let started = served.post("/v1/cameras/front/sessions", &request);
    assert_eq!(started.status, 201, "{}", started.text());
    let id = started.json()["id"].as_str().unwrap().to_owned();
    events.until(|event| {
        let ended = event.data["reason"].as_str().is_some_and(|reason| reason.contains("has ended"));
        event.name == "session" && event.data["id"] == *id && ended
    });
    let session = served.post_nothing(&format!("/v1/sessions/{id}/stop")).json();
    assert_eq!(session["state"], "finished", "{session}");
    let calibration = served.get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap())).json();
    let verdict = &calibration["verdict"];
    assert!(calibration["sensors"]["infrared"]["lens"].is_object(), "{verdict}");
    assert!(calibration["sensors"]["depth"].is_object(), "{verdict}");

    let found = named(&calibration["extrinsics"], "color_from_depth");
    let truly = named(&truth["extrinsics"], "color_from_depth");
    let apart_m = (vector(&found["translation"]) - vector(&truly["translation"])).norm();
    let apart_deg = rotation(found).angle_to(&rotation(truly)).to_degrees();
    assert!(apart_m < 1e-3 && apart_deg < 0.05, "{apart_m} m, {apart_deg}°, ± {}; {verdict}", found["translation_std"]);
}
