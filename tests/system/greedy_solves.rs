//! `POST /v1/solve` and those who ask for too much of it: who leaves, who sends slowly, who sends a
//! lot, and what takes too long. Whoever asks for a little is answered all the same.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use serde_json::{Value, json};

use crate::served::Served;

/// An answer that takes longer has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// Views of a flat grid by a camera of 600 px, each pixel a little off its place, so that nothing
/// is exact and everything has to be tried.
fn problem(views: u32, cols: u32, rows: u32) -> Value {
    let off = |k: f64| ((k * 12.9898).sin() * 43758.5453).fract() * 0.5;
    let view = |k: u32| {
        let (a, b) = (0.4 * (1.7 * f64::from(k)).sin(), 0.4 * (2.3 * f64::from(k)).cos());
        let mut points: (Vec<[f64; 3]>, Vec<[f64; 2]>) = Default::default();
        for i in 0..cols * rows {
            let (col, row) = (f64::from(i % cols), f64::from(i / cols));
            let [x, y] = [col / f64::from(cols) - 0.5, row / f64::from(rows) - 0.5];
            // Rotated about y by a, then about x by b, a meter and a half away.
            let (rotated_x, z) = (x * a.cos(), -x * a.sin());
            let (rotated_y, z) = (y * b.cos() - z * b.sin(), y * b.sin() + z * b.cos() + 1.5);
            let noise = f64::from(k * cols * rows + i);
            points.0.push([x, y, 0.0]);
            points.1.push([
                600.0 * rotated_x / z + 320.0 + off(noise),
                600.0 * rotated_y / z + 240.0 + off(noise + 0.5),
            ]);
        }
        json!({"object": points.0, "image": points.1})
    };
    json!({"image_size": [640, 480], "views": (0..views).map(view).collect::<Vec<_>>()})
}

/// Sends the head of a request whose body has `length` bytes.
fn announced(served: &Served, length: usize) -> TcpStream {
    let mut stream = TcpStream::connect(served.address.trim_start_matches("http://")).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.set_write_timeout(Some(PATIENCE)).unwrap();
    write!(
        stream,
        "POST /v1/solve HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
         Content-Length: {length}\r\n\r\n"
    )
    .unwrap();
    stream
}

fn asked(served: &Served, problem: &Value) -> TcpStream {
    let body = problem.to_string();
    let mut stream = announced(served, body.len());
    stream.write_all(body.as_bytes()).unwrap();
    stream
}

/// Asks until so many solves are being computed.
fn until_running(served: &Served, count: usize) {
    let wanted = format!("\nplumb_solves_running {count}\n");
    let running = (0..20_000).any(|_| served.get("/metrics").text().contains(&wanted));
    assert!(running, "not {count} solves: {}", served.get("/metrics").text());
}

fn start(folder: &tempfile::TempDir, config: &str) -> Served {
    Served::start(folder.path(), config)
}

#[test]
fn a_solve_whose_client_has_left_ends() {
    let folder = tempfile::tempdir().unwrap();
    let served = start(&folder, "[server]\nsolve_seconds = 3600\n");
    // Each would be computed for longer than the test may take.
    let large = problem(25, 50, 40);
    let clients = [asked(&served, &large), asked(&served, &large)];
    until_running(&served, 2);
    drop(clients);
    until_running(&served, 0);
    assert_eq!(served.post("/v1/solve", &problem(6, 7, 5)).status, 200);
}

#[test]
fn what_takes_too_long_is_refused_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    let served = start(&folder, "[server]\nsolve_seconds = 1\n");
    let refused = served.post("/v1/solve", &problem(25, 50, 40));
    assert_eq!(refused.status, 503);
    assert_eq!(refused.media_type, "application/problem+json");
    assert!(refused.text().contains("solve_seconds"), "{}", refused.text());
    until_running(&served, 0);
    assert_eq!(served.post("/v1/solve", &problem(6, 7, 5)).status, 200);
}

#[test]
fn slow_bodies_take_nobody_s_place() {
    let folder = tempfile::tempdir().unwrap();
    let served = start(&folder, "");
    let slow: Vec<TcpStream> = (0..8)
        .map(|_| {
            let mut stream = announced(&served, 1_000_000);
            stream.write_all(br#"{"image_size":[640,480],"views":["#).unwrap();
            stream
        })
        .collect();
    assert_eq!(served.post("/v1/solve", &problem(6, 7, 5)).status, 200);
    // Nobody waits for them for ever either.
    for mut stream in slow {
        let mut head = [0; 12];
        stream.read_exact(&mut head).unwrap();
        assert_eq!(&head[9..], b"408");
    }
}

#[test]
fn large_bodies_are_bounded_together_and_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let served = start(&folder, "");
    let almost = vec![b' '; (8 << 20) - 1];
    // Those that find no room are answered while they send, and closed.
    let large: Vec<TcpStream> = (0..50)
        .map(|_| {
            let mut stream = announced(&served, 8 << 20);
            let _ = stream.write_all(&almost);
            stream
        })
        .collect();
    assert_eq!(served.get("/healthz").status, 200);
    assert_eq!(served.post("/v1/solve", &problem(6, 7, 5)).status, 200);
    let resident_kb = served.resident_kb();
    assert!(resident_kb < 256_000, "{resident_kb} kB");
    drop(large);

    let refused = served.post_text("/v1/solve", "application/json", &" ".repeat((8 << 20) + 1));
    assert_eq!(refused.status, 413);
    let refused = served.post("/v1/solve", &problem(26, 50, 40));
    assert_eq!(refused.status, 422);
    assert!(refused.text().contains("at most 50000"), "{}", refused.text());
}
