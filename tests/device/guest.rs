//! What the scenarios share, inside the small machine.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use plumb::capture::mode::ModeRequest;
use plumb::capture::v4l2::{V4l2Camera, V4l2Options};
use plumb::capture::{CaptureError, FrameSource};
use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode;
use plumb::imaging::frame::FrameSet;
use plumb::imaging::gray::GrayImage;

/// The program under test, as the host put it here.
pub const PLUMB: &str = "/run/out/plumb";
/// The first vivid camera.
pub const VIVID: &str = "/dev/video0";
/// Longer than any frame takes to come, in software emulation too.
pub const PATIENCE: Duration = Duration::from_secs(5);

pub fn options(device: &str, format: Option<&str>) -> V4l2Options {
    let mode = ModeRequest {
        size: Some(ImageSize::new(640, 360)),
        format: format.map(str::to_owned),
        fps: Some(30.0),
    };
    V4l2Options { device: device.into(), mode, ..V4l2Options::default() }
}

/// A still image without counters in it.
pub fn still_controls() -> BTreeMap<String, i64> {
    BTreeMap::from([("osd_text_mode".to_owned(), 2), ("gain_automatic".to_owned(), 0)])
}

pub fn camera(options: V4l2Options) -> V4l2Camera {
    V4l2Camera::new(options)
}

pub fn luma_of(set: &FrameSet) -> GrayImage {
    let mut image = GrayImage::default();
    decode::luma(&set.frames[0], &mut image).unwrap();
    image
}

/// Sets a control by the system's own tool: buttons too.
pub fn press(device: &str, control: &str) {
    let status = Command::new("v4l2-ctl").args(["-d", device, "-c", control]).status().unwrap();
    assert!(status.success(), "v4l2-ctl -d {device} -c {control}");
}

/// Takes frames until one is refused; how many came, and why they ended.
pub fn frames_until_error(source: &mut dyn FrameSource) -> (usize, CaptureError) {
    for count in 0.. {
        if let Err(error) = source.next_frame(PATIENCE) {
            return (count, error);
        }
    }
    unreachable!("a count has no end")
}

/// Takes both vivid cameras away, as if their cables were pulled.
pub fn unplug() {
    fs::write("/sys/bus/platform/drivers/vivid/unbind", "vivid.0").unwrap();
}

/// Brings both vivid cameras back; their numbers are the first that are free.
pub fn plug_in() {
    fs::write("/sys/bus/platform/drivers/vivid/bind", "vivid.0").unwrap();
    node_of("vivid-000-vid-cap");
}

/// The node of the device with this name, once the system has made it.
pub fn node_of(name: &str) -> PathBuf {
    let named = |folder: &fs::DirEntry| {
        fs::read_to_string(folder.path().join("name")).is_ok_and(|found| found.trim() == name)
    };
    let deadline = Instant::now() + PATIENCE;
    loop {
        let folders = fs::read_dir("/sys/class/video4linux").into_iter().flatten().flatten();
        let nodes = folders.filter(named).map(|folder| Path::new("/dev").join(folder.file_name()));
        if let Some(node) = nodes.into_iter().find(|node| node.exists()) {
            return node;
        }
        assert!(Instant::now() < deadline, "{name} has no node");
        std::thread::yield_now();
    }
}

/// Open descriptors, threads and resident memory of this process.
pub fn footprint() -> (usize, usize, usize) {
    let count = |folder: &str| fs::read_dir(folder).unwrap().count();
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    let kilobytes = resident.trim().trim_end_matches(" kB").parse().unwrap();
    (count("/proc/self/fd"), count("/proc/self/task"), kilobytes)
}

/// What a process, or `self`, has computed so far.
pub fn processor_time(process: &str) -> Duration {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
    let ticks: u64 = fields[11..13].iter().map(|field| field.parse::<u64>().unwrap()).sum();
    Duration::from_millis(ticks * 10)
}
