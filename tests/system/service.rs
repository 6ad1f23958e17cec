//! The daemon as systemd runs it: readiness, signs of life, the end; and the unit that says so.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::Duration;

use crate::served::{Served, replaying};

/// A test that hangs has failed.
const PATIENCE: Duration = Duration::from_secs(30);

fn packaged(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging").join(name))
        .unwrap()
}

/// Reads what the service manager receives until a message has a line that begins with `wanted`;
/// that line.
fn notified(socket: &UnixDatagram, wanted: &str) -> String {
    let mut buffer = [0; 4096];
    loop {
        let length = socket.recv(&mut buffer).unwrap();
        let message = String::from_utf8_lossy(&buffer[..length]).into_owned();
        if let Some(line) = message.lines().find(|line| line.starts_with(wanted)) {
            return line.to_owned();
        }
    }
}

#[test]
fn the_service_manager_is_notified_of_the_start_of_life_and_of_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let environment = [("NOTIFY_SOCKET", path.to_str().unwrap()), ("WATCHDOG_USEC", "400000")];
    let mut served =
        Served::start_in(folder.path(), &replaying("front", "walk.mcap"), &environment);
    notified(&socket, "READY=1");
    assert_eq!(served.get("/healthz").status, 200, "ready means that it answers");
    (0..3).for_each(|_| drop(notified(&socket, "WATCHDOG=1")));
    while notified(&socket, "STATUS=") != "STATUS=1 of 1 cameras streaming" {}
    served.signal("TERM");
    notified(&socket, "STOPPING=1");
    assert!(served.ended().success());
}

/// The unit names what the package installs, and asks for what the daemon reports.
#[test]
fn the_unit_runs_the_daemon_that_is_packaged() {
    let unit = packaged("plumb.service");
    let line = |key: &str| unit.lines().find_map(|line| line.strip_prefix(key)).unwrap();
    assert_eq!(line("Type="), "notify");
    assert!(line("WatchdogSec=").parse::<u32>().unwrap() > 0);
    let start: Vec<&str> = line("ExecStart=").split(' ').collect();
    assert_eq!(start, ["/usr/bin/plumb", "serve", "--config", "/etc/plumb/plumb.toml"]);
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store").display().to_string();
    let config = packaged("plumb.toml").replace("/var/lib/plumb", &store);
    assert!(config.contains(&store), "the store is where the unit may write");
    let file = folder.path().join("packaged.toml");
    std::fs::write(&file, &config).unwrap();
    let served = Served::run(&file, &[]);
    assert_eq!(served.get("/healthz").status, 200);
}
