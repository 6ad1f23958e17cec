//! A rig of three cameras through the daemon: one session, one calibration, held to the truth that
//! the images were made of.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::{Served, recording};

const CAMERAS: [&str; 3] = ["left", "right", "far"];

fn configuration() -> String {
    configuration_of(&CAMERAS)
}

fn configuration_of(cameras: &[&str]) -> String {
    let camera = |name: &&str| {
        let path = recording(&format!("rig-{name}.mcap")).display().to_string();
        format!(
            "[[camera]]\nname = {name:?}\nsource = {{ kind = \"recording\", path = {path:?}, pace = \"fastest\" }}\n"
        )
    };
    let tables: String = cameras.iter().map(camera).collect();
    format!("{tables}[[rig]]\nname = \"head\"\ncameras = {cameras:?}\n")
}

fn request() -> Value {
    json!({"target": {"kind": "chessboard", "cols": 8, "rows": 6, "square_m": 0.03}, "lens": "brown"})
}

fn truth_of(camera: &str) -> Value {
    serde_json::from_slice(&std::fs::read(recording(&format!("rig-{camera}.truth.json"))).unwrap())
        .unwrap()
}

fn pose(document: &Value) -> plumb::geometry::pose::Pose {
    let of = |value: &Value, key: &str| value[key].as_f64().unwrap();
    let rotation = &document["rotation"];
    let quaternion = nalgebra::Quaternion::new(
        of(rotation, "w"),
        of(rotation, "x"),
        of(rotation, "y"),
        of(rotation, "z"),
    );
    let translation = document["translation"].as_array().unwrap();
    let at = |k: usize| translation[k].as_f64().unwrap();
    let rotation = nalgebra::UnitQuaternion::from_quaternion(quaternion);
    plumb::geometry::pose::Pose::new(rotation, nalgebra::Vector3::new(at(0), at(1), at(2)))
}

/// Where a camera truly is: both saw one board at the first frame.
fn left_from(camera: &str) -> plumb::geometry::pose::Pose {
    let [left, other] =
        ["left", camera].map(|name| pose(&truth_of(name)["frames"][0]["camera_from_board"]));
    left * other.inverse()
}

/// Runs a session over the recordings; the finished session.
fn calibrate(served: &Served) -> Value {
    calibrate_with(served, &request())
}

fn calibrate_with(served: &Served, request: &Value) -> Value {
    let mut events = served.events("?camera=head", Some("0"));
    let started = served.post("/v1/rigs/head/sessions", request);
    assert_eq!(started.status, 201, "{}", started.text());
    let id = started.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(started.location, Some(format!("/v1/sessions/{id}")));
    let ended =
        |data: &Value| data["reason"].as_str().is_some_and(|reason| reason.contains("has ended"));
    events.until(|event| event.name == "session" && event.data["id"] == *id && ended(&event.data));
    let stopped = served.post_nothing(&format!("/v1/sessions/{id}/stop"));
    assert_eq!(stopped.status, 200, "{}", stopped.text());
    let session = stopped.json();
    assert_eq!(session["state"], "finished", "{session}");
    session
}

fn has_views(session: &Value) -> bool {
    session["views_kept"].as_u64() >= Some(3)
}

/// A daemon, and the id of the session that collects views of its rig.
fn collecting(folder: &std::path::Path) -> (Served, String) {
    let served = Served::start(folder, &configuration());
    let mut events = served.events("?camera=head", Some("0"));
    let id =
        served.post("/v1/rigs/head/sessions", &request()).json()["id"].as_str().unwrap().to_owned();
    events.until(|event| event.name == "session" && has_views(&event.data));
    (served, id)
}

#[test]
fn a_rig_is_found_to_within_its_prediction() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &configuration());
    let session = calibrate(&served);
    assert_eq!(session["camera"], "head");
    for (member, camera) in session["cameras"].as_array().unwrap().iter().zip(CAMERAS) {
        assert_eq!(
            (&member["camera"], &member["frames_seen"]),
            (&json!(camera), &json!(30)),
            "{member}"
        );
        assert!(member["views_shared"].as_u64() > Some(5), "{member}");
    }
    let calibration = served
        .get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap()))
        .json();
    for camera in calibration["cameras"].as_array().unwrap() {
        let name = camera["name"].as_str().unwrap();
        let (color, truth) = (&camera["sensors"]["color"], truth_of(name));
        for parameter in ["fx", "fy", "cx", "cy"] {
            let of = |lens: &Value| lens[parameter].as_f64().unwrap();
            let (found, truly, std) = (
                of(&color["lens"]),
                of(&truth["sensors"]["color"]["lens"]),
                of(&color["lens_std"]),
            );
            assert!(
                (found - truly).abs() < 3.5 * std,
                "{name} {parameter}: {found}, truly {truly} ± {std}"
            );
        }
    }
    extrinsics_are_true(&calibration);
}

/// Holds the poses of the rig's cameras against the truth.
fn extrinsics_are_true(calibration: &Value) {
    let extrinsics = calibration["extrinsics"].as_array().unwrap();
    assert_eq!(extrinsics.len(), 2);
    for (found, camera) in extrinsics.iter().zip(&CAMERAS[1..]) {
        assert_eq!(found["name"], format!("left_from_{camera}"));
        let (found_pose, truly) = (pose(found), left_from(camera));
        let rotation = (found_pose.rotation() * truly.rotation().inverse()).scaled_axis();
        let translation = found_pose.translation() - truly.translation();
        for axis in 0..3 {
            let std = |key: &str| found[key][axis].as_f64().unwrap();
            let (rotation_std, translation_std) = (std("rotation_std"), std("translation_std"));
            assert!(
                rotation[axis].abs() < 3.5 * rotation_std,
                "{camera}: {rotation} ± {rotation_std}"
            );
            assert!(
                translation[axis].abs() < 3.5 * translation_std,
                "{camera}: {translation} ± {translation_std}"
            );
            assert!(rotation_std < 1e-3 && translation_std < 1e-3, "{found}");
        }
    }
}

fn rig_arguments(cameras: &[&str]) -> Vec<String> {
    let source = |name: &&str| {
        let path = recording(&format!("rig-{name}.mcap")).display().to_string();
        ["--rig".to_owned(), format!("{name}={path}")]
    };
    let board = ["calibrate", "--json", "--board", "8x6", "--square", "30mm", "--lens", "brown"];
    board.map(str::to_owned).into_iter().chain(cameras.iter().flat_map(source)).collect()
}

#[test]
fn the_command_line_finds_a_rig_too() {
    let ran = plumb(rig_arguments(&CAMERAS));
    assert_eq!(ran.code, Some(0), "{}", ran.stderr);
    let calibration: Value = serde_json::from_str(&ran.stdout).unwrap();
    extrinsics_are_true(&calibration);
}

#[test]
fn two_recordings_without_names_are_refused_with_the_command_to_write() {
    let mut arguments = rig_arguments(&[]);
    let paths = ["left", "right"].map(|name| recording(&format!("rig-{name}.mcap")));
    arguments.extend(paths.map(|path| path.display().to_string()));
    let ran = plumb(arguments);
    assert_eq!(ran.code, Some(2), "{}", ran.stderr);
    assert!(ran.stderr.contains("plumb calibrate --rig left="), "{}", ran.stderr);
    let ran = plumb(rig_arguments(&CAMERAS[..1]));
    assert_eq!(ran.code, Some(2), "{}", ran.stderr);
}

#[test]
fn a_lens_that_is_given_is_held() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &configuration());
    let lens = truth_of("right")["sensors"]["color"]["lens"].clone();
    let with = |name: &str| {
        let mut request = request();
        request["given"] = json!({ name: lens });
        request
    };
    let refused = served.post("/v1/rigs/head/sessions", &with("tail.color"));
    assert_eq!((refused.status, refused.json()["field"].as_str()), (422, Some("given.tail.color")));
    assert_eq!(served.post("/v1/rigs/head/sessions", &with("right.depth")).status, 422);
    assert_eq!(served.post("/v1/cameras/right/sessions", &with("right.color")).status, 422);
    let session = calibrate_with(&served, &with("right.color"));
    assert_eq!(session["given"]["right.color"], lens);
    let calibration = served
        .get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap()))
        .json();
    assert_eq!(calibration["cameras"][1]["name"], "right");
    let found = &calibration["cameras"][1]["sensors"]["color"]["lens"];
    for parameter in ["fx", "fy", "cx", "cy", "k1", "k2"] {
        assert_eq!(found[parameter], lens[parameter], "{parameter}");
    }
    extrinsics_are_true(&calibration);
}

#[test]
fn a_rig_is_served_like_a_camera_and_has_its_cameras_to_itself() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &configuration());
    assert_eq!(served.get("/v1/rigs").json()["rigs"][0]["cameras"], json!(CAMERAS));
    assert_eq!(served.get("/v1/rigs/head/calibration").status, 404);
    for unknown in ["/v1/rigs/tail", "/v1/rigs/tail/calibration", "/v1/rigs/tail/calibrations"] {
        assert_eq!(served.get(unknown).status, 404);
    }
    assert_eq!(served.post("/v1/rigs/tail/sessions", &request()).status, 404);
    assert_eq!(served.post("/v1/rigs/head/sessions", &json!({})).status, 422);

    let own = served.post("/v1/cameras/far/sessions", &request()).json();
    let busy = served.post("/v1/rigs/head/sessions", &request());
    assert_eq!(busy.status, 409, "{}", busy.text());
    // It is given back by its own thread, a moment after the answer.
    let free = || served.get("/v1/cameras/left").json()["session"].is_null();
    assert!((0..2000).any(|_| free()), "none is kept where one is busy");
    assert_eq!(served.delete(&format!("/v1/sessions/{}", own["id"].as_str().unwrap())).status, 200);

    let started = served.post("/v1/rigs/head/sessions", &request()).json();
    assert_eq!(served.post("/v1/rigs/head/sessions", &request()).status, 409);
    assert_eq!(served.post("/v1/cameras/left/sessions", &request()).status, 409);
    assert_eq!(served.get("/v1/cameras/left").json()["session"], started["id"]);
    let path = format!("/v1/sessions/{}", started["id"].as_str().unwrap());
    assert_eq!(served.delete(&path).status, 200);
    assert_eq!(served.get(&path).json()["state"], "aborted");
    assert_eq!(served.get("/v1/rigs/head").json()["session"], Value::Null);

    let session = calibrate(&served);
    let id = session["calibration"].as_str().unwrap();
    assert_eq!(served.post_nothing(&format!("/v1/calibrations/{id}/approve")).status, 200);
    assert_eq!(served.get("/v1/rigs/head").json()["calibration"], id);
    assert_eq!(served.get("/v1/rigs/head/calibration").json()["id"], id);
    assert_eq!(served.get("/v1/rigs/head/calibrations").json()["calibrations"][0]["id"], id);
    let views =
        served.get(&format!("/v1/sessions/{}/views", session["id"].as_str().unwrap())).json();
    let views = views["views"].as_array().unwrap();
    let of_one_moment = views.iter().filter(|view| view["moment"] == views[0]["moment"]);
    assert!(of_one_moment.count() > 1 && views[0]["camera"] == "left", "{}", views[0]);
    assert!(
        views.iter().all(|view| view["rms_px"].as_f64().is_some()),
        "each view finds its residuals"
    );
    let image = served.get(views[1]["picture"].as_str().unwrap());
    assert_eq!((image.status, image.media_type.as_str()), (200, "image/jpeg"));
}

#[test]
fn rectified_images_hold_as_much_as_alpha_says() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &configuration_of(&CAMERAS[..2]));
    let id = calibrate(&served)["calibration"].as_str().unwrap().to_owned();
    assert_eq!(served.post_nothing(&format!("/v1/calibrations/{id}/approve")).status, 200);
    let unseen = |camera: &str, query: &str| {
        let answer = served.get(&format!("/v1/cameras/{camera}/frame.jpg?rectified=true{query}"));
        assert_eq!(answer.status, 200, "{}", answer.text());
        let image = image::load_from_memory(&answer.bytes).unwrap().into_luma8();
        assert_eq!(image.dimensions(), (640, 480));
        let border = image.enumerate_pixels().filter(|(x, y, _)| *x < 2 || *y < 2);
        border.filter(|(.., pixel)| pixel.0[0] < 8).count()
    };
    for camera in &CAMERAS[..2] {
        let [unsaid, all_seen, half, whole] =
            ["", "&alpha=0", "&alpha=0.5", "&alpha=1"].map(|query| unseen(camera, query));
        assert_eq!((unsaid, all_seen), (0, 0), "{camera}");
        assert!(whole > half && half > 100, "{camera}: {half}, {whole}");
    }
}

#[test]
fn a_killed_daemon_goes_on_with_a_rig_s_session_and_replays_come_out_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let (served, id) = collecting(folder.path());
    served.kill();
    let served = Served::start(folder.path(), &configuration());
    let session = served.get(&format!("/v1/sessions/{id}")).json();
    assert!(session["state"] == "collecting" && has_views(&session), "{session}");
    assert_eq!(served.delete(&format!("/v1/sessions/{id}")).status, 200);

    let replay = || {
        let session = calibrate(&served);
        let mut calibration = served
            .get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap()))
            .json();
        for key in ["id", "session", "created_at"] {
            calibration.as_object_mut().unwrap().remove(key);
        }
        calibration.to_string()
    };
    assert_eq!(replay(), replay());
}

/// A camera's filter has what the rig does that it is in, in the list and in the stream; the rig's
/// own has not what its cameras do.
#[test]
fn a_cameras_filter_has_its_rigs() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &configuration());
    let session = calibrate(&served);
    let calibration = &session["calibration"];
    let ids = |camera: &str| {
        let sessions = served.get(&format!("/v1/sessions?camera={camera}")).json();
        let sessions = sessions["sessions"].as_array().unwrap().iter();
        sessions.map(|session| session["id"].clone()).collect::<Vec<_>>()
    };
    for name in ["left", "right", "far", "head"] {
        assert_eq!(ids(name), [session["id"].clone()], "{name}");
        let mut events = served.events(&format!("?camera={name}"), Some("0"));
        let (mut said, mut of_camera) = (0, false);
        while said < 2 {
            let event = events.next();
            said += u32::from(event.name == "session" && event.data["state"] == "finished");
            said += u32::from(event.name == "calibration" && event.data["id"] == *calibration);
            of_camera |= event.name == "camera";
            let of_other = event.data["camera"].as_str().filter(|camera| *camera != "head");
            assert!(of_other.is_none_or(|camera| camera == name), "{name}: {}", event.data);
        }
        assert_eq!(of_camera, name != "head");
    }
    assert_eq!(ids("rear"), [] as [Value; 0]);
}

/// Asks until the answer is `wanted`: what a hangup changes is not announced.
fn until(served: &Served, path: &str, wanted: impl Fn(u16, &Value) -> bool) {
    let began = Instant::now();
    loop {
        let answer = served.get(path);
        if wanted(answer.status, &answer.json()) {
            return;
        }
        assert!(began.elapsed() < Duration::from_secs(60), "in vain: {path} is {}", answer.text());
    }
}

#[test]
fn a_hangup_exchanges_the_rigs_that_changed() {
    let folder = tempfile::tempdir().unwrap();
    let (served, id) = collecting(folder.path());
    let file = folder.path().join("plumb.toml");
    let before = std::fs::read_to_string(&file).unwrap();
    let without_rig = &before[..before.find("[[rig]]").unwrap()];
    let rig =
        |name: &str, cameras: &[&str]| format!("[[rig]]\nname = {name:?}\ncameras = {cameras:?}\n");
    let hangup = |rigs: &str| {
        std::fs::write(&file, format!("{without_rig}{rigs}")).unwrap();
        served.signal("HUP");
    };

    hangup(&(rig("head", &["left", "right"]) + &rig("tail", &["right", "far"])));
    until(&served, "/v1/rigs/tail", |status, _| status == 200);
    assert_eq!(served.get("/v1/rigs/head").json()["cameras"], json!(["left", "right"]));
    let goes_on = |session: &Value| {
        session["state"] == "collecting" && session["cameras"].as_array().unwrap().len() == 2
    };
    until(&served, &format!("/v1/sessions/{id}"), |_, session| goes_on(session));
    until(&served, "/v1/cameras/right", |_, camera| camera["session"] == *id);
    let own = served.post("/v1/cameras/far/sessions", &request());
    assert_eq!(own.status, 201, "the camera that left the rig is free: {}", own.text());
    let stopped = served.post_nothing(&format!("/v1/sessions/{id}/stop")).json();
    assert_ne!(stopped["state"], "collecting", "{stopped}");

    hangup("");
    until(&served, "/v1/rigs", |_, rigs| rigs["rigs"] == json!([]));
    until(&served, "/v1/cameras/left", |_, camera| camera["session"].is_null());
    assert_eq!(
        served.get("/v1/cameras/far").json()["session"],
        own.json()["id"],
        "far did not notice"
    );
}
