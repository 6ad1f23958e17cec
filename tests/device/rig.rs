//! A rig of two real devices, one of which is unplugged in the middle of a session: a loopback
//! camera and a USB camera, which show what two cameras saw of one board at the same times.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use plumb::geometry::pixel::ImageSize;
use plumb::imaging::decode::encode_jpeg;
use plumb::imaging::frame::Frame;
use plumb::imaging::gray::GrayImage;
use plumb::recording::{ReadOptions, Recording};
use serde_json::{Value, json};

use crate::daemon::Daemon;
use crate::loopback::{Screen, yuyv_of};
use crate::usb::{SERIAL, listed};
use crate::usb_camera::{CameraModel, UsbCamera};

const LOOPBACK: &str = "/dev/video20";
/// Two cameras that nothing synchronizes take images within half of 1/15 s of each other: the same
/// frame set.
const FPS: u32 = 15;
/// Frames of each camera, in all, that an image is shown for unless it becomes a view earlier: a busy
/// host may lose most.
const SHOWN: u64 = 60;
/// Frames without a board of each camera between two images, so that no two images are ever taken for
/// simultaneous: more than a device queues.
const BLANK: u64 = 8;
/// Views of both cameras that determine where they are.
const ENOUGH_VIEWS: u64 = 3;
/// Images of each recording.
const IMAGES: usize = 30;
/// From an image to the next that is shown, so that views differ; 7 and 30 have no common divisor.
const STEP: usize = 7;
/// Frames of the camera that is still there, while the other one is gone.
const WITHOUT: u64 = 30;
/// 30 frames of 640x480 that were kept with their pixels would be 9 MB.
const FLAT_KB: u64 = 8_000;

/// Which image all cameras show now: one of their recordings, or none.
#[derive(Clone)]
struct Projector(Arc<AtomicUsize>);

impl Projector {
    const NOTHING: usize = usize::MAX;

    fn new() -> Self {
        Self(Arc::new(AtomicUsize::new(Self::NOTHING)))
    }

    fn show(&self, image: usize) {
        self.0.store(image, Ordering::Relaxed);
    }

    fn shown(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// What one camera sees of the images.
struct Slides {
    frames: Vec<Frame>,
    blank: Frame,
    projector: Projector,
    /// The image seen last, as the camera sends it.
    sent: Option<(usize, Vec<u8>)>,
}

impl Slides {
    fn of(name: &str, projector: &Projector) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings").join(name);
        let mut recording = Recording::open(&path, &ReadOptions::default()).unwrap();
        let next = || recording.next_frame_set().unwrap();
        let frames: Vec<Frame> =
            std::iter::from_fn(next).map(|mut set| set.frames.remove(0)).collect();
        let ImageSize { width, height } = frames[0].size;
        let [width, height] = [width, height].map(|side| side as usize);
        let gray = GrayImage::from_pixels(width, height, vec![128; width * height]).unwrap();
        let blank = Frame { bytes: encode_jpeg(gray.view(), 90).into(), ..frames[0].clone() };
        Self { frames, blank, projector: projector.clone(), sent: None }
    }

    /// What is shown now, as `converted` makes it: once an image, since decoding takes long in
    /// software emulation.
    fn now(&mut self, converted: impl FnOnce(&Frame) -> Vec<u8>) -> &[u8] {
        let shown = self.projector.shown();
        let sent = self.sent.take().filter(|(image, _)| *image == shown);
        let frame = self.frames.get(shown).unwrap_or(&self.blank);
        &self.sent.insert(sent.unwrap_or_else(|| (shown, converted(frame)))).1
    }
}

/// What a session of the two cameras has seen so far.
struct Seen {
    frames: [u64; 2],
    boards: [u64; 2],
    views_shared: u64,
}

impl Seen {
    fn of(session: &Value) -> Self {
        let of = |k: usize, field: &str| session["cameras"][k][field].as_u64().unwrap();
        Self {
            frames: [0, 1].map(|k| of(k, "frames_seen")),
            boards: [0, 1].map(|k| of(k, "boards_seen")),
            views_shared: of(1, "views_shared"),
        }
    }
}

/// The loopback camera; it ends with this value.
struct LoopbackCamera(Arc<AtomicBool>, Option<JoinHandle<()>>);

impl LoopbackCamera {
    fn start(mut slides: Slides) -> Self {
        let ended = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&ended);
        let showing = thread::spawn(move || {
            let mut screen = Screen::open(LOOPBACK, ImageSize::new(640, 480), "YUYV");
            let mut luma = GrayImage::default();
            while !seen.load(Ordering::Relaxed) {
                screen.show(slides.now(|frame| yuyv_of(frame, &mut luma)));
                thread::sleep(Duration::from_secs(1) / FPS);
            }
        });
        Self(ended, Some(showing))
    }
}

impl Drop for LoopbackCamera {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
        let _ = self.1.take().map(JoinHandle::join);
    }
}

fn plug_in(mut slides: Slides) -> UsbCamera {
    let mut luma = GrayImage::default();
    let model = CameraModel { serial: SERIAL, size: [640, 480], fps: FPS };
    let camera = UsbCamera::plug_in(model, move |format| {
        slides.now(|frame| format.of(frame, &mut luma)).to_vec()
    });
    listed();
    camera
}

pub fn a_rig_goes_on_without_the_camera_that_is_unplugged() -> String {
    let projector = Projector::new();
    let slides = |name: &str| Slides::of(name, &projector);
    let _left = LoopbackCamera::start(slides("rig-left.mcap"));
    let right = plug_in(slides("rig-right.mcap"));
    let daemon = Daemon::start(&format!(
        r#"
[[camera]]
name = "left"
source = {{ kind = "v4l2", device = "{LOOPBACK}" }}
[[camera]]
name = "right"
source = {{ kind = "v4l2", device = "{SERIAL}", format = "MJPG" }}
[[rig]]
name = "head"
cameras = ["left", "right"]
"#
    ));
    for camera in ["left", "right"] {
        daemon.wait_for_state(camera, "streaming");
    }
    let target = json!({"kind": "chessboard", "cols": 8, "rows": 6, "square_m": 0.03});
    let started =
        daemon.post("/v1/rigs/head/sessions", &json!({"target": target, "lens": "brown"}));
    let path = format!("/v1/sessions/{}", started["id"].as_str().unwrap());
    let now = || daemon.get(&path);
    let seen = || Seen::of(&now());
    let mut image = 0;
    while seen().views_shared < ENOUGH_VIEWS {
        let before = seen();
        projector.show(image);
        daemon.wait_for("a view of both", || {
            let all_seen = |now: &Seen| (0..2).all(|k| now.frames[k] > before.frames[k] + SHOWN);
            Some(seen()).filter(|now| now.views_shared > before.views_shared || all_seen(now))
        });
        projector.show(Projector::NOTHING);
        let mut last_board = seen();
        daemon.wait_for("nothing in view", || {
            let now = seen();
            for k in 0..2 {
                if now.boards[k] > last_board.boards[k] {
                    (last_board.boards[k], last_board.frames[k]) = (now.boards[k], now.frames[k]);
                }
            }
            (0..2).all(|k| now.frames[k] >= last_board.frames[k] + BLANK).then_some(())
        });
        image = (image + STEP) % IMAGES;
    }

    drop(right);
    let lost = daemon.wait_for_state("right", "lost");
    let (before_kb, frames) = (daemon.resident_kb(), seen().frames[0]);
    let waiting = daemon.wait_for("frames of the other camera", || {
        Some(now()).filter(|now| Seen::of(now).frames[0] >= frames + WITHOUT)
    });
    assert_eq!(waiting["state"], "collecting", "{waiting}");
    let reason = waiting["reason"].as_str().unwrap();
    assert!(reason.starts_with("waiting for camera `right`"), "{reason}");
    let grown_kb = daemon.resident_kb().saturating_sub(before_kb);
    assert!(grown_kb < FLAT_KB, "{grown_kb} kB more while a camera is gone");

    let again = seen().frames[1];
    let right = plug_in(slides("rig-right.mcap"));
    daemon.wait_for_state("right", "streaming");
    daemon.wait_for("frames of both", || (seen().frames[1] > again).then_some(()));
    for (name, camera) in [("left", 0), ("right", 1)] {
        let metric = |name: &str| daemon.metric(name);
        let frames_seen = seen().frames[camera];
        let searched = metric(&format!("plumb_frames_searched_total{{camera={name:?}}}"));
        let dropped =
            metric(&format!("plumb_frames_dropped_total{{camera={name:?},why=\"overload\"}}"));
        // Last, since more frames come meanwhile.
        let received = metric(&format!("plumb_frames_total{{camera={name:?}}}"));
        assert!(searched + dropped <= received, "{name}: {searched} + {dropped} of {received}");
        assert!(frames_seen <= received, "{name}");
    }

    let finished = daemon.post(&format!("{path}/stop"), &json!({}));
    assert_eq!(finished["state"], "finished", "{finished}");
    let calibration = finished["calibration"].as_str().unwrap();
    let calibration = daemon.get(&format!("/v1/calibrations/{calibration}"));
    let baseline = &calibration["extrinsics"][0];
    assert_eq!(baseline["name"], "left_from_right", "{}", calibration["verdict"]);
    let component = |k: usize| baseline["translation"][k].as_f64().unwrap();
    let length_m = (0..3).map(|k| component(k).powi(2)).sum::<f64>().sqrt();
    let true_m = baseline_m();
    assert!((length_m - true_m).abs() < 0.002, "{length_m} m where {true_m} m is true");
    // Before its camera.
    drop((daemon, right));
    format!(
        "{}; {grown_kb} kB more meanwhile; cameras {length_m:.5} m ({true_m:.5})",
        lost["reason"]
    )
}

/// How far the two cameras truly are from each other, in meters.
fn baseline_m() -> f64 {
    let [left, right] = ["left", "right"].map(|camera| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join(format!("recordings/rig-{camera}.truth.json"));
        let truth: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        let pose: plumb::document::pose::PoseDocument =
            serde_json::from_value(truth["frames"][0]["camera_from_board"].clone()).unwrap();
        plumb::geometry::pose::Pose::try_from(&pose).unwrap()
    });
    (left * right.inverse()).translation().norm()
}
