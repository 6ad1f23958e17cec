//! What recordings state of their sensors, in the camera's document and as a calibration: both say
//! the same.

use serde_json::Value;

use crate::served::{Served, replaying};

#[test]
fn what_a_recording_states_is_answered_as_a_calibration() {
    for (name, states) in [("room.mcap", true), ("rgbd.mcap", false), ("walk.mcap", false)] {
        let folder = tempfile::tempdir().unwrap();
        let served = Served::start(folder.path(), &replaying("front", name));
        served.events("", Some("0")).until(|event| event.name == "frame");
        let factory = served.get("/v1/cameras/front").json()["factory"].clone();
        let calibration = served.get("/v1/cameras/front/factory");
        assert_eq!(calibration.status, if states { 200 } else { 404 }, "{}", calibration.text());
        assert_eq!(factory.is_object(), states, "{factory}");
        if !states {
            continue;
        }
        let calibration = calibration.json();
        let sensors = |document: &Value| document["sensors"].as_object().unwrap().clone();
        let names = |document: &Value| sensors(document).keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&factory), names(&calibration));
        for (kind, sensor) in sensors(&factory) {
            assert_eq!(sensor["lens"], calibration["sensors"][&kind]["lens"], "{kind}");
        }
        let place = |document: &Value| {
            let extrinsics = &document["extrinsics"][0];
            ["name", "rotation", "translation"].map(|key| extrinsics[key].clone())
        };
        assert_eq!(place(&factory), place(&calibration));
        assert_eq!(calibration["sensors"]["depth"]["unit_m"], 0.001);
        let reasons = calibration["verdict"]["reasons"].to_string();
        assert!(reasons.contains("millimeters are assumed"), "{reasons}");
    }
}
