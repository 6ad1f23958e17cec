//! The product on real devices: a rendered board, walked in front of two cameras, calibrated over
//! HTTP.

use std::fs;

use plumb::geometry::lens::LensModel;
use serde_json::{Value, json};

use crate::daemon::Daemon;
use crate::guest::{plug_in, unplug};
use crate::loopback::Feeder;

const CAMERAS: &str = r#"
[[camera]]
name = "walk"
source = { kind = "v4l2", device = "/dev/video20" }
[[camera]]
name = "street"
source = { kind = "v4l2", device = "/dev/video21" }
[[camera]]
name = "vivid"
source = { kind = "v4l2", device = "/dev/video0", width = 320, height = 180, format = "GREY", fps = 5 }
"#;
/// The shipped recording of a board that is walked about, and what is true of it; the guest sees
/// the host's files.
pub const WALK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/walk.mcap");
const WALK_TRUTH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/walk.truth.json");
const FPS: &str = "6";
/// Kept by what they teach, views are fewer than places: these determine the lens to 0.1 %.
const ENOUGH_VIEWS: u64 = 8;

pub fn a_walk_is_calibrated_over_http() -> String {
    let truth: Value = serde_json::from_slice(&fs::read(WALK_TRUTH).unwrap()).unwrap();
    let yuyv = Feeder::start("/dev/video20", "YUYV", WALK, FPS);
    let mjpg = Feeder::start("/dev/video21", "MJPG", WALK, FPS);
    let daemon = Daemon::start(CAMERAS);
    for camera in ["walk", "street", "vivid"] {
        daemon.wait_for_state(camera, "streaming");
    }
    let start = json!({"target": truth["target"], "lens": "brown"});
    let session = |camera: &str| daemon.post(&format!("/v1/cameras/{camera}/sessions"), &start);
    let sessions = ["walk", "street", "vivid"]
        .map(|camera| session(camera)["id"].as_str().unwrap().to_owned());
    let now = |k: usize| daemon.get(&format!("/v1/sessions/{}", sessions[k]));
    let count = |k: usize, field: &str| now(k)[field].as_u64().unwrap();

    // The cable is pulled in the middle of a session: what fed the first camera dies, the third
    // loses its device.
    let views =
        daemon.wait_for("views", || Some(count(0, "views_kept")).filter(|views| *views >= 4));
    drop(yuyv);
    unplug();
    let lost = daemon.wait_for_state("vivid", "lost");
    let frames = count(2, "frames_seen");
    let starved = daemon.wait_for("the first camera is lost", || {
        Some(daemon.camera("walk")).filter(|camera| camera["state"] == "lost")
    });
    for k in [0, 2] {
        assert_eq!(now(k)["state"], "collecting");
    }
    let street = count(1, "frames_seen");
    daemon.wait_for("two cameras never hold each other up", || {
        (count(1, "frames_seen") > street).then_some(())
    });
    plug_in();
    let _yuyv = Feeder::start("/dev/video20", "YUYV", WALK, FPS);
    daemon.wait_for_state("vivid", "streaming");
    daemon
        .wait_for("the third session goes on", || (count(2, "frames_seen") > frames).then_some(()));
    daemon.wait_for("enough views", || {
        [0, 1].iter().all(|k| count(*k, "views_kept") >= ENOUGH_VIEWS).then_some(())
    });
    assert!(count(0, "views_kept") > views, "what was gathered before is still there");

    let mut reported = Vec::new();
    for (k, format) in [(0, "YUYV"), (1, "MJPG")] {
        let finished = daemon.post(&format!("/v1/sessions/{}/stop", sessions[k]), &json!({}));
        assert_eq!(finished["state"], "finished", "{finished}");
        let id = finished["calibration"].as_str().unwrap();
        reported.push(compared(format, &daemon.get(&format!("/v1/calibrations/{id}")), &truth));
    }
    drop(mjpg);
    format!("{}; {}; {}", reported.join("; "), lost["reason"], starved["reason"])
}

/// Holds a calibration against the truth; says how far off it is.
fn compared(format: &str, calibration: &Value, truth: &Value) -> String {
    let found = &calibration["sensors"]["color"];
    let true_lens = &truth["sensors"]["color"]["lens"];
    assert_eq!(found["lens"]["model"], LensModel::Brown.name());
    let mut worst = 0.0_f64;
    for name in ["fx", "fy", "cx", "cy"] {
        let number = |value: &Value| value[name].as_f64().unwrap();
        let off = number(&found["lens"]) - number(true_lens);
        let sigmas = off.abs() / number(&found["lens_std"]);
        assert!(sigmas < 4.0, "{format} {name}: off by {off:.3}, {sigmas:.1} standard deviations");
        worst = worst.max(sigmas);
    }
    let views = found["views"].as_array().unwrap().len();
    let (fx, rms) = (&found["lens"]["fx"], found["rms_px"].as_f64().unwrap());
    format!(
        "{format}: {views} views, rms {rms:.3} px, fx {fx} (true {}), at most {worst:.1} σ off",
        true_lens["fx"]
    )
}
