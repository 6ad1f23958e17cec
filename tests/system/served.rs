//! A daemon as its users meet it: a process, an address, and what it answers.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use ureq::Agent;
use ureq::http::Response;

/// A running daemon; killed when dropped.
#[derive(Debug)]
pub struct Served {
    child: Child,
    /// Where it answers, as `http://127.0.0.1:40123`.
    pub address: String,
    agent: Agent,
}

/// What it answered.
#[derive(Debug)]
pub struct Answer {
    /// The HTTP status.
    pub status: u16,
    /// The `Content-Type`.
    pub media_type: String,
    /// The `Location`, if there is one.
    pub location: Option<String>,
    /// The `Link`, if there is one.
    pub link: Option<String>,
    /// The `Set-Cookie`, if there is one.
    pub cookie: Option<String>,
    /// The body.
    pub bytes: Vec<u8>,
}

impl Answer {
    /// The body as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.bytes).unwrap_or_else(|e| panic!("{e}: {}", self.text()))
    }

    /// The body as text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes).into_owned()
    }
}

impl Served {
    /// Starts `plumb serve` with this configuration, kept with its store in `folder`, on a free
    /// port.
    pub fn start(folder: &Path, config: &str) -> Self {
        Self::start_in(folder, config, &[])
    }

    /// The same, with variables in its environment.
    pub fn start_in(folder: &Path, config: &str, environment: &[(&str, &str)]) -> Self {
        let file = folder.join("plumb.toml");
        let store = folder.join("store");
        std::fs::write(
            &file,
            format!("[store]\npath = {:?}\n{config}", store.display().to_string()),
        )
        .unwrap();
        Self::run(&file, environment)
    }

    /// Starts it with the configuration in `file`, on a free port.
    pub fn run(file: &Path, environment: &[(&str, &str)]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_plumb"))
            .args(["serve", "--listen", "127.0.0.1:0", "--config"])
            .arg(file)
            .envs(environment.iter().copied())
            .env("RUST_LOG", "info")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut log = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut said = Vec::new();
        let address = loop {
            let Some(line) = log.next() else { panic!("the daemon ended: {}", said.join("\n")) };
            let line = line.unwrap();
            if let Some((_, address)) = line.split_once("listening on ") {
                break address.split_whitespace().next().unwrap().to_owned();
            }
            said.push(line);
        };
        // Somebody must read on, or the daemon would wait for its log.
        std::thread::spawn(move || log.for_each(drop));
        let agent = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            // A refusal that is sent before the body has come ends its connection: HTTP lets a
            // server do that, and a client that reuses the connection would have to ask again.
            .max_idle_connections(0)
            .build()
            .new_agent();
        Self { child, address, agent }
    }

    /// GET.
    pub fn get(&self, path: &str) -> Answer {
        answer(self.agent.get(format!("{}{path}", self.address)).call().unwrap())
    }

    /// POST of a document.
    pub fn post(&self, path: &str, document: &Value) -> Answer {
        self.post_text(path, "application/json", &document.to_string())
    }

    /// POST of anything.
    pub fn post_text(&self, path: &str, media_type: &str, body: &str) -> Answer {
        let request =
            self.agent.post(format!("{}{path}", self.address)).header("Content-Type", media_type);
        answer(request.send(body).unwrap())
    }

    /// POST without a body.
    pub fn post_nothing(&self, path: &str) -> Answer {
        answer(self.agent.post(format!("{}{path}", self.address)).send_empty().unwrap())
    }

    /// POST without a body, with headers of its own.
    pub fn post_with(&self, path: &str, headers: &[(&str, &str)]) -> Answer {
        let mut request = self.agent.post(format!("{}{path}", self.address));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        answer(request.send_empty().unwrap())
    }

    /// DELETE.
    pub fn delete(&self, path: &str) -> Answer {
        answer(self.agent.delete(format!("{}{path}", self.address)).call().unwrap())
    }

    /// A request with headers of its own and no body.
    pub fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Answer {
        let mut request = self.agent.get(format!("{}{path}", self.address));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        answer(request.call().unwrap())
    }

    /// Follows the events, from `last_seen` on if given.
    pub fn events(&self, query: &str, last_seen: Option<&str>) -> Events {
        let mut request = self.agent.get(format!("{}/v1/events{query}", self.address));
        if let Some(id) = last_seen {
            request = request.header("Last-Event-ID", id);
        }
        let response = request.call().unwrap();
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Events { lines: BufReader::new(Box::new(response.into_body().into_reader())) }
    }

    /// Ends the daemon at once, as a power cut would.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Sends it a signal, by the name that `kill` knows.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .arg(format!("-{name}"))
            .arg(self.child.id().to_string())
            .status()
            .unwrap();
        assert!(sent.success());
    }

    /// How much of the machine's memory it holds, in kB.
    pub fn resident_kb(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().trim_end_matches("kB").trim().parse().unwrap()
    }

    /// Waits until it has ended.
    pub fn ended(&mut self) -> ExitStatus {
        self.child.wait().unwrap()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn answer(response: Response<ureq::Body>) -> Answer {
    let header =
        |name: &str| response.headers().get(name).map(|value| value.to_str().unwrap().to_owned());
    let (media_type, location) = (header("content-type").unwrap_or_default(), header("location"));
    let (link, cookie) = (header("link"), header("set-cookie"));
    let status = response.status().as_u16();
    let mut bytes = Vec::new();
    response.into_body().into_reader().read_to_end(&mut bytes).unwrap();
    Answer { status, media_type, location, link, cookie, bytes }
}

/// Server-sent events as they come.
pub struct Events {
    lines: BufReader<Box<dyn Read + Send>>,
}

/// One of them.
#[derive(Debug, Clone)]
pub struct SentEvent {
    /// Its id.
    pub id: String,
    /// Its name.
    pub name: String,
    /// What it says.
    pub data: Value,
}

impl Events {
    /// The next event.
    pub fn next(&mut self) -> SentEvent {
        let (mut id, mut name, mut data) = (String::new(), String::new(), None);
        loop {
            let mut line = String::new();
            assert_ne!(self.lines.read_line(&mut line).unwrap(), 0, "the stream of events ended");
            let line = line.trim_end();
            match line.split_once(": ") {
                Some(("id", value)) => id = value.to_owned(),
                Some(("event", value)) => name = value.to_owned(),
                Some(("data", value)) => data = Some(serde_json::from_str(value).unwrap()),
                _ => {}
            }
            if line.is_empty()
                && let Some(data) = data.take()
            {
                return SentEvent { id, name, data };
            }
        }
    }

    /// The first event that is `wanted`, itself included. Others may come for ever.
    pub fn until(&mut self, wanted: impl Fn(&SentEvent) -> bool) -> SentEvent {
        let begun = Instant::now();
        loop {
            let event = self.next();
            if wanted(&event) {
                return event;
            }
            assert!(begun.elapsed() < PATIENCE, "the event did not come; the last was {event:?}");
        }
    }
}

/// How long an event may take that is sure to come: far longer than any does on a slow machine.
const PATIENCE: Duration = Duration::from_secs(180);

/// A recording that comes with the project.
pub fn recording(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings").join(name);
    assert!(path.exists(), "{} is missing", path.display());
    path
}

/// The configuration of one camera that replays a recording of the project.
pub fn replaying(camera: &str, name: &str) -> String {
    let path = recording(name).display().to_string();
    format!(
        "[[camera]]\nname = {camera:?}\nsource = {{ kind = \"recording\", path = {path:?}, pace = \"fastest\", repeat = true }}\n"
    )
}

/// The configuration of one camera that replays a folder of images again and again.
pub fn repeating(camera: &str, folder: &Path) -> String {
    let path = folder.display().to_string();
    format!(
        "[[camera]]\nname = {camera:?}\nsource = {{ kind = \"recording\", path = {path:?}, fps = 200, repeat = true }}\n"
    )
}
