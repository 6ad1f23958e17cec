//! A disk that is full in the middle of a session: a real file system of a few megabytes. What was
//! announced survives a power cut, the daemon says what is wrong, and goes on by itself when there
//! is room again.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use crate::served::{Served, recording};

/// A file system of this size in memory, unmounted when it is dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mounted(folder: &Path, megabytes: u32) -> Self {
        std::fs::create_dir(folder).unwrap();
        let size = format!("size={megabytes}m");
        let mounted =
            Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder).output();
        let mounted = mounted.unwrap();
        let said = String::from_utf8_lossy(&mounted.stderr).into_owned();
        assert!(mounted.status.success(), "a small disk needs root to mount it: {said}");
        Self(folder.to_owned())
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

fn configuration(least_free_mb: u32) -> String {
    let path = recording("walk.mcap").display().to_string();
    format!(
        "min_free_mb = {least_free_mb}\n[[camera]]\nname = \"front\"\nsource = {{ kind = \"recording\", path = {path:?}, pace = \"fastest\" }}\n"
    )
}

fn views(served: &Served, id: &str) -> usize {
    let views = served.get(&format!("/v1/sessions/{id}/views")).json();
    views["views"].as_array().unwrap().len()
}

fn free_kb(disk: &Path) -> u64 {
    let out = Command::new("df").args(["--output=avail", "-k"]).arg(disk).output().unwrap();
    String::from_utf8_lossy(&out.stdout).lines().nth(1).unwrap().trim().parse().unwrap()
}

/// Fills the disk but for so much.
fn fill(disk: &Path, leave_kb: u64) -> PathBuf {
    let file = disk.join("filler");
    let filled_kb = free_kb(disk).saturating_sub(leave_kb);
    std::fs::write(&file, vec![0; 1024 * filled_kb as usize]).unwrap();
    file
}

fn is_paused(session: &Value) -> bool {
    session["reason"].as_str().is_some_and(|reason| reason.starts_with("paused: "))
}

/// A floor of 0 lets the disk itself refuse; one of 1 MB refuses before.
#[test]
fn nothing_that_was_announced_is_lost_on_a_full_disk() {
    for (least_free_mb, leave_kb) in [(0, 300), (1, 1300)] {
        let folder = tempfile::tempdir().unwrap();
        let disk = SmallDisk::mounted(&folder.path().join("store"), 8);
        let served = Served::start(folder.path(), &configuration(least_free_mb));
        let filler = fill(&disk.0, leave_kb);
        let mut events = served.events("?camera=front", Some("0"));
        let target = json!({"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025});
        let started = served.post("/v1/cameras/front/sessions", &json!({"target": target}));
        assert_eq!(started.status, 201, "{}", started.text());
        let id = started.json()["id"].as_str().unwrap().to_owned();
        let paused = events.until(|event| event.name == "session" && is_paused(&event.data)).data;
        assert_eq!(paused["state"], "collecting", "{paused}");
        let announced = paused["views_kept"].as_u64().unwrap() as usize;
        assert!(announced > 0, "{paused}");
        assert_eq!(views(&served, &id), announced);
        let ready = served.get("/readyz");
        assert_eq!(ready.status, 503, "{}", ready.text());
        assert!(ready.text().contains("front is paused: store "), "{}", ready.text());
        assert!(served.get("/metrics").text().contains("\nplumb_sessions_paused 1\n"));
        assert_eq!(served.post_nothing(&format!("/v1/sessions/{id}/stop")).status, 503);

        served.kill();
        let served = Served::start(folder.path(), &configuration(least_free_mb));
        assert_eq!(views(&served, &id), announced, "after a power cut");
        let mut events = served.events("?camera=front", Some("0"));
        events.until(|event| event.name == "session" && is_paused(&event.data));
        std::fs::remove_file(filler).unwrap();
        events.until(|event| {
            let reason = event.data["reason"].as_str().unwrap_or_default();
            event.name == "session" && reason.contains("has ended")
        });
        assert!(served.get("/metrics").text().contains("\nplumb_sessions_paused 0\n"));
        let session = served.post_nothing(&format!("/v1/sessions/{id}/stop")).json();
        assert_eq!(session["state"], "finished", "{session}");
        assert_eq!(views(&served, &id) as u64, session["views_kept"].as_u64().unwrap());
    }
}

/// What is to stay free is there for the end of what runs.
#[test]
fn a_recording_ends_before_the_disk_is_full() {
    let folder = tempfile::tempdir().unwrap();
    let disk = SmallDisk::mounted(&folder.path().join("store"), 12);
    let camera = "min_free_mb = 4\n[[camera]]\nname = \"front\"\nsource = { kind = \"simulator\", pace = \"fastest\" }\n";
    let served = Served::start(folder.path(), camera);
    let started = served.post("/v1/cameras/front/recordings", &json!({}));
    assert_eq!(started.status, 201, "{}", started.text());
    let path = format!("/v1/recordings/{}", started.json()["id"].as_str().unwrap());
    let ended = (0..200_000)
        .map(|_| served.get(&path).json())
        .find(|recording| recording["state"] != "recording")
        .unwrap();
    assert_eq!(ended["state"], "finished", "{ended}");
    assert!(ended["reason"].as_str().unwrap().contains("4 MB must stay free"), "{ended}");
    assert!(free_kb(&disk.0) >= 3900, "{} kB", free_kb(&disk.0));
    let refused = served.post("/v1/cameras/front/recordings", &json!({}));
    assert_eq!(refused.status, 503, "{}", refused.text());
}
