//! The store's upkeep: checked and copied while the daemon serves, damaged, repaired, pruned.

use std::path::Path;

use serde_json::{Value, json};

use crate::program::plumb;
use crate::served::{Served, replaying};

fn start_and_abort(served: &Served) -> String {
    let request =
        json!({"target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}});
    let started = served.post("/v1/cameras/front/sessions", &request);
    assert_eq!(started.status, 201, "{}", started.text());
    let id = started.json()["id"].as_str().unwrap().to_owned();
    let mut events = served.events("", Some("0"));
    events.until(|event| event.data["id"] == *id && event.data["views_kept"].as_u64() >= Some(2));
    assert_eq!(served.delete(&format!("/v1/sessions/{id}")).status, 200);
    id
}

fn listed(served: &Served, query: &str) -> (Vec<String>, Option<String>) {
    let answer = served.get(&format!("/v1/sessions{query}"));
    assert_eq!(answer.status, 200, "{}", answer.text());
    let ids = answer.json()["sessions"].as_array().unwrap().iter().map(id_of).collect();
    (ids, answer.link)
}

fn id_of(session: &Value) -> String {
    session["id"].as_str().unwrap().to_owned()
}

fn store_command(folder: &Path, task: &str, options: &[&str]) -> crate::program::Finished {
    let store = folder.join("store").display().to_string();
    plumb([&["store", task, "--store", &store], options].concat())
}

#[test]
fn sessions_come_in_pages_and_are_deleted_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let mut ids: Vec<String> = (0..3).map(|_| start_and_abort(&served)).collect();
    ids.reverse();
    assert_eq!(listed(&served, ""), (ids.clone(), None));
    let (first, link) = listed(&served, "?limit=2&camera=front");
    assert_eq!(first, ids[..2]);
    let next = format!("</v1/sessions?limit=2&cursor={}&camera=front>; rel=\"next\"", ids[1]);
    assert_eq!(link, Some(next));
    let rest = format!("?limit=2&camera=front&cursor={}", ids[1]);
    assert_eq!(listed(&served, &rest), (ids[2..].to_vec(), None));
    assert_eq!(served.get("/v1/sessions?limit=0").status, 422);
    assert_eq!(served.get("/v1/sessions?limit=1001").status, 422);
    assert_eq!(served.get("/v1/sessions?cursor=nobody").status, 404);
    let views = format!("/v1/sessions/{}/views", ids[0]);
    for list in ["/v1/recordings", "/v1/cameras/front/calibrations", &views] {
        assert_eq!(served.get(&format!("{list}?limit=1")).status, 200, "{list}");
        assert_eq!(served.get(&format!("{list}?limit=1001")).status, 422, "{list}");
        assert_eq!(served.get(&format!("{list}?cursor=nobody")).status, 404, "{list}");
    }

    assert_eq!(served.delete(&format!("/v1/sessions/{}", ids[2])).status, 409, "it is over");
    assert_eq!(served.delete(&format!("/v1/sessions/{}?purge=true", ids[2])).status, 200);
    assert_eq!(served.get(&format!("/v1/sessions/{}", ids[2])).status, 404);
    assert_eq!(listed(&served, "").0, ids[..2]);

    // The newest is the one that its camera still has.
    let newest = format!("/v1/sessions/{}", ids[0]);
    let purged = format!("{newest}?purge=true");
    assert_eq!(served.delete(&purged).status, 200);
    for path in [newest.clone(), format!("{newest}/views"), format!("{newest}/uncertainty.png")] {
        assert_eq!(served.get(&path).status, 404, "{path}");
    }
    for path in [&newest, &purged] {
        assert_eq!(served.delete(path).status, 404, "{path}");
    }
    assert_eq!(served.post_nothing(&format!("{newest}/stop")).status, 404);
    assert_eq!(listed(&served, "").0, [ids[1].clone()]);
    start_and_abort(&served);
}

#[test]
fn a_store_in_use_is_checked_and_copied_and_not_changed() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let id = start_and_abort(&served);
    let checked = store_command(folder.path(), "check", &["--json"]);
    assert_eq!(checked.code, Some(0), "{}", checked.stderr);
    let checked: Value = serde_json::from_str(&checked.stdout).unwrap();
    assert!(checked["readable_rows"].as_u64() >= Some(3), "{checked}");
    assert_eq!(checked["damage"], json!([]));
    for change in ["repair", "prune"] {
        let options: &[&str] = if change == "prune" { &["--keep-days", "1"] } else { &[] };
        let refused = store_command(folder.path(), change, options);
        assert_eq!(refused.code, Some(1), "{change}");
        assert!(refused.stderr.contains("in use by another plumb"), "{}", refused.stderr);
    }
    let copy = tempfile::tempdir().unwrap();
    std::fs::create_dir(copy.path().join("store")).unwrap();
    let file = copy.path().join("store/plumb.sqlite").display().to_string();
    let copied = store_command(folder.path(), "backup", &["--out", &file]);
    assert_eq!(copied.code, Some(0), "{}", copied.stderr);
    drop(served);
    let served = Served::start(copy.path(), &replaying("front", "walk.mcap"));
    assert_eq!(listed(&served, "").0, [id]);
}

#[test]
fn a_damaged_store_is_served_as_far_as_it_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let ids = [start_and_abort(&served), start_and_abort(&served)];
    drop(served);
    // Checkpoints the log into the file.
    assert_eq!(store_command(folder.path(), "repair", &[]).code, Some(0));
    let file = folder.path().join("store/plumb.sqlite");
    let mut bytes = std::fs::read(&file).unwrap();
    // Page 2 on: the kind of a page in the tree of the first table.
    bytes[4096] ^= 0xff;
    std::fs::write(&file, bytes).unwrap();

    let checked = store_command(folder.path(), "check", &[]);
    assert_eq!(checked.code, Some(1));
    assert!(checked.stderr.contains("`plumb store repair` rebuilds"));
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let (left, _) = listed(&served, "");
    assert!(left.iter().all(|id| ids.contains(id)), "{left:?}");
    assert!(folder.path().join("store/plumb.sqlite.damaged-1").is_file());
    assert_eq!(start_and_abort(&served).len(), ids[0].len(), "and sessions go on");
    drop(served);
    let repaired = store_command(folder.path(), "repair", &[]);
    let said = &repaired.stdout;
    assert!(said.starts_with("SQLite finds no damage, nothing was changed"), "{said}");
    let pruned = store_command(folder.path(), "prune", &["--keep-sessions", "0"]);
    assert!(pruned.stdout.contains(" deleted"), "{}{}", pruned.stdout, pruned.stderr);
    let empty = store_command(folder.path(), "check", &["--json"]);
    assert_eq!(serde_json::from_str::<Value>(&empty.stdout).unwrap()["readable_rows"], 0);
}

#[test]
fn without_a_store_or_a_limit_that_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let missing = store_command(folder.path(), "check", &[]);
    assert_eq!(missing.code, Some(1));
    assert!(missing.stderr.contains("there is no plumb.sqlite in it"), "{}", missing.stderr);
    let unlimited = store_command(folder.path(), "prune", &[]);
    assert_eq!(unlimited.code, Some(2));
    assert!(unlimited.stderr.contains("give --keep-days"), "{}", unlimited.stderr);
}

#[test]
fn old_recordings_are_pruned_with_their_notes() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let record = || {
        let recording = served.post_nothing("/v1/cameras/front/recordings").json();
        let id = recording["id"].as_str().unwrap().to_owned();
        let mut events = served.events("?camera=front", None);
        (0..3).for_each(|_| drop(events.until(|event| event.name == "frame")));
        assert_eq!(served.post_nothing(&format!("/v1/recordings/{id}/stop")).status, 200);
        id
    };
    let ids = [record(), record()];
    drop(served);
    let lying = || {
        let mut files: Vec<String> = std::fs::read_dir(folder.path().join("store/recordings"))
            .unwrap()
            .map(|file| file.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        files
    };
    let kept = [format!("{}.json", ids[1]), format!("{}.mcap", ids[1])];
    assert_eq!(lying().len(), 4);
    let listed = store_command(folder.path(), "prune", &["--keep-recordings", "1", "--dry-run"]);
    assert!(listed.stdout.contains("1 recordings of ") && listed.stdout.contains(&ids[0]));
    assert_eq!(lying().len(), 4);
    let pruned = store_command(folder.path(), "prune", &["--keep-recordings", "1"]);
    assert_eq!(pruned.code, Some(0), "{}", pruned.stderr);
    assert_eq!(lying(), kept);
}
