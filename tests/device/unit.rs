//! The package's systemd unit with cameras: confined as it says, it still reads them, loses and
//! finds them again, and keeps what it gathers.

use std::fs;
use std::process::Command;

use serde_json::{Value, json};

use crate::daemon::Daemon;
use crate::guest::{PLUMB, node_of};
use crate::usb::{self, SERIAL, listed};

const VIDEO_GROUP: &str = "video";

/// What udev's own rules do, which is not there.
fn give_to_the_video_group(node: &str) {
    for arguments in [["chgrp", VIDEO_GROUP, node], ["chmod", "660", node]] {
        assert!(Command::new(arguments[0]).args(&arguments[1..]).status().unwrap().success());
    }
}

fn plug_in() -> crate::usb_camera::UsbCamera {
    let plugged = usb::plug_in();
    give_to_the_video_group(listed().paths.last().unwrap());
    plugged
}

pub fn the_confined_service_reads_cameras_and_keeps_views() -> String {
    fs::copy(PLUMB, "/usr/bin/plumb").unwrap();
    let vivid = node_of("vivid-000-vid-cap");
    give_to_the_video_group(vivid.to_str().unwrap());
    let plugged = plug_in();
    let daemon = Daemon::start_unit(&format!(
        r#"
[[camera]]
name = "vivid"
source = {{ kind = "v4l2", device = "{}", width = 320, height = 180, format = "GREY", fps = 5 }}
[[camera]]
name = "usb"
source = {{ kind = "v4l2", device = "{SERIAL}", format = "MJPG", lock = true }}
"#,
        vivid.display()
    ));
    for camera in ["vivid", "usb"] {
        daemon.wait_for_state(camera, "streaming");
    }
    let confined = confinement(daemon.id());

    let target = json!({"target": {"kind": "chessboard", "cols": 9, "rows": 6, "square_m": 0.025}});
    let started = daemon.post("/v1/cameras/usb/sessions", &target);
    let path = format!("/v1/sessions/{}", started["id"].as_str().unwrap());
    let views = |session: &Value| session["views_kept"].as_u64().unwrap();
    let kept = |more: u64| {
        daemon.wait_for("views are kept", || {
            Some(daemon.get(&path)).filter(|session| views(session) > more)
        })
    };
    let before = views(&kept(1));
    drop(plugged);
    let lost = daemon.wait_for_state("usb", "lost");
    let again = plug_in();
    daemon.wait_for_state("usb", "streaming");
    let after = views(&kept(before));
    drop((daemon, again));
    format!("{confined}; {after} views kept; {}", lost["reason"].as_str().unwrap())
}

/// What the kernel says of the process: no user of note, no capability, no new privileges, and a
/// filter on its system calls.
fn confinement(process: u32) -> String {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(":\t"));
        line.unwrap().split_whitespace().next().unwrap().to_owned()
    };
    assert_ne!(field("Uid"), "0");
    assert_eq!(
        (field("CapEff").as_str(), field("CapBnd").as_str()),
        ("0000000000000000", "0000000000000000")
    );
    assert_eq!((field("NoNewPrivs").as_str(), field("Seccomp").as_str()), ("1", "2"));
    format!("user {}, no capabilities, system calls filtered", field("Uid"))
}
