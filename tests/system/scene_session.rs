//! A session without a board: a camera that moves through a rendered room with exact truth, over
//! HTTP.

use std::path::Path;
use std::sync::OnceLock;

use plumb::document::pose::PoseDocument;
use plumb::geometry::pose::Pose;
use serde_json::{Value, json};

use crate::program::plumb;
use crate::room::{RoomCamera, camera, rendered};
use crate::served::{Events, Served};

const CAMERA: RoomCamera =
    RoomCamera { size: [240, 180], focal_px: 180.0, center_px: [121.8, 88.2] };
const FRAMES: u32 = 12;

/// In front of one of the room's corners, which stays in the middle, rotated by up to 90 degrees
/// about the camera's own axis.
fn walk(frame: u32) -> Pose {
    let angle = std::f64::consts::TAU * f64::from(frame) / f64::from(FRAMES);
    let [x, y, z] = [0.7 * angle.sin() - 0.3, 0.5 * (2.0 * angle).sin(), 1.0 + 0.5 * angle.cos()];
    let roll = 1.57 * (0.5 - 0.5 * (2.0 * angle).cos());
    camera([x, y, z], [0.1 * y, -(1.6 - x).atan2(3.0 - z)], roll)
}

/// The files of the walk, rendered once.
fn walked() -> &'static [Vec<u8>] {
    static FILES: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    FILES.get_or_init(|| (0..FRAMES).map(|frame| png(&walk(frame))).collect())
}

fn png(camera_from_room: &Pose) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let image = rendered(camera_from_room, &CAMERA);
    image.write_to(&mut file, image::ImageFormat::Png).unwrap();
    file.into_inner()
}

/// A daemon with one camera that replays `files` once, as a folder.
fn serving(folder: &Path, files: &[Vec<u8>], pace: &str) -> Served {
    let images = folder.join("images");
    std::fs::create_dir_all(&images).unwrap();
    for (k, file) in files.iter().enumerate() {
        std::fs::write(images.join(format!("{k:03}.png")), file).unwrap();
    }
    let path = images.display().to_string();
    let source = format!("{{ kind = \"recording\", path = {path:?}, {pace} }}");
    Served::start(folder, &format!("[[camera]]\nname = \"front\"\nsource = {source}\n"))
}

fn start_session(served: &Served, request: &Value) -> String {
    let started = served.post("/v1/cameras/front/sessions", request);
    assert_eq!(started.status, 201, "{}", started.text());
    assert_eq!(started.json()["target"], json!({"kind": "scene"}));
    started.json()["id"].as_str().unwrap().to_owned()
}

fn until(events: &mut Events, id: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    events
        .until(|event| event.name == "session" && event.data["id"] == *id && wanted(&event.data))
        .data
}

fn has_ended(session: &Value) -> bool {
    session["reason"].as_str().is_some_and(|reason| reason.contains("has ended"))
}

fn is_over(session: &Value) -> bool {
    ["finished", "failed"].iter().any(|state| session["state"] == *state)
}

fn stop(served: &Served, id: &str) -> Value {
    let stopped = served.post_nothing(&format!("/v1/sessions/{id}/stop"));
    assert_eq!(stopped.status, 200, "{}", stopped.text());
    stopped.json()
}

/// Replays the walk to its end, and stops.
fn calibrate(served: &Served, request: &Value) -> Value {
    let mut events = served.events("", Some("0"));
    let id = start_session(served, request);
    until(&mut events, &id, has_ended);
    stop(served, &id)
}

fn calibration_of(served: &Served, session: &Value) -> Value {
    assert_eq!(session["state"], "finished", "{session}");
    served.get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap())).json()
}

fn assert_true(calibration: &Value) {
    let color = &calibration["sensors"]["color"];
    let RoomCamera { focal_px, center_px: [cx, cy], .. } = CAMERA;
    let truths = [("fx", focal_px), ("fy", focal_px), ("cx", cx), ("cy", cy)];
    for (name, truth) in truths {
        let [value, std] = ["lens", "lens_std"].map(|of| color[of][name].as_f64().unwrap());
        assert!(std > 0.0 && std < 0.01 * focal_px, "{name} ± {std}");
        assert!((value - truth).abs() < 3.0 * std, "{name}: {value} ± {std}, truly {truth}");
    }
}

#[test]
fn a_scene_becomes_a_calibration_as_good_as_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let served = serving(folder.path(), walked(), "pace = \"fastest\"");
    let request = json!({"target": {"kind": "scene"}, "lens": "radial"});
    let session = calibrate(&served, &request);
    let kept = session["views_kept"].as_u64().unwrap();
    assert!((8..=u64::from(FRAMES)).contains(&kept), "{session}");
    assert_eq!(session["frames_seen"], FRAMES, "a replay skips nothing: {session}");
    let calibration = calibration_of(&served, &session);
    assert_eq!(calibration["target"], json!({"kind": "scene"}));
    assert_eq!(calibration["scene_unit"], Value::Null);
    assert!(calibration.as_object().unwrap().contains_key("scene_unit"), "{calibration}");
    assert_true(&calibration);
    let color = &calibration["sensors"]["color"];
    let views = color["views"].as_array().unwrap();
    assert_eq!(views.len() as u64, kept);
    assert!(views.iter().all(|view| view["camera_from_scene"].is_object()), "{color}");
    let id = session["id"].as_str().unwrap();
    let listed = served.get(&format!("/v1/sessions/{id}/views")).json();
    let listed = listed["views"].as_array().unwrap().clone();
    assert_eq!(listed.len() as u64, kept);
    for (view, calibrated) in listed.iter().zip(views) {
        assert_eq!(view["camera_from_scene"], calibrated["camera_from_scene"]);
        assert_eq!(view["corners"], 0);
    }
    let image = served.get(&format!("/v1/sessions/{id}/views/{}.jpg", kept - 1));
    assert_eq!((image.status, &image.bytes[..2]), (200, &[0xff, 0xd8][..]));
    let approved = format!("/v1/calibrations/{}/approve", session["calibration"].as_str().unwrap());
    assert_eq!(served.post_nothing(&approved).status, 200);
    for format in ["ros", "opencv", "kalibr", "mrcal", "colmap"] {
        let exported = served.get(&format!("/v1/cameras/front/calibration?format={format}"));
        assert_eq!(exported.status, 200, "{format}: {}", exported.text());
    }
}

#[test]
fn a_session_of_a_scene_ends_by_itself_and_says_what_to_do_before() {
    let folder = tempfile::tempdir().unwrap();
    let served = serving(folder.path(), walked(), "pace = \"fastest\"");
    let mut events = served.events("", Some("0"));
    let request = json!({
        "target": {"kind": "scene"}, "lens": "pinhole", "finish": {"min_views": 6}
    });
    // The same images give the same numbers.
    let sensors = [0, 1].map(|_| {
        let id = start_session(&served, &request);
        let first = until(&mut events, &id, |session| session["views_kept"].as_u64() >= Some(1));
        let message = first["guidance"]["message"].as_str().unwrap();
        assert!(message.contains("step sideways"), "{message}");
        let session = until(&mut events, &id, is_over);
        assert_eq!((&session["state"], &session["views_kept"]), (&json!("finished"), &json!(6)));
        let calibration = calibration_of(&served, &session);
        assert_true(&calibration);
        calibration["sensors"].to_string()
    });
    assert_eq!(sensors[0], sensors[1]);

    let finish = json!({"uncertainty_px": 1.0});
    let id = start_session(
        &served,
        &json!({"target": {"kind": "scene"}, "lens": "pinhole", "finish": finish}),
    );
    let session = until(&mut events, &id, is_over);
    assert_eq!(session["state"], "finished", "{session}");
    let estimate = &session["estimate"];
    assert!(estimate["uncertainty_px"]["median"].as_f64() <= Some(1.0), "{session}");
    assert_true(&calibration_of(&served, &session));
}

#[test]
fn a_still_camera_and_one_without_texture_are_refused_by_name() {
    let still = vec![walked()[0].clone(); 12];
    let mut gray = std::io::Cursor::new(Vec::new());
    let blank = image::GrayImage::from_pixel(240, 180, image::Luma([90]));
    blank.write_to(&mut gray, image::ImageFormat::Png).unwrap();
    let blank = vec![gray.into_inner(); 12];
    for (files, kept, reason) in
        [(&still, 1, "the camera stood still"), (&blank, 0, "too little texture")]
    {
        let folder = tempfile::tempdir().unwrap();
        let served = serving(folder.path(), files, "pace = \"fastest\"");
        let session = calibrate(&served, &json!({"target": {"kind": "scene"}}));
        assert_eq!(session["state"], "failed", "{session}");
        assert_eq!(session["views_kept"], kept);
        let why = session["reason"].as_str().unwrap();
        assert!(why.contains(reason), "{why}");
    }
}

#[test]
fn a_killed_daemon_goes_on_with_its_key_frames() {
    let folder = tempfile::tempdir().unwrap();
    let pace = "pace = \"recorded\", fps = 2";
    let served = serving(folder.path(), walked(), pace);
    let mut events = served.events("", Some("0"));
    let id = start_session(&served, &json!({"target": {"kind": "scene"}, "lens": "pinhole"}));
    let seen = until(&mut events, &id, |session| session["views_kept"].as_u64() >= Some(4));
    served.kill();

    let served = serving(folder.path(), walked(), pace);
    let mut events = served.events("", Some("0"));
    let session = served.get(&format!("/v1/sessions/{id}")).json();
    assert_eq!(session["state"], "collecting", "{session}");
    let before = session["views_kept"].as_u64().unwrap();
    assert!(Some(before) >= seen["views_kept"].as_u64(), "{session}");
    until(&mut events, &id, has_ended);
    let session = stop(&served, &id);
    assert!(session["views_kept"].as_u64() > Some(before), "{session}");
    // What was kept before is known when it is seen again.
    assert!(session["rejected"]["too_similar"].as_u64() >= Some(1), "{session}");
    let listed = served.get(&format!("/v1/sessions/{id}/views")).json();
    assert_eq!(listed["views"].as_array().unwrap().len() as u64, session["views_kept"]);
    assert_true(&calibration_of(&served, &session));
}

/// Green pixels of the newest frame as it is drawn.
fn green_pixels(served: &Served, query: &str) -> usize {
    let shown = served.get(&format!("/v1/cameras/front/frame.jpg?{query}"));
    assert_eq!(shown.status, 200, "{}", shown.text());
    let image = image::load_from_memory(&shown.bytes).unwrap().into_rgb8();
    let is_green = |pixel: &&image::Rgb<u8>| {
        let [red, green, blue] = pixel.0.map(i32::from);
        green > red + 60 && green > blue + 30
    };
    image.pixels().filter(is_green).count()
}

#[test]
fn the_preview_shows_what_an_image_shares_with_the_last_key_frame() {
    let folder = tempfile::tempdir().unwrap();
    let served = serving(folder.path(), walked(), "pace = \"fastest\"");
    let mut events = [0, 1].map(|_| served.events("", Some("0")));
    let id = start_session(&served, &json!({"target": {"kind": "scene"}, "lens": "pinhole"}));
    until(&mut events[0], &id, has_ended);
    assert!(green_pixels(&served, "overlay=true") > 300);
    assert_eq!(green_pixels(&served, "overlay=false"), 0);

    // What is known so far, over the image.
    until(&mut events[1], &id, |session| !session["estimate"].is_null());
    let map = served.get(&format!("/v1/sessions/{id}/uncertainty.png?camera=front"));
    assert_eq!(map.status, 200, "{}", map.text());
    assert!(image::load_from_memory(&map.bytes).unwrap().width() >= 240);
    let other = served.get(&format!("/v1/sessions/{id}/uncertainty.png?camera=rear"));
    assert_eq!(other.status, 404, "{}", other.text());
    assert!(other.text().contains("no camera `rear`"), "{}", other.text());
    assert_eq!(served.get("/v1/sessions/none/uncertainty.png").status, 404);
}

#[test]
fn a_scene_has_no_other_fields() {
    let folder = tempfile::tempdir().unwrap();
    let served = serving(folder.path(), &walked()[..1], "pace = \"fastest\"");
    let request = json!({"target": {"kind": "scene", "cols": 9}});
    let refused = served.post("/v1/cameras/front/sessions", &request);
    assert_eq!(refused.status, 422);
    assert!(refused.text().contains("target.cols"), "{}", refused.text());
}

/// A rendered room before a small color camera and a depth camera.
const ROOM: &str = r#"
seed = 33
frames = 9
fps = 5
[camera]
width = 320
height = 240
[depth]
error = 0.0
[scene]
world = "room"
"#;

#[test]
fn a_scene_before_a_depth_camera_has_lengths_in_meters() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(at("room.toml"), ROOM).unwrap();
    let rendered = plumb(["simulate", "--config", &at("room.toml"), "--out", &at("room.mcap")]);
    assert_eq!(rendered.code, Some(0), "{rendered:?}");
    let source =
        format!("{{ kind = \"recording\", path = {:?}, pace = \"fastest\" }}", at("room.mcap"));
    let config = format!("[[camera]]\nname = \"front\"\nsource = {source}\n");
    let served = Served::start(folder.path(), &config);
    let request = json!({"target": {"kind": "scene"}, "lens": "brown"});
    let calibration = calibration_of(&served, &calibrate(&served, &request));
    assert_eq!(calibration["scene_unit"], "m", "{}", calibration["verdict"]);
    let std = calibration["scene_scale"]["relative_std"].as_f64().unwrap();
    let truth: Value =
        serde_json::from_slice(&std::fs::read(at("room.truth.json")).unwrap()).unwrap();
    let pose = |of: &Value| -> Pose {
        let document: PoseDocument = serde_json::from_value(of.clone()).unwrap();
        Pose::try_from(&document).unwrap()
    };
    let views = calibration["sensors"]["color"]["views"].as_array().unwrap();
    let frame = |view: &Value| view["name"].as_str().unwrap().parse::<usize>().unwrap();
    let (first, last) = (&views[0], &views[views.len() - 1]);
    let [length, exact] = [
        [first, last].map(|view| pose(&view["camera_from_scene"])),
        [first, last].map(|view| pose(&truth["frames"][frame(view)]["camera_from_scene"])),
    ]
    .map(|[first, last]| (first.inverse().translation() - last.inverse().translation()).norm());
    let off = length / exact - 1.0;
    assert!(off.abs() < 3.0 * std && off.abs() < 0.02, "{off} ± {std}");
}
