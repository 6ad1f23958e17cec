//! `plumb serve` in the small machine, spoken to over HTTP.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use serde_json::Value;

const ADDRESS: &str = "127.0.0.1:8600";
/// Longer than anything asked for here takes, in software emulation too.
const LIMIT: Duration = Duration::from_secs(240);

/// A running daemon; it ends with this value.
pub struct Daemon(Child);

impl Daemon {
    /// Starts it with these `[[camera]]` tables.
    pub fn start(cameras: &str) -> Self {
        let folder = format!("/run/plumb-{}", std::process::id());
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        let config = format!("{folder}/plumb.toml");
        let text = format!("[server]\nlisten = \"{ADDRESS}\"\n[store]\npath = \"{folder}/store\"\n{cameras}");
        fs::write(&config, text).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_plumb"))
            .args(["serve", "--config", &config])
            .env("RUST_LOG", "warn")
            .spawn()
            .unwrap();
        let daemon = Self(child);
        let began = Instant::now();
        while ureq::get(&url("/healthz")).call().is_err() {
            assert!(began.elapsed() < LIMIT, "the daemon does not answer");
            std::thread::yield_now();
        }
        daemon
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
        answer.unwrap_or_else(|error| panic!("POST {path}: {error}")).body_mut().read_json().unwrap()
    }

    pub fn camera(&self, name: &str) -> Value {
        self.get(&format!("/v1/cameras/{name}"))
    }

    /// Looks at `what` answers each time that something happens, until it gives a value.
    pub fn wait_for<T>(&self, what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
        let events = ureq::get(&url("/v1/events")).call().unwrap().into_body().into_reader();
        let began = Instant::now();
        let mut last_look = None;
        for line in BufReader::new(events).lines() {
            let line = line.unwrap();
            let due = last_look.is_none_or(|last: Instant| last.elapsed() > Duration::from_millis(200));
            if !due || line.is_empty() {
                continue;
            }
            last_look = Some(Instant::now());
            if let Some(value) = condition() {
                return value;
            }
            assert!(began.elapsed() < LIMIT, "in vain: {what}");
        }
        panic!("the events ended while waiting: {what}");
    }

    pub fn wait_for_state(&self, camera: &str, state: &str) -> Value {
        self.wait_for(&format!("{camera} is {state}"), || Some(self.camera(camera)).filter(|now| now["state"] == state))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

fn url(path: &str) -> String {
    format!("http://{ADDRESS}{path}")
}
