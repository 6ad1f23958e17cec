//! A rig whose cameras are not as they should be, through the daemon: one gives a third of the
//! others' frames, one stalls, and is gone in the end. The session goes on with what the others
//! give, nothing piles up, every frame is accounted for, and a stop still gives a calibration.
//!
//! Each frame is a named pipe in the camera's folder: the daemon waits for it as for a device,
//! until the test gives it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use plumb::recording::{ReadOptions, Recording};
use serde_json::{Value, json};

use crate::served::{Served, recording};

/// How often each image is shown by the cameras at full rate: held still, as by hand.
const SHOWN: usize = 3;
/// The images that all cameras show.
const IMAGES: usize = 30;
/// Those that are shown while one camera stalls.
const WHILE_STALLED: usize = 20;
/// Frames of each camera that no session asked for: one before it begins, and one that was asked
/// for before.
const NOBODYS: u64 = 2;
/// What is given or waited for takes less time than this, or never comes.
const LIMIT: Duration = Duration::from_secs(60);
/// Frames that may wait for the stalled camera's, as `lib.rs` has it: 16, and the one that is
/// taken.
const MAY_WAIT: u64 = 17;
/// 60 frames of 640×480 that were kept with their pixels would be 18 MB; the running estimates' own
/// memory comes and goes.
const FLAT_KB: u64 = 14_000;

/// A camera whose frames the test gives, one by one.
struct FedCamera {
    name: &'static str,
    folder: PathBuf,
    images: Vec<Vec<u8>>,
    given: usize,
}

impl FedCamera {
    fn new(parent: &Path, name: &'static str, frames: usize) -> Self {
        let folder = parent.join(name);
        std::fs::create_dir(&folder).unwrap();
        let made = Command::new("mkfifo")
            .args((0..frames).map(|frame| pipe(&folder, frame)))
            .status()
            .unwrap();
        assert!(made.success());
        let path = recording(&format!("rig-{name}.mcap"));
        let mut recording = Recording::open(&path, &ReadOptions::default()).unwrap();
        let next = || recording.next_frame_set().unwrap();
        let images = std::iter::from_fn(next).map(|set| set.frames[0].bytes.to_vec()).collect();
        Self { name, folder, images, given: 0 }
    }

    fn table(&self, fps: usize) -> String {
        let (name, path) = (self.name, &self.folder);
        format!(
            "[[camera]]\nname = {name:?}\nsource = {{ kind = \"recording\", path = {path:?}, pace = \"recorded\", fps = {fps} }}\n"
        )
    }

    /// Gives this image as the next frame, and waits until it was searched, or dropped for a newer
    /// one and counted.
    fn give(&mut self, served: &Served, image: usize) {
        self.hand_over(image);
        until(self.name, || {
            self.received(served) == self.given as u64
                && self.searched(served) + self.dropped(served) + NOBODYS >= self.given as u64
        });
    }

    fn received(&self, served: &Served) -> u64 {
        count(served, &format!("plumb_frames_total{{camera={:?}}}", self.name))
    }

    fn searched(&self, served: &Served) -> u64 {
        count(served, &format!("plumb_frames_searched_total{{camera={:?}}}", self.name))
    }

    fn dropped(&self, served: &Served) -> u64 {
        let name = self.name;
        count(served, &format!("plumb_frames_dropped_total{{camera={name:?},why=\"overload\"}}"))
    }

    /// The daemon has the bytes when this returns.
    fn hand_over(&mut self, image: usize) {
        let (pipe, bytes) = (pipe(&self.folder, self.given), self.images[image].clone());
        let (taken, is_taken) = mpsc::channel();
        std::thread::spawn(move || taken.send(std::fs::write(pipe, bytes)));
        let name = self.name;
        let taken = is_taken.recv_timeout(LIMIT);
        taken.unwrap_or_else(|_| panic!("nobody reads a frame of {name}")).unwrap();
        self.given += 1;
    }
}

fn pipe(folder: &Path, frame: usize) -> PathBuf {
    folder.join(format!("{frame:03}.jpg"))
}

/// Asks until it holds.
fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < LIMIT, "in vain: {what}");
    }
}

fn count(served: &Served, metric: &str) -> u64 {
    let text = served.get("/metrics").text();
    let line = text.lines().find_map(|line| line.strip_prefix(metric)?.strip_prefix(' '));
    line.map_or(0, |value| value.parse().unwrap())
}

fn frame_sets(served: &Served, complete: bool) -> u64 {
    count(served, &format!("plumb_rig_frame_sets_total{{complete=\"{complete}\",rig=\"head\"}}"))
}

/// Shows the images from `first` to `end`: each [`SHOWN`] times to the cameras at full rate, and
/// whenever its time comes to the one at a third of it.
fn show(
    served: &Served,
    first: usize,
    end: usize,
    full_rate: &mut [&mut FedCamera],
    third: &mut FedCamera,
) {
    for image in (first..end).map(|image| image % IMAGES) {
        for _ in 0..SHOWN {
            full_rate.iter_mut().for_each(|camera| camera.give(served, image));
            // Taken at the same time.
            if SHOWN * third.given + 1 == full_rate[0].given {
                third.give(served, image);
            }
        }
    }
}

#[test]
fn a_rig_does_without_the_camera_that_is_slow_stalled_or_gone() {
    let folder = tempfile::tempdir().unwrap();
    let nobodys = NOBODYS as usize;
    let frames = nobodys + SHOWN * (IMAGES + WHILE_STALLED + 1);
    let mut left = FedCamera::new(folder.path(), "left", frames);
    let mut right = FedCamera::new(folder.path(), "right", nobodys + frames / SHOWN);
    let mut far = FedCamera::new(folder.path(), "far", nobodys + SHOWN * IMAGES + 3);
    let tables = [left.table(30), right.table(10), far.table(30)].concat();
    let rig = "[[rig]]\nname = \"head\"\ncameras = [\"left\", \"right\", \"far\"]\n";
    let served = Served::start(folder.path(), &(tables + rig));

    // The first frame of each is taken before the session begins.
    [&mut left, &mut right, &mut far].into_iter().for_each(|camera| camera.hand_over(0));
    until("first frames", || {
        [&left, &right, &far].into_iter().all(|camera| camera.received(&served) == 1)
    });
    let target = json!({"kind": "chessboard", "cols": 8, "rows": 6, "square_m": 0.03});
    let started =
        served.post("/v1/rigs/head/sessions", &json!({"target": target, "lens": "brown"}));
    assert_eq!(started.status, 201, "{}", started.text());
    let path = format!("/v1/sessions/{}", started.json()["id"].as_str().unwrap());
    let session = || served.get(&path).json();
    let frames_seen = |camera: usize| session()["cameras"][camera]["frames_seen"].as_u64().unwrap();

    [&mut left, &mut right, &mut far].into_iter().for_each(|camera| camera.hand_over(0));

    // A third of the rate: what comes alone goes on alone.
    show(&served, 0, IMAGES, &mut [&mut left, &mut far], &mut right);
    let whole = frame_sets(&served, true);
    let lost: u64 = [&left, &right, &far].into_iter().map(|camera| camera.dropped(&served)).sum();
    assert!(whole + lost + 2 >= IMAGES as u64, "{whole} whole, {lost} dropped");
    assert!(frame_sets(&served, false) + lost + 4 >= 2 * IMAGES as u64);

    // Stalled: nothing waits for it but a few frames, and those are let go one by one.
    let (before_kb, alone) = (served.resident_kb(), frame_sets(&served, false));
    show(&served, IMAGES, IMAGES + WHILE_STALLED, &mut [&mut left], &mut right);
    let more = frame_sets(&served, false) - alone;
    assert!(more + lost + MAY_WAIT + 4 >= (SHOWN * WHILE_STALLED) as u64, "{more} without `far`");
    // One was still waited for before.
    assert!(frame_sets(&served, true) <= whole + 1);
    let grown_kb = served.resident_kb().saturating_sub(before_kb);
    assert!(grown_kb < FLAT_KB, "{grown_kb} kB more while a camera stalled");

    // Gone: it is not waited for at all, and the session says so.
    std::fs::remove_file(pipe(&far.folder, far.given + 1)).unwrap();
    std::fs::remove_file(pipe(&far.folder, far.given + 2)).unwrap();
    far.hand_over(0);
    let waits = |session: &Value| {
        session["reason"]
            .as_str()
            .is_some_and(|reason| reason.starts_with("waiting for camera `far`"))
    };
    until("the session says that a camera is gone", || waits(&session()));
    let seen = frames_seen(0);
    show(&served, 0, 1, &mut [&mut left], &mut right);
    until("frames of the others", || frames_seen(0) > seen);

    // Every frame is searched or counted as dropped.
    for camera in [&left, &right, &far] {
        let (given, name) = (camera.given as u64, camera.name);
        let (searched, dropped) = (camera.searched(&served), camera.dropped(&served));
        assert_eq!(camera.received(&served), given);
        assert!((given - NOBODYS..=given).contains(&(searched + dropped)), "{name}");
    }

    let stopped = served.post_nothing(&format!("{path}/stop")).json();
    assert_eq!(stopped["state"], "finished", "{stopped}");
    let calibration = stopped["calibration"].as_str().unwrap();
    let calibration = served.get(&format!("/v1/calibrations/{calibration}")).json();
    let extrinsics = calibration["extrinsics"].as_array().unwrap();
    let names: Vec<&str> = extrinsics.iter().map(|pose| pose["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["left_from_right", "left_from_far"], "{}", calibration["verdict"]);
}
