//! What is fuzzed: each target takes any bytes, and must neither panic nor hang nor take more
//! memory than its budget. The fuzzer (`libfuzzer.rs`) and the replay in `make test`
//! (`tests/system/fuzz_corpus.rs`) run the same functions.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use plumb::calibration::result::Calibration;
use plumb::calibration::session_record::SessionRequest;
use plumb::config::{Overrides, Written};
use plumb::document::calibration::CalibrationDocument;
use plumb::document::problem::ProblemDocument;
use plumb::document::reading::from_json;
use plumb::document::sensors_file::SensorsFile;
use plumb::document::session::StartDocument;
use plumb::document::target_file::target_from_text;
use plumb::estimation::problem::CameraProblem;
use plumb::export::{ExportOptions, Format, export};
use plumb::http::{self, Access, Service};
use plumb::imaging::decode;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::gray::GrayImage;
use plumb::imaging::image_file::frame_from_file;
use plumb::pipeline::FleetOptions;
use plumb::pipeline::fleet::Fleet;
use plumb::recording::{ReadOptions, Recording, metadata, repair};
use plumb::store::Store;

/// One of them.
pub struct Target {
    /// Its name, and its folder in the corpus.
    pub name: &'static str,
    /// Reads the bytes as the program would.
    pub run: fn(&[u8]),
}

/// All of them.
pub const ALL: [Target; 7] = [
    Target { name: "image", run: image },
    Target { name: "mcap", run: mcap },
    Target { name: "bag1", run: bag1 },
    Target { name: "db3", run: db3 },
    Target { name: "config", run: config },
    Target { name: "document", run: document },
    Target { name: "http", run: http },
];

/// Frame sets read of a recording at most.
const FRAME_SETS: usize = 50;

fn image(input: &[u8]) {
    let _ = decode::file_size(input);
    let frame = frame_from_file(SensorKind::Color, input.to_vec());
    let mut luma = GrayImage::default();
    let _ = decode::luma(&frame, &mut luma);
    let _ = decode::rgb(&frame);
    let _ = DepthImage::from_frame(&frame_from_file(SensorKind::Depth, input.to_vec()));
}

fn mcap(input: &[u8]) {
    let path = written("fuzz.mcap", input);
    read(&path);
    let _ = metadata(&path, "plumb.truth");
    if repair(&path).is_ok() {
        read(&path);
    }
}

fn bag1(input: &[u8]) {
    read(&written("fuzz.bag", input));
}

fn db3(input: &[u8]) {
    read(&written("fuzz.db3", input));
}

fn read(path: &Path) {
    let Ok(mut recording) = Recording::open(path, &ReadOptions::default()) else { return };
    let mut luma = GrayImage::default();
    for _ in 0..FRAME_SETS {
        let Ok(Some(set)) = recording.next_frame_set() else { return };
        for frame in &set.frames {
            let _ = decode::luma(frame, &mut luma);
        }
    }
}

/// The input as a file, in memory where the system has such a folder.
fn written(name: &str, input: &[u8]) -> PathBuf {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        let memory = Path::new("/dev/shm");
        let made = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
        made.expect("a folder for inputs")
    });
    let path = FOLDER.path().join(name);
    std::fs::write(&path, input).expect("the input is written");
    path
}

fn config(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else { return };
    let Ok(written) = Written::parse(text, Path::new("plumb.toml")) else { return };
    // What is named is read: an input may name a device that never ends.
    if !["_file", "tls", "cert", "key"].iter().any(|name| text.contains(name)) {
        let _ = written.check(&Overrides::default());
    }
}

fn document(input: &[u8]) {
    if let Ok(problem) = from_json::<ProblemDocument>(input) {
        let _ = problem.options();
        let _ = CameraProblem::try_from(&problem);
    }
    if let Ok(start) = from_json::<StartDocument>(input) {
        let _ = SessionRequest::try_from(&start);
    }
    if let Ok(read) = from_json::<CalibrationDocument>(input)
        && let Ok(calibration) = Calibration::try_from(&read)
    {
        for format in Format::ALL {
            let _ = export(&calibration, format, &ExportOptions::default());
        }
    }
    let Ok(text) = std::str::from_utf8(input) else { return };
    let _ = target_from_text(text);
    if let Ok(sensors) = SensorsFile::from_toml(text) {
        let _ = (sensors.depth_factory(), sensors.depth.encoding());
    }
}

/// What comes over a connection, answered by a daemon without cameras.
fn http(input: &[u8]) {
    static ADDRESS: LazyLock<SocketAddr> = LazyLock::new(daemon);
    let patience = Some(Duration::from_secs(15));
    let mut stream = TcpStream::connect(*ADDRESS).expect("the daemon listens");
    stream.set_read_timeout(patience).expect("a time limit");
    stream.set_write_timeout(patience).expect("a time limit");
    // Only the first bytes: a connection that goes on with events never ends.
    let mut answer = [0; 512];
    if stream.write_all(input).is_err() || stream.shutdown(std::net::Shutdown::Write).is_err() {
        return;
    }
    let length = match stream.read(&mut answer) {
        Ok(length) => length,
        Err(error) => {
            let hangs = matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut);
            assert!(!hangs, "no answer in {patience:?}");
            return;
        }
    };
    let status = answer.get(9..12).filter(|_| length > 12).unwrap_or_default();
    assert_ne!(status, b"500", "{}", String::from_utf8_lossy(&answer[..length]));
}

/// Begins to serve; it ends with the process.
fn daemon() -> SocketAddr {
    let (address, ready) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let folder = tempfile::tempdir().expect("a folder for the store");
        let store = Arc::new(Store::open(folder.path()).expect("a store"));
        let fleet = Fleet::start(Vec::new(), Arc::clone(&store), &FleetOptions::default());
        let fleet = Arc::new(fleet.expect("a fleet"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.expect("a runtime").block_on(async {
            let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("an address");
            let bound = listener.local_addr().expect("an address");
            let access = Arc::new(Access::new(None, bound.port(), false));
            let solve_time = Duration::from_secs(1);
            let service = Service { fleet, store, access, tls: None, solve_time };
            let _ = address.send(bound);
            let _ = http::serve(listener, service, std::future::pending()).await;
        });
    });
    ready.recv().expect("an address")
}
