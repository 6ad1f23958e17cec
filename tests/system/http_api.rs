//! A client that knows only the contract finds every route, field, status and media type as it is
//! written there.

use serde_json::{Value, json};

use crate::served::{Answer, Events, Served, replaying};

const PROBLEM: &str = "application/problem+json";

fn started() -> (tempfile::TempDir, Served) {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    served.events("?camera=front", Some("0")).until(|event| event.name == "frame");
    (folder, served)
}

fn target() -> Value {
    json!({"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025})
}

fn start_session(served: &Served) -> String {
    let answer =
        served.post("/v1/cameras/front/sessions", &json!({"target": target(), "lens": "brown"}));
    assert_eq!(answer.status, 201, "{}", answer.text());
    answer.json()["id"].as_str().unwrap().to_owned()
}

/// Waits until the session `id` has kept `count` views.
fn wait_for_views(events: &mut Events, id: &str, count: u64) -> Value {
    let has = |data: &Value| data["id"] == id && data["views_kept"].as_u64().unwrap() >= count;
    events.until(|event| event.name == "session" && has(&event.data)).data
}

/// A session that has run over the recording and was stopped.
fn calibrated(served: &Served) -> Value {
    let mut events = served.events("", None);
    let id = start_session(served);
    wait_for_views(&mut events, &id, 12);
    let answer = served.post_nothing(&format!("/v1/sessions/{id}/stop"));
    assert_eq!(answer.status, 200, "{}", answer.text());
    let session = answer.json();
    assert_eq!(session["state"], "finished", "{session}");
    session
}

#[test]
fn a_session_says_that_its_calibration_was_deleted() {
    let folder = tempfile::tempdir().unwrap();
    // An approved calibration is never deleted.
    let config = replaying("front", "walk.mcap") + "[calibration]\nauto_approve = false\n";
    let served = Served::start(folder.path(), &config);
    served.events("?camera=front", Some("0")).until(|event| event.name == "frame");
    let session = calibrated(&served);
    let (id, calibration) = (&session["id"], session["calibration"].as_str().unwrap());
    let path = format!("/v1/sessions/{}", id.as_str().unwrap());
    let shown = || {
        let listed = served.get("/v1/sessions").json()["sessions"][0].clone();
        [served.get(&path).json(), listed].map(|session| session["calibration_deleted"].clone())
    };
    assert_eq!(shown(), [Value::Null, Value::Null]);
    assert_eq!(served.delete(&format!("/v1/calibrations/{calibration}")).status, 204);
    assert_eq!(shown(), [json!(true), json!(true)]);
    assert_eq!(served.get(&path).json()["calibration"], calibration, "still named");
}

#[track_caller]
fn has_fields(document: &Value, fields: &[&str]) {
    let object = document.as_object().unwrap_or_else(|| panic!("not an object: {document}"));
    for field in fields {
        assert!(object.contains_key(*field), "no `{field}` in {document}");
    }
}

#[track_caller]
fn is_problem(answer: &Answer, status: u16) -> Value {
    assert_eq!(answer.status, status, "{}", answer.text());
    assert_eq!(answer.media_type, PROBLEM);
    let problem = answer.json();
    has_fields(&problem, &["type", "title", "status", "detail"]);
    assert_eq!(problem["status"], status);
    assert!(problem["detail"].as_str().unwrap().len() > 10, "{problem}");
    problem
}

#[track_caller]
fn is_jpeg(answer: &Answer, size: (u32, u32)) {
    assert_eq!(
        (answer.status, answer.media_type.as_str()),
        (200, "image/jpeg"),
        "{}",
        answer.text()
    );
    let image =
        image::load_from_memory_with_format(&answer.bytes, image::ImageFormat::Jpeg).unwrap();
    assert_eq!((image.width(), image.height()), size);
}

#[test]
fn the_daemon_reports_its_state() {
    let (_folder, served) = started();
    assert_eq!(served.get("/healthz").status, 200);
    assert_eq!(served.get("/readyz").status, 200);
    let metrics = served.get("/metrics");
    assert_eq!(metrics.status, 200);
    assert!(metrics.media_type.starts_with("text/plain"), "{}", metrics.media_type);
    assert!(
        metrics.text().lines().any(|line| line.starts_with("plumb_frames_total{camera=\"front\"}"))
    );
    let page = served.get("/");
    assert!(page.status == 200 && page.media_type.starts_with("text/html"), "{}", page.media_type);
    for part in ["/page/style.css", "/page/script.js"] {
        assert_eq!(served.get(part).status, 200);
    }
}

/// Nothing is known of the board: what is seen says it.
#[test]
fn the_board_in_view_is_named() {
    let (_folder, served) = started();
    let mut events = served.events("?camera=front", None);
    let seen = std::iter::repeat_with(|| {
        events.until(|event| event.name == "frame");
        served.get("/v1/cameras/front/target")
    });
    let found = seen.take(60).map(|answer| {
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()
    });
    let document = found.into_iter().find(|document| document["found"] == true).unwrap();
    assert_eq!(document["target"], json!({"kind": "chessboard", "cols": 9, "rows": 6}));
    assert_eq!(document["name"], "chessboard of 9x6 inner corners");
    assert_eq!((&document["corners"], &document["reason"]), (&json!(54), &json!(null)));
    is_problem(&served.get("/v1/cameras/rear/target"), 404);
}

#[test]
fn without_a_delivering_camera_it_is_alive_but_not_ready() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), "");
    assert_eq!(served.get("/healthz").status, 200);
    is_problem(&served.get("/readyz"), 503);
    assert_eq!(served.get("/v1/cameras").json(), json!({"cameras": []}));
}

#[test]
fn a_camera_is_shown_with_its_image() {
    let (_folder, served) = started();
    let list = served.get("/v1/cameras");
    assert_eq!((list.status, list.media_type.as_str()), (200, "application/json"));
    let camera = &list.json()["cameras"][0];
    let fields = [
        "name",
        "backend",
        "state",
        "reason",
        "sensors",
        "fps",
        "dropped_frames",
        "identity",
        "calibration",
    ];
    has_fields(camera, &fields);
    has_fields(&camera["identity"], &["serial", "bus"]);
    assert_eq!(
        (&camera["name"], &camera["backend"], &camera["state"]),
        (&json!("front"), &json!("recording"), &json!("streaming"))
    );
    assert_eq!(camera["sensors"]["color"]["image_size"], json!([640, 480]));
    has_fields(&served.get("/v1/cameras/front").json(), &fields);
    for query in ["", "?overlay=true", "?sensor=color&overlay=true&undistorted=false"] {
        is_jpeg(&served.get(&format!("/v1/cameras/front/frame.jpg{query}")), (640, 480));
    }
    // A preview of what cannot be shown would be silent for ever.
    for path in ["frame.jpg", "preview.mjpg"] {
        let refused = |query: &str| served.get(&format!("/v1/cameras/front/{path}?{query}"));
        is_problem(&refused("sensor=depth"), 404);
        for uncalibrated in ["undistorted=true", "rectified=true"] {
            is_problem(&refused(uncalibrated), 409);
        }
    }
    assert_eq!(
        is_problem(&served.get("/v1/cameras/front/frame.jpg?sensor=x"), 422)["field"],
        "sensor"
    );
    assert_eq!(
        is_problem(&served.get("/v1/cameras/front/frame.jpg?overlay=2"), 422)["field"],
        "overlay"
    );
    for flat in ["rectified=true&alpha=1.5", "undistorted=true&alpha=x", "alpha=1"] {
        for path in ["frame.jpg", "preview.mjpg"] {
            let refused = served.get(&format!("/v1/cameras/front/{path}?{flat}"));
            assert_eq!(is_problem(&refused, 422)["field"], "alpha", "{path}?{flat}");
        }
    }
    is_problem(&served.get("/v1/cameras/front/calibration"), 404);
    // A recording's device states nothing.
    is_problem(&served.get("/v1/cameras/front/factory"), 404);
    for unknown in ["", "/frame.jpg", "/preview.mjpg", "/calibration", "/calibrations", "/factory"]
    {
        is_problem(&served.get(&format!("/v1/cameras/rear{unknown}")), 404);
    }
}

#[test]
fn a_session_runs_from_start_to_calibration() {
    let (_folder, served) = started();
    let mut events = served.events("?camera=front", None);
    let body = json!({"target": target(), "lens": "brown", "finish": {"uncertainty_px": 1e-9, "min_views": 12, "max_seconds": 600.0}});
    let answer = served.post("/v1/cameras/front/sessions", &body);
    assert_eq!(
        (answer.status, answer.media_type.as_str()),
        (201, "application/json"),
        "{}",
        answer.text()
    );
    let session = answer.json();
    let fields = [
        "id",
        "camera",
        "state",
        "reason",
        "started_at",
        "finished_at",
        "target",
        "lens",
        "finish",
        "frames_seen",
        "boards_seen",
        "views_kept",
        "rejected",
        "coverage",
        "guidance",
        "estimate",
        "calibration",
    ];
    has_fields(&session, &fields);
    let id = session["id"].as_str().unwrap();
    assert_eq!(answer.location, Some(format!("/v1/sessions/{id}")));
    assert_eq!(
        (&session["state"], &session["target"], &session["finish"]),
        (&json!("collecting"), &body["target"], &body["finish"])
    );
    is_problem(&served.post("/v1/cameras/front/sessions", &body), 409);

    let seen = wait_for_views(&mut events, id, 12);
    has_fields(&seen["rejected"], &["blurred", "too_similar"]);
    has_fields(&seen["coverage"], &["fraction", "cells"]);
    has_fields(&seen["guidance"], &["message", "outline_px"]);
    let path = format!("/v1/sessions/{id}");
    assert_eq!(served.get(&path).json()["id"], id);
    assert_eq!(served.get("/v1/sessions").json()["sessions"][0]["id"], id);

    let stopped = served.post_nothing(&format!("{path}/stop"));
    assert_eq!(stopped.status, 200, "{}", stopped.text());
    let finished = stopped.json();
    assert_eq!(finished["state"], "finished", "{finished}");
    let calibration = finished["calibration"].as_str().unwrap();
    let calibration = served.get(&format!("/v1/calibrations/{calibration}")).json();
    for figure in ["lens", "rms_px", "uncertainty_px"] {
        let solved = &calibration["sensors"]["color"][figure];
        assert_eq!(&finished["estimate"][figure], solved, "{figure}: the estimate is the solve's");
    }
    is_problem(&served.post_nothing(&format!("{path}/stop")), 409);
    is_problem(&served.delete(&path), 409);

    let views = served.get(&format!("{path}/views")).json();
    let views = views["views"].as_array().unwrap();
    assert_eq!(views.len() as u64, finished["views_kept"].as_u64().unwrap());
    let square = |number: &Value| number.as_f64().unwrap().powi(2);
    for (n, view) in views.iter().enumerate() {
        has_fields(view, &["n", "name", "rms_px", "residuals_px", "used", "reason", "picture"]);
        assert_eq!(view["n"], n);
        if let (Some(rms_px), Some(residuals)) =
            (view["rms_px"].as_f64(), view["residuals_px"].as_array())
        {
            let squares: f64 =
                residuals.iter().flat_map(|r| r.as_array().unwrap()).map(square).sum();
            let own_rms_px = (squares / residuals.len() as f64).sqrt();
            assert!((own_rms_px - rms_px).abs() < 1e-3, "view {n}: {own_rms_px}, stated {rms_px}");
        }
        assert_eq!(view["picture"], format!("{path}/views/{n}.jpg"));
    }
    let page = served.get(&format!("{path}/views?limit=2&cursor=1"));
    assert_eq!(page.json()["views"].as_array().unwrap()[..], views[2..4]);
    let next = format!("<{path}/views?limit=2&cursor=3>; rel=\"next\"");
    assert_eq!(page.link, Some(next));
    assert_eq!(views[0]["residuals_px"].as_array().unwrap().len(), 54);
    is_jpeg(&served.get(&format!("{path}/views/0.jpg")), (640, 480));
    for unknown in ["999.jpg", "0.png", "-1.jpg", "x.jpg", "0"] {
        is_problem(&served.get(&format!("{path}/views/{unknown}")), 404);
    }
}

#[test]
fn a_calibration_is_served_in_every_format_and_approved() {
    let (_folder, served) = started();
    let session = calibrated(&served);
    let id = session["calibration"].as_str().unwrap();
    let answer = served.get(&format!("/v1/calibrations/{id}"));
    assert_eq!((answer.status, answer.media_type.as_str()), (200, "application/json"));
    let calibration = answer.json();
    has_fields(
        &calibration,
        &[
            "id",
            "camera",
            "session",
            "created_at",
            "target",
            "sensors",
            "extrinsics",
            "checks",
            "verdict",
        ],
    );
    let sensor = &calibration["sensors"]["color"];
    has_fields(sensor, &["image_size", "lens", "lens_std", "rms_px", "uncertainty_px", "views"]);
    has_fields(
        &sensor["lens"],
        &["model", "fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3"],
    );
    has_fields(&sensor["uncertainty_px"], &["center", "median", "worst"]);
    has_fields(&sensor["views"][0], &["name", "used", "reason", "rms_px", "camera_from_board"]);
    has_fields(&sensor["views"][0]["camera_from_board"]["rotation"], &["w", "x", "y", "z"]);
    has_fields(
        &calibration["checks"],
        &["split_half_ratio", "held_out_rms_px", "outlier_fraction", "coverage"],
    );
    has_fields(&calibration["verdict"], &["grade", "reasons"]);
    assert_eq!(
        (&calibration["session"], &calibration["camera"]),
        (&session["id"], &json!("front"))
    );

    let approved = served.post_nothing(&format!("/v1/calibrations/{id}/approve"));
    assert_eq!(approved.status, 200, "{}", approved.text());
    assert_eq!(served.get("/v1/cameras/front").json()["calibration"], id);
    assert_eq!(served.get("/v1/cameras/front/calibration").json()["id"], id);
    let formats = [
        ("json", "application/json"),
        ("ros", "application/yaml"),
        ("opencv", "application/yaml"),
        ("kalibr", "application/yaml"),
        ("mrcal", "text/plain; charset=utf-8"),
        ("colmap", "text/plain; charset=utf-8"),
    ];
    for (format, media_type) in formats {
        for path in ["/v1/cameras/front/calibration".to_owned(), format!("/v1/calibrations/{id}")] {
            let answer = served.get(&format!("{path}?format={format}"));
            assert_eq!(
                (answer.status, answer.media_type.as_str()),
                (200, media_type),
                "{format}: {}",
                answer.text()
            );
            assert!(!answer.bytes.is_empty());
        }
    }
    assert_eq!(
        is_problem(&served.get("/v1/cameras/front/calibration?format=x"), 422)["field"],
        "format"
    );
    let half = served.get("/v1/cameras/front/calibration?width=320&height=240").json();
    let half = &half["sensors"]["color"];
    assert_eq!(half["image_size"], json!([320, 240]));
    let ratio = half["lens"]["fx"].as_f64().unwrap() / sensor["lens"]["fx"].as_f64().unwrap();
    assert!((ratio - 0.5).abs() < 1e-12, "{ratio}");
    assert_eq!(
        is_problem(&served.get("/v1/cameras/front/calibration?width=320"), 422)["field"],
        "height"
    );
    is_problem(&served.get("/v1/cameras/front/calibration?width=320&height=320"), 422);
    let part =
        served.get("/v1/cameras/front/calibration?crop=80,60,480,360&width=240&height=180").json();
    let part = &part["sensors"]["color"];
    assert_eq!(part["image_size"], json!([240, 180]));
    let cx = (sensor["lens"]["cx"].as_f64().unwrap() + 0.5 - 80.0) / 2.0 - 0.5;
    assert!((part["lens"]["cx"].as_f64().unwrap() - cx).abs() < 1e-9, "{}", part["lens"]);
    for crop in ["80,60,600,360", "80,60", "80,60,-1,3"] {
        let refused = served.get(&format!("/v1/cameras/front/calibration?crop={crop}&format=ros"));
        assert_eq!(is_problem(&refused, 422)["field"], "crop");
    }
    let focus =
        served.get("/v1/cameras/front/focus?pixel_um=3&f_number=2&focus_m=0.5&cols=9").json();
    let focal_px = focus["focal_px"].as_f64().unwrap();
    assert!(
        (focal_px - sensor["lens"]["fx"].as_f64().unwrap()).abs() < 1e-6,
        "the calibrated one: {focus}"
    );
    has_fields(&focus["depth_of_field"], &["near_m", "far_m"]);
    has_fields(&focus["board"], &["cols", "square_m", "distance_m"]);
    assert_eq!(
        is_problem(&served.get("/v1/cameras/front/focus?pixel_um=3"), 422)["field"],
        "f_number"
    );
    let history = served.get("/v1/cameras/front/calibrations").json();
    assert_eq!(history["calibrations"][0]["id"], id);
    let heat = served.get(&format!("/v1/calibrations/{id}/uncertainty.png"));
    assert_eq!((heat.status, heat.media_type.as_str()), (200, "image/png"), "{}", heat.text());
    assert!(image::load_from_memory(&heat.bytes).is_ok());
    let flat = is_problem(&served.get(&format!("/v1/calibrations/{id}/board.png")), 404);
    assert!(flat["detail"].to_string().contains("no measured board shape"), "{flat}");
    let numbers = served.get(&format!("/v1/calibrations/{id}/uncertainty?distance_m=0.5")).json();
    has_fields(&numbers, &["sensor", "distance_m", "image_size", "x_px", "y_px", "std_px"]);
    assert_eq!(
        numbers["std_px"][0].as_array().unwrap().len(),
        numbers["x_px"].as_array().unwrap().len()
    );
    let negative = served.get(&format!("/v1/calibrations/{id}/uncertainty?distance_m=-1"));
    assert_eq!(is_problem(&negative, 422)["field"], "distance_m");
    is_jpeg(&served.get("/v1/cameras/front/frame.jpg?undistorted=true"), (640, 480));
    is_jpeg(&served.get("/v1/cameras/front/frame.jpg?undistorted=true&alpha=1"), (640, 480));
    is_problem(&served.get("/v1/calibrations/none"), 404);
    is_problem(&served.post_nothing("/v1/calibrations/none/approve"), 404);
}

#[test]
fn the_way_back_to_an_older_calibration_is_to_approve_it() {
    let (_folder, served) = started();
    let ids =
        [calibrated(&served)["calibration"].clone(), calibrated(&served)["calibration"].clone()];
    let history = served.get("/v1/cameras/front/calibrations").json();
    assert_eq!(
        (&history["calibrations"][0]["id"], &history["calibrations"][1]["id"]),
        (&ids[1], &ids[0])
    );
    let newest = served.get("/v1/cameras/front/calibrations?limit=1");
    assert_eq!(newest.json()["calibrations"][0]["id"], ids[1]);
    let next = newest.link.unwrap();
    let next = next.trim_start_matches('<').split('>').next().unwrap();
    let older = served.get(next);
    assert_eq!((&older.json()["calibrations"][0]["id"], older.link), (&ids[0], None));
    for id in [&ids[1], &ids[0]] {
        assert_eq!(
            served
                .post_nothing(&format!("/v1/calibrations/{}/approve", id.as_str().unwrap()))
                .status,
            200
        );
        assert_eq!(&served.get("/v1/cameras/front/calibration").json()["id"], id);
    }
    let sessions = served.get("/v1/sessions").json();
    assert_eq!(sessions["sessions"][0]["calibration"], ids[1]);
}

#[test]
fn too_few_views_fail_and_stay() {
    let (_folder, served) = started();
    let mut events = served.events("", None);
    // A board that is not there.
    let body = json!({"target": {"kind": "chessboard", "cols": 7, "rows": 4, "square_m": 0.025}});
    let id =
        served.post("/v1/cameras/front/sessions", &body).json()["id"].as_str().unwrap().to_owned();
    events.until(|event| event.name == "detection" && event.data["session"] == id.as_str());
    let stopped = served.post_nothing(&format!("/v1/sessions/{id}/stop"));
    assert_eq!(stopped.status, 200, "{}", stopped.text());
    assert_eq!(stopped.json()["state"], "failed");
    assert!(stopped.json()["reason"].as_str().unwrap().len() > 10);
    assert_eq!(served.get(&format!("/v1/sessions/{id}/views")).status, 200);
}

#[test]
fn a_session_is_aborted_and_one_is_stopped_without_waiting() {
    let (_folder, served) = started();
    let mut events = served.events("", None);
    let id = start_session(&served);
    let aborted = served.delete(&format!("/v1/sessions/{id}"));
    assert!((200..300).contains(&aborted.status), "{}", aborted.text());
    assert_eq!(served.get(&format!("/v1/sessions/{id}")).json()["state"], "aborted");
    let id = start_session(&served);
    wait_for_views(&mut events, &id, 6);
    let answer = served.post_nothing(&format!("/v1/sessions/{id}/stop?wait=false"));
    assert_eq!(answer.status, 202, "{}", answer.text());
    let over = |data: &Value| {
        data["id"] == id.as_str()
            && ["finished", "failed"].contains(&data["state"].as_str().unwrap())
    };
    events.until(|event| event.name == "session" && over(&event.data));
    for unknown in ["/v1/sessions/none", "/v1/sessions/none/views", "/v1/sessions/none/views/0.jpg"]
    {
        is_problem(&served.get(unknown), 404);
    }
    is_problem(&served.post_nothing("/v1/sessions/none/stop"), 404);
    is_problem(&served.delete("/v1/sessions/none"), 404);
}

#[test]
fn events_are_numbered_filtered_and_resumed() {
    let (_folder, served) = started();
    let mut events = served.events("?camera=front", None);
    let id = start_session(&served);
    let detection = events.until(|event| event.name == "detection");
    has_fields(
        &detection.data,
        &["camera", "session", "sequence", "found", "corners", "elapsed_ms"],
    );
    let kept = events
        .until(|event| event.name == "session" && event.data["views_kept"].as_u64().unwrap() > 0);
    assert_eq!(kept.data["id"], id.as_str());
    let next = events.until(|event| event.name == "session");
    let resumed =
        served.events("?camera=front", Some(&kept.id)).until(|event| event.name == "session");
    assert_eq!((resumed.id, resumed.data), (next.id, next.data));
    let frame = events.until(|event| event.name == "frame");
    has_fields(&frame.data, &["camera", "sequence"]);
    assert!(frame.id.parse::<u64>().unwrap() > kept.id.parse::<u64>().unwrap());
    is_problem(&served.get("/v1/events?camera=rear"), 404);
}

#[test]
fn bad_bodies_are_refused_by_field() {
    let (_folder, served) = started();
    let sessions = "/v1/cameras/front/sessions";
    let board = |cols: Value, square: Value| json!({"target": {"kind": "chessboard", "cols": cols, "rows": 6, "square_m": square}});
    let table = [
        (sessions, json!({}), "target"),
        (sessions, board(json!(2), json!(0.025)), "target.cols"),
        (sessions, board(json!(9), json!(-1)), "target.square_m"),
        (sessions, board(json!("9"), json!(0.025)), "target.cols"),
        (sessions, json!({"target": target(), "lens": "fov"}), "lens"),
        (
            sessions,
            json!({"target": target(), "finish": {"uncertainty_px": 0}}),
            "finish.uncertainty_px",
        ),
        (sessions, json!({"target": target(), "finnish": {}}), "finnish"),
        ("/v1/solve", json!({"image_size": [640, 480]}), "views"),
        ("/v1/solve", json!({"image_size": [0, 480], "views": []}), "image_size"),
        ("/v1/solve", json!({"image_size": [640, 480], "views": []}), "views"),
        (
            "/v1/solve",
            json!({"image_size": [640, 480], "views": [{"object": [[0, 0, 0]], "image": [[1, null]]}]}),
            "views[0].image[0][1]",
        ),
        (
            "/v1/solve",
            json!({"image_size": [640, 480], "views": [{"object": [[0, 0, 0]], "image": [[1, 2]]}]}),
            "views",
        ),
    ];
    for (path, body, field) in table {
        let problem = is_problem(&served.post(path, &body), 422);
        assert_eq!(problem["field"], field, "{body}: {problem}");
        assert!(problem["detail"].as_str().unwrap().contains(field), "{problem}");
    }
    let nan = r#"{"image_size":[640,480],"views":[{"object":[[0,0,0]],"image":[[1,NaN]]}]}"#;
    assert_eq!(
        is_problem(&served.post_text("/v1/solve", "application/json", nan), 422)["field"],
        "views[0].image[0][1]"
    );
    for path in [sessions, "/v1/solve"] {
        for broken in ["{", "", "{]"] {
            is_problem(&served.post_text(path, "application/json", broken), 400);
        }
        is_problem(&served.post_text(path, "text/plain", "{}"), 415);
    }
    let large = format!("{{\"target\": \"{}\"}}", "x".repeat(2 << 20));
    is_problem(&served.post_text(sessions, "application/json", &large), 413);
}

#[test]
fn what_is_not_there_or_not_with_this_method_is_a_problem_too() {
    let (_folder, served) = started();
    for path in [
        "/v2",
        "/v1",
        "/v1/cameras/",
        "/page/../Cargo.toml",
        "/page/%2e%2e%2fCargo.toml",
        "/v1/cameras/%2e%2e%2f%2e%2e/frame.jpg",
        "/v1/cameras/%ff",
    ] {
        is_problem(&served.get(path), 404);
    }
    is_problem(&served.post("/v1/cameras", &json!({})), 405);
    is_problem(&served.delete("/healthz"), 405);
    is_problem(&served.get("/v1/solve"), 405);
    is_problem(&served.get("/v1/cameras/front/sessions"), 405);
}

#[test]
fn a_stateless_solve_answers_with_a_calibration() {
    let (_folder, served) = started();
    let answer = served.post("/v1/solve", &pinhole_problem());
    assert_eq!(
        (answer.status, answer.media_type.as_str()),
        (200, "application/json"),
        "{}",
        answer.text()
    );
    let calibration = answer.json();
    let lens = &calibration["sensors"]["color"]["lens"];
    assert_eq!(lens["model"], "pinhole");
    for (name, truth) in [("fx", 600.0), ("fy", 610.0), ("cx", 320.0), ("cy", 240.0)] {
        assert!((lens[name].as_f64().unwrap() - truth).abs() < 1e-4, "{name}: {}", lens[name]);
    }
    has_fields(&calibration, &["elapsed_ms", "checks", "verdict"]);
}

/// Views of a flat grid, projected exactly.
fn pinhole_problem() -> Value {
    let tilts =
        [(0.5_f64, 0.0_f64), (-0.4, 0.3), (0.1, -0.6), (0.3, 0.5), (-0.5, -0.3), (0.0, 0.45)];
    let view = |(a, b): (f64, f64)| {
        let points = (0..54).map(|i| (f64::from(i % 9) * 0.03, f64::from(i / 9) * 0.03));
        let project = |(x, y): (f64, f64)| {
            // Rotated about x by a, then about y by b, and moved away.
            let (u, v, w) = (x - 0.12, (y - 0.075) * a.cos(), (y - 0.075) * a.sin());
            let (u, w) = (u * b.cos() + w * b.sin(), w * b.cos() - u * b.sin());
            [600.0 * u / (w + 0.6) + 320.0, 610.0 * v / (w + 0.6) + 240.0]
        };
        let image: Vec<[f64; 2]> = points.clone().map(project).collect();
        let object: Vec<[f64; 3]> = points.map(|(x, y)| [x, y, 0.0]).collect();
        json!({"name": format!("{a} {b}"), "object": object, "image": image})
    };
    json!({"image_size": [640, 480], "lens": "pinhole", "views": tilts.map(view)})
}

#[test]
fn a_camera_is_recorded_and_the_recording_is_one() {
    let (folder, served) = started();
    let answer = served.post_nothing("/v1/cameras/front/recordings");
    assert_eq!(answer.status, 201, "{}", answer.text());
    let recording = answer.json();
    let fields = [
        "id",
        "camera",
        "path",
        "state",
        "reason",
        "started_at",
        "finished_at",
        "frame_sets",
        "dropped",
        "bytes",
    ];
    has_fields(&recording, &fields);
    let path = format!("/v1/recordings/{}", recording["id"].as_str().unwrap());
    assert_eq!(answer.location.as_deref(), Some(path.as_str()));
    is_problem(&served.post("/v1/cameras/front/recordings", &json!({"max_seconds": 1})), 409);
    let mut events = served.events("?camera=front", None);
    (0..3).for_each(|_| drop(events.until(|event| event.name == "frame")));
    assert_eq!(served.get(&path).json()["state"], "recording");
    let finished = served.post_nothing(&format!("{path}/stop")).json();
    assert_eq!(finished["state"], "finished", "{finished}");
    assert!(finished["frame_sets"].as_u64().unwrap() >= 2, "{finished}");
    let file = folder
        .path()
        .join("store/recordings")
        .join(format!("{}.mcap", finished["id"].as_str().unwrap()));
    assert_eq!(file.metadata().unwrap().len(), finished["bytes"].as_u64().unwrap());
    assert_eq!(served.get("/v1/recordings").json()["recordings"][0], finished);
    is_problem(&served.post_nothing(&format!("{path}/stop")), 409);
    is_problem(&served.get("/v1/recordings/none"), 404);
    is_problem(&served.post("/v1/cameras/rear/recordings", &json!({})), 404);
    assert_eq!(
        is_problem(&served.post("/v1/cameras/front/recordings", &json!({"max_seconds": 0})), 422)["field"],
        "max_seconds"
    );
}

#[test]
fn openapi_describes_every_route_of_the_contract() {
    let (_folder, served) = started();
    let answer = served.get("/openapi.json");
    assert_eq!((answer.status, answer.media_type.as_str()), (200, "application/json"));
    let document = answer.json();
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
    let routes = [
        ("get", "/healthz"),
        ("get", "/readyz"),
        ("get", "/metrics"),
        ("get", "/v1/cameras"),
        ("get", "/v1/cameras/{camera}"),
        ("get", "/v1/cameras/{camera}/frame.jpg"),
        ("get", "/v1/cameras/{camera}/preview.mjpg"),
        ("post", "/v1/cameras/{camera}/sessions"),
        ("get", "/v1/sessions"),
        ("get", "/v1/sessions/{id}"),
        ("post", "/v1/sessions/{id}/stop"),
        ("delete", "/v1/sessions/{id}"),
        ("get", "/v1/sessions/{id}/views"),
        ("get", "/v1/sessions/{id}/views/{n}.jpg"),
        ("get", "/v1/cameras/{camera}/calibration"),
        ("get", "/v1/calibrations/{id}"),
        ("get", "/v1/cameras/{camera}/calibrations"),
        ("post", "/v1/calibrations/{id}/approve"),
        ("post", "/v1/solve"),
        ("get", "/v1/events"),
    ];
    for (method, path) in routes {
        assert!(document["paths"][path][method].is_object(), "{method} {path} is not described");
    }
    let pages = served.get("/docs/");
    assert!(pages.status == 200 && pages.media_type.starts_with("text/html"), "{}", pages.status);
    assert_eq!(served.get("/docs").location.as_deref(), Some("/docs/"));
}
