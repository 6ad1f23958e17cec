//! The daemon beside a camera that goes wrong: which state it reports, with which reason, and that
//! a session goes on.

use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::daemon::Daemon;
use crate::guest::{VIVID, plug_in, press, unplug};

const CAMERAS: &str = r#"
[[camera]]
name = "vivid"
source = { kind = "v4l2", device = "/dev/video0", width = 320, height = 180, format = "GREY", fps = 5 }
"#;

/// What is done to the camera, what is reported of it, and what ends it.
struct Fault {
    name: &'static str,
    begin: fn(),
    reported: &'static str,
    end: fn(),
}

const FATAL: &str = "inject_fatal_streaming_error=1";
const REFUSED: &str = "the driver answers: ";

const FAULTS: [Fault; 7] = [
    Fault { name: "fatal error", begin: || press(VIVID, FATAL), reported: REFUSED, end: || {} },
    Fault {
        name: "disconnect",
        begin: || press(VIVID, "disconnect=1"),
        reported: "it was unplugged",
        end: || {},
    },
    Fault {
        name: "reqbufs",
        begin: || refuse_next_start("reqbufs"),
        reported: "Invalid argument",
        end: || {},
    },
    Fault {
        name: "qbuf",
        begin: || refuse_next_start("qbuf"),
        reported: "Invalid argument",
        end: || {},
    },
    Fault {
        name: "streamon",
        begin: || refuse_next_start("streamon"),
        reported: "Invalid argument",
        end: || {},
    },
    Fault {
        name: "silence",
        begin: || drop_frames(100),
        reported: "no frame for ",
        end: || drop_frames(0),
    },
    Fault { name: "unbind", begin: unplug, reported: "it is not plugged in", end: plug_in },
];

fn refuse_next_start(step: &str) {
    press(VIVID, &format!("inject_vidioc_{step}_error=1"));
    press(VIVID, FATAL);
}

fn drop_frames(percent: u32) {
    press(VIVID, &format!("percentage_of_dropped_buffers={percent}"));
}

pub fn every_fault_is_a_state_with_a_reason_and_the_session_goes_on() -> String {
    let mut holder = Command::new("v4l2-ctl");
    holder.args(["-d", VIVID, "--stream-mmap", "--stream-count=100000"]);
    let mut holder = holder.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !is_open(holder.id(), VIVID) {
        std::thread::yield_now();
    }
    let daemon = Daemon::start(CAMERAS);
    let mut events = daemon.camera_events("vivid");
    let mut reported =
        vec![events.until("lost", &format!("in use by v4l2-ctl (process {})", holder.id()))];
    holder.kill().unwrap();
    holder.wait().unwrap();
    events.until("streaming", "");
    let target = json!({"target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}, "lens": "brown"});
    let session =
        daemon.post("/v1/cameras/vivid/sessions", &target)["id"].as_str().unwrap().to_owned();
    let session = || daemon.get(&format!("/v1/sessions/{session}"));
    let mut sessions = daemon.camera_events("vivid");

    let mut before = None;
    for fault in &FAULTS {
        let seen = frames(&session());
        (fault.begin)();
        reported.push(format!("{}: {}", fault.name, events.until("lost", fault.reported)));
        // As an event: asked for now and then, a short wait may be over before it is seen.
        let waiting = sessions.until_session(true);
        assert!(
            waiting["state"] == "collecting" && frames(&waiting) >= seen,
            "{}: {waiting}",
            fault.name
        );
        if fault.name == "unbind" {
            reported.push(costs_nothing(&daemon));
        }
        (fault.end)();
        events.until("streaming", "");
        sessions.until_session(false);
        daemon.wait_for("frames after the fault", || (frames(&session()) > seen).then_some(()));
        // The first fault fills what is kept for ever.
        let footprint = daemon.footprint();
        assert_eq!(
            *before.get_or_insert(footprint),
            footprint,
            "{}: descriptors and threads",
            fault.name
        );
    }
    let (descriptors, threads) = before.unwrap();
    format!("{}; {descriptors} descriptors and {threads} threads after each", reported.join("; "))
}

/// While it searches for the camera it does next to nothing.
fn costs_nothing(daemon: &Daemon) -> String {
    let (began, busy) = (Instant::now(), daemon.processor_time());
    // What is measured is a span of time: any request would add to it.
    std::thread::sleep(Duration::from_secs(2));
    let (elapsed, busy) = (began.elapsed(), daemon.processor_time() - busy);
    assert!(busy < elapsed / 2, "{busy:?} of {elapsed:?}");
    format!("{} ms of {} ms computing meanwhile", busy.as_millis(), elapsed.as_millis())
}

fn frames(session: &Value) -> u64 {
    session["frames_seen"].as_u64().unwrap()
}

fn is_open(process: u32, path: &str) -> bool {
    let open = fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten().flatten();
    open.filter_map(|entry| fs::read_link(entry.path()).ok())
        .any(|target| target.to_str() == Some(path))
}
