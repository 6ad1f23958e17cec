//! The product as one test: a daemon, a recording, a session over HTTP, and a calibration that is
//! as good as it says.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::{Events, Served, recording};

/// What people wait for when they end a program.
const PATIENCE_WITH_CTRL_C: Duration = Duration::from_secs(2);

/// The configuration of `cameras` that each replay the walk once, at this pace.
fn walking(cameras: &[&str], pace: &str) -> String {
    let path = recording("walk.mcap").display().to_string();
    let source = format!("source = {{ kind = \"recording\", path = {path:?}, pace = {pace:?} }}");
    cameras.iter().map(|name| format!("[[camera]]\nname = {name:?}\n{source}\n")).collect()
}

fn start_session(served: &Served, camera: &str, request: &Value) -> String {
    let started = served.post(&format!("/v1/cameras/{camera}/sessions"), request);
    assert_eq!(started.status, 201, "{}", started.text());
    started.json()["id"].as_str().unwrap().to_owned()
}

/// The first announcement of session `id` for which `wanted` holds.
fn until_session(events: &mut Events, id: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    events
        .until(|event| event.name == "session" && event.data["id"] == *id && wanted(&event.data))
        .data
}

fn has_kept(count: u64) -> impl Fn(&Value) -> bool {
    move |session| session["views_kept"].as_u64() >= Some(count)
}

fn stop(served: &Served, id: &str) -> Value {
    let stopped = served.post_nothing(&format!("/v1/sessions/{id}/stop"));
    assert_eq!(stopped.status, 200, "{}", stopped.text());
    stopped.json()
}

fn request(lens: &str) -> Value {
    json!({"target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}, "lens": lens})
}

/// Starts a session, waits until it has seen the whole recording, stops it; the finished session.
fn calibrate(served: &Served, camera: &str, request: &Value) -> Value {
    let mut events = served.events("", Some("0"));
    let id = start_session(served, camera, request);
    until_session(&mut events, &id, |session| {
        session["reason"].as_str().is_some_and(|reason| reason.contains("has ended"))
    });
    let session = stop(served, &id);
    assert_eq!(session["state"], "finished", "{session}");
    session
}

fn calibration_of(served: &Served, session: &Value) -> Value {
    served.get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap())).json()
}

/// What of a calibration must not depend on when and where it was made.
fn without_ids_and_times(mut calibration: Value) -> String {
    for key in ["id", "session", "camera", "created_at"] {
        assert!(calibration.as_object_mut().unwrap().remove(key).is_some(), "{key}");
    }
    calibration.to_string()
}

#[test]
fn a_walk_becomes_a_calibration_as_good_as_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["front"], "fastest"));
    let session = calibrate(&served, "front", &request("brown"));
    assert!(has_kept(12)(&session), "{session}");
    assert_eq!(session["frames_seen"], 150, "a replay skips nothing: {session}");
    assert!(session["coverage"]["fraction"].as_f64() > Some(0.7), "{session}");

    let calibration = calibration_of(&served, &session);
    let truth: Value =
        serde_json::from_slice(&std::fs::read(recording("walk.truth.json")).unwrap()).unwrap();
    let (color, true_lens) = (&calibration["sensors"]["color"], &truth["sensors"]["color"]["lens"]);
    for parameter in ["fx", "fy", "cx", "cy"] {
        let of = |lens: &Value| lens[parameter].as_f64().unwrap();
        let (found, true_value, std) = (of(&color["lens"]), of(true_lens), of(&color["lens_std"]));
        assert!(
            std > 0.0 && (found - true_value).abs() < 3.0 * std,
            "{parameter}: {found}, truly {true_value} ± {std}"
        );
        assert!(
            (found / true_value - 1.0).abs() < 1e-3,
            "{parameter}: {found}, truly {true_value}"
        );
    }
    assert_eq!(calibration["verdict"]["grade"], "good", "{}", calibration["verdict"]);
    let current = served.get("/v1/cameras/front/calibration").json();
    assert_eq!(current, calibration, "a good one is approved by itself");
}

#[test]
fn a_killed_daemon_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let at_its_pace = walking(&["front"], "recorded");
    let served = Served::start(folder.path(), &at_its_pace);
    let mut events = served.events("", Some("0"));
    let id = start_session(&served, "front", &request("brown"));
    let seen = until_session(&mut events, &id, has_kept(5));
    served.kill();

    let served = Served::start(folder.path(), &at_its_pace);
    let session = served.get(&format!("/v1/sessions/{id}")).json();
    assert_eq!(session["state"], "collecting", "{session}");
    let before = session["views_kept"].as_u64().unwrap();
    assert!(Some(before) >= seen["views_kept"].as_u64(), "{session}");
    let mut events = served.events("", Some("0"));
    until_session(&mut events, &id, has_kept(before + 1));
    let views = served.get(&format!("/v1/sessions/{id}/views")).json();
    assert!(views["views"].as_array().unwrap().len() as u64 > before);
    let image = served.get(&format!("/v1/sessions/{id}/views/0.jpg"));
    assert_eq!((image.status, &image.bytes[..2]), (200, &[0xff, 0xd8][..]));
    let session = stop(&served, &id);
    assert_eq!((&session["state"], &session["id"]), (&json!("finished"), &json!(id)), "{session}");
}

#[test]
fn ten_replays_give_the_same_bytes() {
    let replays = |served: &Served, camera: &str, count: usize| -> Vec<String> {
        let calibration = |_| calibration_of(served, &calibrate(served, camera, &request("brown")));
        (0..count).map(calibration).map(without_ids_and_times).collect()
    };
    let folder = tempfile::tempdir().unwrap();
    let alone = replays(&Served::start(folder.path(), &walking(&["front"], "fastest")), "front", 4);
    // Two at a time share processors and store, and so come out of step.
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["left", "right"], "fastest"));
    let together = std::thread::scope(|scope| {
        ["left", "right"]
            .map(|camera| scope.spawn(|| replays(&served, camera, 3)))
            .map(|thread| thread.join().unwrap())
            .concat()
    });
    assert_eq!(alone.len() + together.len(), 10);
    for other in alone.iter().chain(&together) {
        assert_eq!(*other, alone[0]);
    }
}

#[test]
fn a_session_with_a_goal_ends_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["front"], "fastest"));
    let mut events = served.events("", Some("0"));
    let mut request = request("brown");
    request["finish"] = json!({"uncertainty_px": 0.2, "min_views": 12, "max_seconds": 600});
    let id = start_session(&served, "front", &request);
    let session = until_session(&mut events, &id, |session| session["state"] == "finished");
    assert!(has_kept(12)(&session), "{session}");
    let median = &calibration_of(&served, &session)["sensors"]["color"]["uncertainty_px"]["median"];
    assert!(median.as_f64().unwrap() <= 0.2, "{median}");
}

#[test]
fn ctrl_c_ends_it_soon_and_cleanly_in_the_middle_of_everything() {
    for signal in ["INT", "TERM"] {
        let folder = tempfile::tempdir().unwrap();
        let mut served = Served::start(folder.path(), &walking(&["front"], "recorded"));
        let mut events = served.events("", Some("0"));
        let id = start_session(&served, "front", &request("brown"));
        until_session(&mut events, &id, has_kept(1));
        let asked = Instant::now();
        served.signal(signal);
        assert!(served.ended().success(), "{signal}");
        assert!(asked.elapsed() < PATIENCE_WITH_CTRL_C, "{signal}: {:?}", asked.elapsed());
        let served = Served::start(folder.path(), &walking(&["front"], "recorded"));
        assert_eq!(served.get(&format!("/v1/sessions/{id}")).json()["state"], "collecting");
    }
}

#[test]
fn a_hangup_exchanges_the_cameras_that_changed() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["left", "right"], "recorded"));
    let mut events = served.events("", Some("0"));
    let id = start_session(&served, "left", &request("brown"));
    let file = folder.path().join("plumb.toml");
    let with_third = std::fs::read_to_string(&file).unwrap().replace("\"right\"", "\"third\"");
    std::fs::write(&file, with_third).unwrap();
    served.signal("HUP");
    events.until(|event| {
        event.name == "camera"
            && event.data["name"] == "third"
            && event.data["state"] == "streaming"
    });
    let names = |served: &Served| {
        let cameras = served.get("/v1/cameras").json();
        let names =
            cameras["cameras"].as_array().unwrap().iter().map(|camera| camera["name"].clone());
        names.collect::<Vec<_>>()
    };
    assert_eq!(names(&served), ["left", "third"]);
    assert_eq!(
        served.get(&format!("/v1/sessions/{id}")).json()["state"],
        "collecting",
        "left did not notice"
    );

    // A camera in another's place has that place in the list; the session of the one that went can
    // only be given up.
    let renamed = std::fs::read_to_string(&file).unwrap().replacen("\"left\"", "\"first\"", 1);
    std::fs::write(&file, renamed).unwrap();
    served.signal("HUP");
    events.until(|event| {
        event.name == "camera"
            && event.data["name"] == "first"
            && event.data["state"] == "streaming"
    });
    assert!((0..10_000).any(|_| names(&served) == ["first", "third"]), "{:?}", names(&served));
    let path = format!("/v1/sessions/{id}");
    let stopped = served.post_nothing(&format!("{path}/stop"));
    assert_eq!(stopped.status, 409);
    assert!(stopped.text().contains("`left`, which is not configured any more"));
    assert_eq!(served.delete(&path).json()["state"], "aborted");
    assert_eq!(served.delete(&path).status, 409, "it is over");
    assert_eq!(served.delete(&format!("{path}?purge=true")).status, 200);
}

/// What a camera gave, recorded and replayed, gives what the camera itself gives: no frame is
/// encoded anew.
#[test]
fn a_recorded_camera_calibrates_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["front"], "fastest"));
    let live = calibration_of(&served, &calibrate(&served, "front", &request("brown")));
    drop(served);
    let (config, copy) = (folder.path().join("plumb.toml"), folder.path().join("copy.mcap"));
    let recorded = plumb([
        "record",
        "--camera",
        "front",
        "--out",
        copy.to_str().unwrap(),
        "--config",
        config.to_str().unwrap(),
    ]);
    assert_eq!(recorded.code, Some(0), "{}", recorded.stderr);
    let source = format!(
        "{{ kind = \"recording\", path = {:?}, pace = \"fastest\" }}",
        copy.display().to_string()
    );
    let folder = tempfile::tempdir().unwrap();
    let served =
        Served::start(folder.path(), &format!("[[camera]]\nname = \"front\"\nsource = {source}\n"));
    let replayed = calibration_of(&served, &calibrate(&served, "front", &request("brown")));
    assert_eq!(without_ids_and_times(replayed), without_ids_and_times(live));
}

#[test]
fn a_lens_that_was_changed_since_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["front"], "fastest"));
    let good = calibration_of(&served, &calibrate(&served, "front", &request("brown")));
    assert_eq!(good["verdict"]["grade"], "good", "{}", good["verdict"]);
    // The same lens again is no drift.
    let mut events = served.events("?camera=front", None);
    calibrate(&served, "front", &request("brown"));
    // Another lens of another focal length under the same name.
    let file = folder.path().join("plumb.toml");
    std::fs::write(
        &file,
        std::fs::read_to_string(&file).unwrap().replace("walk.mcap", "hard.mcap"),
    )
    .unwrap();
    served.signal("HUP");
    events.until(|event| {
        assert_ne!(event.name, "drift", "{}", event.data);
        event.name == "camera"
            && event.data["identity"]["bus"].as_str().is_some_and(|bus| bus.ends_with("hard.mcap"))
    });
    let other = events.until(|event| event.name == "drift").data;
    let reason = served.get("/v1/cameras/front").json()["reason"].as_str().unwrap().to_owned();
    assert!(
        reason.starts_with("the source changed from recording ") && other["reason"] == reason,
        "{other}"
    );
    assert!(other["calibration"].is_string() && other["rms_px"].is_null(), "{other}");
    // The boards say so too.
    let id = start_session(&served, "front", &request("brown"));
    let drift = events.until(|event| event.name == "drift").data;
    assert!(drift["reason"].as_str().unwrap().contains("calibrate again"), "{drift}");
    assert!(drift["rms_px"].as_f64().unwrap() > drift["expected_px"].as_f64().unwrap(), "{drift}");
    assert_eq!(served.delete(&format!("/v1/sessions/{id}")).json()["state"], "aborted");
}

#[test]
fn what_cannot_be_served_is_said_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &walking(&["front"], "recorded"));
    let taken = served.address.trim_start_matches("http://");
    let file = folder.path().join("other.toml");
    let refusal = |text: String, listen: &str| {
        std::fs::write(&file, text).unwrap();
        let finished = plumb(["serve", "--listen", listen, "--config", file.to_str().unwrap()]);
        assert_eq!(
            (finished.stderr.lines().count(), finished.stdout.as_str()),
            (1, ""),
            "{}",
            finished.stderr
        );
        (finished.code, finished.stderr)
    };
    let store = |name: &str| {
        format!("[store]\npath = {:?}\n", folder.path().join(name).display().to_string())
    };
    let (code, line) = refusal(store("other"), taken);
    assert!(
        code == Some(1) && line.contains(&format!("cannot listen on {taken}")),
        "{code:?} {line}"
    );
    let (code, line) = refusal(store("store"), "127.0.0.1:0");
    assert!(code == Some(1) && line.contains("in use by another plumb"), "{code:?} {line}");
    let (code, line) = refusal("[server]\nlissten = 1\n".to_owned(), "127.0.0.1:0");
    assert!(code == Some(2) && line.contains("other.toml:2: lissten"), "{code:?} {line}");
    let missing =
        "[[camera]]\nname = \"front\"\nsource = { kind = \"recording\", path = \"none.mcap\" }\n";
    let (code, line) = refusal(missing.to_owned(), "127.0.0.1:0");
    assert!(
        code == Some(2) && line.contains("other.toml:3: camera.source.path: `none.mcap`"),
        "{code:?} {line}"
    );
}
