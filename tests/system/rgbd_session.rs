//! Color, infrared and depth through the daemon: a rendered camera, calibrated over HTTP, against
//! what is true of it.

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
fn color_and_depth_are_calibrated_together_through_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rgbd.mcap");
    let scene = recording("rgbd.toml");
    let simulated =
        plumb(["simulate", "--config", scene.to_str().unwrap(), "--out", file.to_str().unwrap()]);
    assert_eq!(simulated.code, Some(0), "{}", simulated.stderr);
    let truth: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("rgbd.truth.json")).unwrap())
            .unwrap();

    let path = file.display().to_string();
    let source = format!("{{ kind = \"recording\", path = {path:?}, pace = \"fastest\" }}");
    let served =
        Served::start(folder.path(), &format!("[[camera]]\nname = \"front\"\nsource = {source}\n"));
    let mut events = served.events("", Some("0"));
    let request = json!({"target": truth["target"], "lens": "brown"});
    let started = served.post("/v1/cameras/front/sessions", &request);
    assert_eq!(started.status, 201, "{}", started.text());
    let id = started.json()["id"].as_str().unwrap().to_owned();
    events.until(|event| {
        let ended =
            event.data["reason"].as_str().is_some_and(|reason| reason.contains("has ended"));
        event.name == "session" && event.data["id"] == *id && ended
    });
    let session = served.post_nothing(&format!("/v1/sessions/{id}/stop")).json();
    assert_eq!(session["state"], "finished", "{session}");
    let calibration = served
        .get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap()))
        .json();
    let verdict = &calibration["verdict"];
    assert!(calibration["sensors"]["infrared"]["lens"].is_object(), "{verdict}");
    assert!(calibration["sensors"]["depth"].is_object(), "{verdict}");

    let found = named(&calibration["extrinsics"], "color_from_depth");
    let truly = named(&truth["extrinsics"], "color_from_depth");
    let distance_m = (vector(&found["translation"]) - vector(&truly["translation"])).norm();
    let rotation_error_deg = rotation(found).angle_to(&rotation(truly)).to_degrees();
    assert!(
        distance_m < 1e-3 && rotation_error_deg < 0.05,
        "{distance_m} m, {rotation_error_deg}°, ± {}; {verdict}",
        found["translation_std"]
    );
    is_of_use(&served, session["calibration"].as_str().unwrap());
}

/// What a user does with it: the sensors in each other's images, live, and the numbers in other
/// programs' formats.
fn is_of_use(served: &Served, id: &str) {
    let frame = |query: &str| served.get(&format!("/v1/cameras/front/frame.jpg?{query}"));
    let registered = "sensor=depth&registered=color&overlay=true";
    // A good calibration is current by itself; another one is made so.
    if served.get("/v1/cameras/front").json()["calibration"].is_null() {
        assert_eq!(frame(registered).status, 409);
        assert_eq!(served.post_nothing(&format!("/v1/calibrations/{id}/approve")).status, 200);
    }
    for query in [
        "sensor=depth",
        "sensor=depth&undistorted=true",
        registered,
        "sensor=depth&registered=color",
        "sensor=color&registered=depth",
    ] {
        let answer = frame(query);
        assert_eq!(
            (answer.status, answer.media_type.as_str()),
            (200, "image/jpeg"),
            "{query}: {}",
            answer.text()
        );
        let image = image::load_from_memory(&answer.bytes).unwrap().into_rgb8();
        assert_eq!(image.dimensions(), (640, 480), "{query}");
        let spread = |pixel: &&image::Rgb<u8>| {
            let [r, g, b] = pixel.0;
            r.max(g).max(b) - r.min(g).min(b) > 60
        };
        let colorful = image.pixels().filter(spread);
        assert!(
            query.contains("registered=depth") || colorful.count() > 200,
            "{query} shows no depth"
        );
    }
    for query in
        ["sensor=infrared&registered=color", "sensor=depth&registered=infrared", "registered=color"]
    {
        assert_eq!(frame(query).status, 422, "{query}");
    }
    let exported = |query: &str| {
        let answer = served.get(&format!("/v1/cameras/front/calibration?format={query}"));
        assert_eq!(answer.status, 200, "{query}: {}", answer.text());
        answer.text()
    };
    assert!(exported("ros").contains("camera_name: \"front\""));
    assert!(exported("ros&sensor=depth").contains("camera_name: \"front_depth\""));
    assert!(exported("kalibr").contains("cam1:\n  T_cn_cnm1:"));
    assert!(exported("urdf").contains("<child link=\"front_depth_optical_frame\"/>"));
    assert!(exported("tf").contains("child_frame_id: \"front_infrared_optical_frame\""));
    assert!(exported("depth").starts_with("plumb_depth_correction 1\n"));
    assert_eq!(
        served.get("/v1/cameras/front/calibration?format=ros&sensor=x").json()["field"],
        "sensor"
    );
}
