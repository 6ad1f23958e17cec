//! `plumb serve` in the small machine, spoken to over HTTP.

use std::fs;
use std::io::{BufRead, BufReader, Lines, Read};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::guest::{PLUMB, processor_time};

const ADDRESS: &str = "127.0.0.1:8600";
/// Longer than anything asked for here takes, in software emulation too.
const LIMIT: Duration = Duration::from_secs(480);

/// Where the unit of the package runs it.
const UNIT: &str = "plumb.service";
const UNIT_CONFIG: &str = "/etc/plumb/plumb.toml";

/// A running daemon; it ends with this value.
pub struct Daemon(Runs);

enum Runs {
    /// As a child of this process.
    Child(Child),
    /// Under systemd, by the package's unit; its process.
    Unit(u32),
}

impl Daemon {
    /// Starts it with these `[[camera]]` tables.
    pub fn start(cameras: &str) -> Self {
        let folder = format!("/run/plumb-{}", std::process::id());
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        let config = format!("{folder}/plumb.toml");
        let text = format!(
            "[server]\nlisten = \"{ADDRESS}\"\n[store]\npath = \"{folder}/store\"\nmin_free_mb = 1\n{cameras}"
        );
        fs::write(&config, text).unwrap();
        let notify = format!("{folder}/notify");
        let socket = UnixDatagram::bind(&notify).unwrap();
        socket.set_read_timeout(Some(LIMIT)).unwrap();
        let child = Command::new(PLUMB)
            .args(["serve", "--config", &config])
            .env("RUST_LOG", "warn")
            .env("NOTIFY_SOCKET", &notify)
            .spawn()
            .unwrap();
        let daemon = Self(Runs::Child(child));
        let mut message = [0; 4096];
        loop {
            let length = socket.recv(&mut message).expect("the daemon says when it is ready");
            if message[..length].starts_with(b"READY=1") {
                return daemon;
            }
        }
    }

    /// Has systemd start the package's unit, with these `[[camera]]` tables.
    pub fn start_unit(cameras: &str) -> Self {
        fs::create_dir_all("/etc/plumb").unwrap();
        let written = format!(
            "[server]\nlisten = \"{ADDRESS}\"\n[store]\npath = \"/var/lib/plumb\"\n{cameras}"
        );
        fs::write(UNIT_CONFIG, written).unwrap();
        let started = Command::new("systemctl").args(["start", UNIT]).status().unwrap();
        assert!(started.success(), "systemctl start {UNIT}");
        let asked = ["show", "--property", "MainPID", "--value", UNIT];
        let process = Command::new("systemctl").args(asked).output().unwrap();
        Self(Runs::Unit(String::from_utf8(process.stdout).unwrap().trim().parse().unwrap()))
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        match &self.0 {
            Runs::Child(child) => child.id(),
            Runs::Unit(process) => *process,
        }
    }

    pub fn get(&self, path: &str) -> Value {
        ureq::get(&url(path))
            .call()
            .unwrap_or_else(|error| panic!("GET {path}: {error}"))
            .body_mut()
            .read_json()
            .unwrap()
    }

    pub fn post(&self, path: &str, body: &Value) -> Value {
        let answer = ureq::post(&url(path)).send_json(body);
        answer
            .unwrap_or_else(|error| panic!("POST {path}: {error}"))
            .body_mut()
            .read_json()
            .unwrap()
    }

    pub fn camera(&self, name: &str) -> Value {
        self.get(&format!("/v1/cameras/{name}"))
    }

    /// Evaluates `what` each time that something happens, until it gives a value.
    pub fn wait_for<T>(&self, what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
        let events = ureq::get(&url("/v1/events")).call().unwrap().into_body().into_reader();
        let began = Instant::now();
        let mut last_asked = None;
        for line in BufReader::new(events).lines() {
            let line = line.unwrap();
            let due =
                last_asked.is_none_or(|last: Instant| last.elapsed() > Duration::from_millis(200));
            if !due || line.is_empty() {
                continue;
            }
            last_asked = Some(Instant::now());
            if let Some(value) = condition() {
                return value;
            }
            assert!(began.elapsed() < LIMIT, "in vain: {what}");
        }
        panic!("the events ended while waiting: {what}");
    }

    /// What is reported of the camera from the daemon's start on.
    pub fn camera_events(&self, camera: &str) -> CameraEvents {
        let request =
            ureq::get(&url(&format!("/v1/events?camera={camera}"))).header("Last-Event-ID", "0");
        let body: Box<dyn Read> = Box::new(request.call().unwrap().into_body().into_reader());
        CameraEvents(BufReader::new(body).lines())
    }

    /// Open files and threads, besides those of connections and requests, which come and go.
    pub fn footprint(&self) -> (usize, usize) {
        let entries =
            |folder: &str| fs::read_dir(format!("/proc/{}/{folder}", self.id())).unwrap().flatten();
        let is_file = |link: &PathBuf| !link.to_string_lossy().starts_with("socket:");
        let files =
            entries("fd").filter_map(|entry| fs::read_link(entry.path()).ok()).filter(is_file);
        let names =
            entries("task").filter_map(|entry| fs::read_to_string(entry.path().join("comm")).ok());
        (files.count(), names.filter(|name| name.trim() != "http").count())
    }

    /// Its resident memory, in kilobytes.
    pub fn resident_kb(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.id())).unwrap();
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        resident.trim().trim_end_matches(" kB").parse().unwrap()
    }

    /// A metric by its name and labels; 0 if it was never counted.
    pub fn metric(&self, name: &str) -> u64 {
        let mut answer = ureq::get(&url("/metrics")).call().unwrap();
        let text = answer.body_mut().read_to_string().unwrap();
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.map_or(0, |value| value.parse().unwrap())
    }

    /// What it has computed so far.
    pub fn processor_time(&self) -> Duration {
        processor_time(&self.id().to_string())
    }

    pub fn wait_for_state(&self, camera: &str, state: &str) -> Value {
        self.wait_for(&format!("{camera} is {state}"), || {
            Some(self.camera(camera)).filter(|now| now["state"] == state)
        })
    }
}

/// What is reported of a camera and its sessions, in order.
pub struct CameraEvents(Lines<BufReader<Box<dyn Read>>>);

impl CameraEvents {
    /// Waits until the camera is said to be in this state for a reason with these words in it; the
    /// reason.
    pub fn until(&mut self, state: &str, words: &str) -> String {
        let reason = |camera: &Value| camera["reason"].as_str().unwrap_or_default().to_owned();
        let camera = self.find("camera", &format!("{state} for {words}"), |camera| {
            camera["state"] == state && reason(camera).contains(words)
        });
        reason(&camera)
    }

    /// Waits until a session is said to wait for its camera, or to go on; the session.
    pub fn until_session(&mut self, waits: bool) -> Value {
        self.find("session", if waits { "waits" } else { "goes on" }, |session| {
            let reason = session["reason"].as_str();
            reason.is_some_and(|reason| reason.starts_with("waiting for the camera: ")) == waits
        })
    }

    /// The next event of this kind of which `condition` holds.
    fn find(&mut self, kind: &str, what: &str, condition: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        let mut is_kind = false;
        for line in self.0.by_ref() {
            let line = line.unwrap();
            match line.split_once(": ") {
                Some(("event", name)) => is_kind = name == kind,
                Some(("data", text)) if is_kind => {
                    let event: Value = serde_json::from_str(text).unwrap();
                    if condition(&event) {
                        return event;
                    }
                }
                _ => {}
            }
            assert!(began.elapsed() < LIMIT, "in vain: {kind} {what}");
        }
        panic!("the events ended while waiting: {kind} {what}");
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        match &mut self.0 {
            Runs::Child(child) => {
                child.kill().unwrap();
                child.wait().unwrap();
            }
            Runs::Unit(_) => {
                let stopped = Command::new("systemctl").args(["stop", UNIT]).status().unwrap();
                assert!(stopped.success(), "systemctl stop {UNIT}");
            }
        }
    }
}

fn url(path: &str) -> String {
    format!("http://{ADDRESS}{path}")
}
