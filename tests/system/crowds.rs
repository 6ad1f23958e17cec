//! Clients that take and do not give: silent ones, readers that do not read, and too many of
//! either. Whoever asks about health is answered all the same.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use crate::served::{Served, replaying};

/// An answer that takes longer has failed.
const PATIENCE: Duration = Duration::from_secs(20);

fn connected(served: &Served) -> TcpStream {
    let stream = TcpStream::connect(served.address.trim_start_matches("http://")).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

fn asking(served: &Served, path: &str) -> TcpStream {
    let mut stream = connected(served);
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    stream
}

fn status(stream: &mut TcpStream) -> String {
    let mut head = [0; 12];
    stream.read_exact(&mut head).unwrap();
    String::from_utf8_lossy(&head[9..]).into_owned()
}

#[test]
fn silent_clients_keep_nobody_out() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let silent: Vec<TcpStream> = (0..300).map(|_| connected(&served)).collect();
    // Half of a head is no more than silence.
    let half: Vec<TcpStream> = (0..300)
        .map(|_| {
            let mut stream = connected(&served);
            stream.write_all(b"GET /healthz HTT").unwrap();
            stream
        })
        .collect();
    for path in ["/healthz", "/metrics", "/v1/cameras"] {
        assert_eq!(served.get(path).status, 200, "{path}");
    }
    // Those that came first had to go.
    let mut first = &silent[0];
    assert_eq!(first.read(&mut [0; 1]).unwrap(), 0);
    drop((silent, half));
}

#[test]
fn streams_that_nobody_reads_leave_room_for_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let streams: Vec<TcpStream> = (0..300)
        .map(|k| {
            let path = if k % 2 == 0 { "/v1/events" } else { "/v1/cameras/front/preview.mjpg" };
            asking(&served, path)
        })
        .collect();
    let mut last = asking(&served, "/v1/events");
    let refused = status(&mut last);
    assert!(["200", "503"].contains(&refused.as_str()), "{refused}");
    for path in ["/healthz", "/metrics", "/v1/cameras"] {
        assert_eq!(served.get(path).status, 200, "{path}");
    }
    drop(streams);
}

#[test]
fn no_more_streams_go_out_than_there_is_room_for() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path(), &replaying("front", "walk.mcap"));
    let mut streams: Vec<TcpStream> = (0..140).map(|_| asking(&served, "/v1/events")).collect();
    let statuses: Vec<String> = streams.iter_mut().map(status).collect();
    let count = |wanted: &str| statuses.iter().filter(|status| *status == wanted).count();
    assert_eq!((count("200"), count("503")), (128, 12));
    assert_eq!(served.get("/healthz").status, 200);
}
