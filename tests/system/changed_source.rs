//! A camera whose source in the configuration changes while a session collects: the session ends
//! with what it gathered, whether by SIGHUP or over a restart.

use std::path::Path;

use serde_json::{Value, json};

use crate::served::{Served, recording};

fn config(name: &str, pace: &str) -> String {
    let path = recording(name).display().to_string();
    format!(
        "[[camera]]\nname = \"front\"\nsource = {{ kind = \"recording\", path = {path:?}, pace = {pace:?} }}\n"
    )
}

fn started(served: &Served) -> String {
    let target = json!({"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025});
    let started = served.post("/v1/cameras/front/sessions", &json!({"target": target}));
    assert_eq!(started.status, 201, "{}", started.text());
    started.json()["id"].as_str().unwrap().to_owned()
}

/// The announcement of session `id` for which `wanted` holds, of all that were announced.
fn until(served: &Served, id: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let is_it = |name: &str, data: &Value| name == "session" && data["id"] == *id && wanted(data);
    served.events("", Some("0")).until(|event| is_it(&event.name, &event.data)).data
}

fn has_kept(session: &Value) -> bool {
    session["views_kept"].as_u64() >= Some(3)
}

fn assert_given_up(served: &Served, session: &Value) {
    assert_eq!(session["state"], "aborted", "{session}");
    let reason = session["reason"].as_str().unwrap();
    let words =
        ["source of camera `front`", "walk.mcap to recording", "hard.mcap", "start a new session"];
    assert!(words.iter().all(|word| reason.contains(word)), "{reason}");
    assert!(!reason.contains('\n') && has_kept(session), "{session}");
    let path = format!("/v1/sessions/{}", session["id"].as_str().unwrap());
    assert_eq!(served.get(&path).json(), *session);
    let views = served.get(&format!("{path}/views")).json()["views"].as_array().unwrap().len();
    assert_eq!(session["views_kept"], json!(views));
    assert_eq!(served.get(&format!("{path}/views/0.jpg")).status, 200);
}

fn rewrite(folder: &Path, change: impl Fn(String) -> String) {
    let file = folder.join("plumb.toml");
    std::fs::write(&file, change(std::fs::read_to_string(&file).unwrap())).unwrap();
}

#[cfg(unix)]
#[test]
fn a_hangup_that_changes_the_source_ends_the_session_with_its_views() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &config("walk.mcap", "recorded"));
    let id = started(&served);
    until(&served, &id, has_kept);
    // What does not change the lens does not end it.
    rewrite(folder.path(), |text| text.replace("\"recorded\"", "\"fastest\""));
    served.signal("HUP");
    let replayed = |session: &Value| {
        session["reason"].as_str().is_some_and(|reason| reason.contains("has ended"))
    };
    assert_eq!(until(&served, &id, replayed)["state"], "collecting");

    rewrite(folder.path(), |text| text.replace("walk.mcap", "hard.mcap"));
    served.signal("HUP");
    let session = until(&served, &id, |session| session["state"] != "collecting");
    assert_given_up(&served, &session);
    let next = started(&served);
    let session = served.get(&format!("/v1/sessions/{next}")).json();
    assert!(session["sources"]["front"].as_str().unwrap().ends_with("hard.mcap"), "{session}");
}

#[test]
fn a_restart_with_another_source_ends_the_session_with_its_views() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &config("walk.mcap", "recorded"));
    let id = started(&served);
    until(&served, &id, has_kept);
    served.kill();
    let served = Served::start(folder.path(), &config("hard.mcap", "recorded"));
    let session = until(&served, &id, |session| session["state"] != "collecting");
    assert_given_up(&served, &session);
}
