//! The RealSense library itself, without a camera: recordings, what is wrong with files, and no
//! device. `eval "$(tests/device/realsense_library.sh)" && cargo test --features realsense --test
//! realsense`

#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stderr,
    clippy::excessive_precision,
    dead_code,
    reason = "a test program"
)]

mod live_device;
#[path = "../system/not_tested.rs"]
mod not_tested;
#[path = "../system/served.rs"]
mod served;
#[path = "../system/shared_data.rs"]
mod shared_data;
mod software_device;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumb::capture::realsense::{Origin, RealsenseCamera, RealsenseOptions, list_devices};
use plumb::capture::{CaptureError, FrameSource, SourceOpener};
use plumb::geometry::lens::LensModel;
use plumb::imaging::decode;
use plumb::imaging::depth_encoding::DepthEncoding;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::{FrameSet, SensorKind};
use plumb::imaging::gray::GrayImage;
use plumb::recording::{ReadOptions, Recording};
use serde_json::{Value, json};
use served::{Served, recording};
use shared_data::shared_data;
use software_device::{Device, SensorImages, StatedCamera, Stream, record};

const POLL: Duration = Duration::from_millis(200);

fn open(origin: Origin) -> Result<Box<dyn FrameSource>, CaptureError> {
    RealsenseCamera::new(RealsenseOptions { origin, ..RealsenseOptions::default() }).open()
}

fn refusal(origin: Origin) -> String {
    let began = Instant::now();
    let error = open(origin).map(|_| ()).unwrap_err().to_string();
    assert!(began.elapsed() < Duration::from_secs(2), "{error}: took {:?}", began.elapsed());
    assert!(!error.contains('\n'), "{error}");
    error
}

/// A D435's recording: its numbers are as they were read from the file by other software.
#[test]
fn a_recording_gives_its_factory_calibration_as_the_file_states_it() {
    let Some(folder) = shared_data("realsense-bag") else { return };
    let mut source = open(Origin::Bag(folder.join("single_depth_color_640x480.bag"))).unwrap();
    let description = source.description();
    assert_eq!(description.serial.as_deref(), Some("728612070259"));
    assert_eq!(description.model.as_deref(), Some("Intel RealSense D435"));
    assert!(
        description.mode.as_ref().is_some_and(|mode| mode.contains("firmware 05.09.14.00")),
        "{description:?}"
    );
    let depth = description.factory.sensor(SensorKind::Depth).unwrap();
    assert_eq!(description.factory.depth_encoding, Some(DepthEncoding::metric(0.001)));
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    assert!(
        near(depth.stated.focal_px[0], 390.43145752)
            && near(depth.stated.principal_px[1], 242.18734741)
    );
    let color = description.factory.sensor(SensorKind::Color).unwrap();
    let lens = color.lens.unwrap();
    assert_eq!(lens.model(), LensModel::Pinhole, "every coefficient is zero");
    assert!(near(lens.matrix.fx, 613.20367432) && near(lens.matrix.cy, 239.18299866));
    let color_from_depth = depth.color_from_sensor.unwrap();
    let rotation = color_from_depth.rotation();
    let stated = [-5.3199e-05, 0.00646343, 0.00515485, 0.99996585];
    for (read, stated) in [rotation.i, rotation.j, rotation.k, rotation.w].into_iter().zip(stated) {
        assert!(near(read, stated), "{rotation}");
    }
    for (read, stated) in
        color_from_depth.translation().iter().zip([0.01431131, 0.00060231, 0.00061080])
    {
        assert!(near(*read, stated), "{color_from_depth:?}");
    }
    let mut frames = Vec::new();
    let error = loop {
        match source.next_frame(POLL) {
            Ok(set) => frames.extend(set.frames),
            Err(CaptureError::TimedOut { .. }) => {}
            Err(error) => break error,
        }
    };
    assert_eq!(error, CaptureError::Ended);
    let depth = frames.iter().find(|frame| frame.sensor == SensorKind::Depth).unwrap();
    let mut readings: Vec<u16> =
        depth.bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
    readings.retain(|reading| *reading > 0);
    readings.sort_unstable();
    assert!(readings.len() > depth.bytes.len() / 2 * 9 / 10, "{} readings", readings.len());
    assert!((1400..1550).contains(&readings[readings.len() / 2]), "a wall at 1.47 m");
}

/// The daemon reports the same of the camera, in the shapes of a calibration.
#[test]
fn the_daemon_gives_the_factory_calibration_as_the_file_states_it() {
    let Some(folder) = shared_data("realsense-bag") else { return };
    let path = folder.join("single_depth_color_640x480.bag").display().to_string();
    let source = format!("{{ kind = \"realsense\", path = {path:?} }}");
    let own = tempfile::tempdir().unwrap();
    let served =
        Served::start(own.path(), &format!("[[camera]]\nname = \"front\"\nsource = {source}\n"));
    let mut events = served.events("", Some("0"));
    events.until(|event| {
        event.name == "camera" && event.data["identity"]["serial"] == "728612070259"
    });
    let camera = served.get("/v1/cameras/front").json();
    let factory = &camera["factory"];
    let lens = |sensor: &str| {
        ["fx", "fy", "cx", "cy"]
            .map(|name| factory["sensors"][sensor]["lens"][name].as_f64().unwrap_or(f64::NAN))
    };
    let near = |read: [f64; 4], stated: [f64; 4]| {
        read.iter().zip(stated).all(|(a, b)| (a - b).abs() < 1e-5)
    };
    assert!(
        near(lens("depth"), [390.43145752, 390.43145752, 331.38787842, 242.18734741]),
        "{camera}"
    );
    assert!(
        near(lens("color"), [613.20367432, 613.41931152, 319.93884277, 239.18299866]),
        "{camera}"
    );
    assert_eq!(factory["sensors"]["depth"]["unit_m"], 0.001, "{camera}");
    let moved = translation(named(&factory["extrinsics"], "color_from_depth"));
    assert!((moved - Vector3::new(0.01431131, 0.00060231, 0.00061080)).norm() < 1e-6, "{camera}");
    // The same in every format.
    let calibration = served.get("/v1/cameras/front/factory").json();
    assert_eq!(
        calibration["sensors"]["depth"]["lens"]["fx"], factory["sensors"]["depth"]["lens"]["fx"],
        "{calibration}"
    );
    for (asked, number) in [
        ("ros&sensor=depth", "390.4314"),
        ("ros", "613.2036"),
        ("opencv&sensor=depth", "331.3878"),
        ("kalibr", "613.4193"),
        ("mrcal", "319.9388"),
        // Its pixels have their corners, not their centers, at integers.
        ("colmap", "239.6829"),
        ("depth", "reading depth 0.001"),
        ("urdf", "0.0143113"),
        ("tf", "0.0143113"),
    ] {
        let answer = served.get(&format!("/v1/cameras/front/factory?format={asked}"));
        assert!(
            answer.status == 200 && answer.text().contains(number),
            "{asked}: {} {}",
            answer.status,
            answer.text()
        );
    }
}

#[test]
fn what_is_wrong_with_a_file_is_reported_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing.bag");
    assert!(refusal(Origin::Bag(missing)).contains("give an existing .bag file"));
    let wrong = folder.path().join("wrong.bag");
    std::fs::write(&wrong, b"hello").unwrap();
    assert!(refusal(Origin::Bag(wrong)).contains("not a recording of a RealSense camera"));
    let Some(data) = shared_data("realsense-bag") else { return };
    let whole = std::fs::read(data.join("single_depth_color_640x480.bag")).unwrap();
    for part in [2, 3, 10] {
        let cut = folder.path().join("cut.bag");
        std::fs::write(&cut, &whole[..whole.len() * (part - 1) / part]).unwrap();
        let error = refusal(Origin::Bag(cut));
        assert!(error.contains("cut"), "{error}");
    }
    let damaged = folder.path().join("damaged.bag");
    let mut bytes = whole;
    let length = bytes.len();
    bytes[4096..length - 4096].fill(0x55);
    std::fs::write(&damaged, bytes).unwrap();
    let error = refusal(Origin::Bag(damaged));
    assert!(error.contains("damaged.bag: "), "{error}");
}

#[test]
fn without_a_device_that_is_reported_at_once() {
    assert_eq!(
        refusal(Origin::OnlyDevice),
        "the RealSense camera was lost: no RealSense camera is plugged in"
    );
    let error = refusal(Origin::Serial("012345".to_owned()));
    assert!(error.starts_with("012345 was lost: it is not plugged in"), "{error}");
    let listing = list_devices();
    assert!(listing.devices.is_empty());
    assert!(listing.missing.unwrap().contains("the library sees no camera"));
}

/// Slower than the daemon searches, on a busy machine too: every frame of the walk is to be
/// searched.
const PACE: Duration = Duration::from_millis(200);

fn images(set: &FrameSet) -> SensorImages {
    let frame = |sensor| set.frame(sensor).unwrap();
    let depth = DepthImage::from_frame(frame(SensorKind::Depth)).unwrap();
    let depth = depth.readings().iter().flat_map(|reading| reading.to_le_bytes()).collect();
    let mut infrared = GrayImage::default();
    decode::luma(frame(SensorKind::Infrared), &mut infrared).unwrap();
    let color = decode::rgb(frame(SensorKind::Color)).unwrap().into_raw();
    // What is read back has a right infrared image; what is shown has none of its own, and shows
    // the left one reversed.
    let mut infrared2 = GrayImage::default();
    let infrared2 = match set.frame(SensorKind::Infrared2) {
        Some(frame) => {
            decode::luma(frame, &mut infrared2).unwrap();
            infrared2.pixels().to_vec()
        }
        None => infrared.pixels().iter().rev().copied().collect(),
    };
    let infrared = infrared.pixels().to_vec();
    [
        (Stream::Depth, depth),
        (Stream::Infrared, infrared),
        (Stream::Infrared2, infrared2),
        (Stream::Color, color),
    ]
}

/// A camera that states what it is not: a hundredth off, as factories are off after years.
fn stated(lens: &Value) -> StatedCamera {
    let number = |name: &str| lens[name].as_f64().unwrap() as f32;
    StatedCamera {
        focal_px: [number("fx") * 1.01, number("fy") * 1.01],
        principal_px: [number("cx") + 2.0, number("cy") - 2.0],
        coefficients: ["k1", "k2", "p1", "p2", "k3"].map(number),
    }
}

/// The shipped walk of a board before color, infrared and depth.
fn walk_images(count: usize) -> Vec<SensorImages> {
    let mut walk = Recording::open(&recording("rgbd.mcap"), &ReadOptions::default()).unwrap();
    let sets = std::iter::from_fn(|| walk.next_frame_set().unwrap());
    sets.take(count).map(|set| images(&set)).collect()
}

/// The camera that took it, by the library's means.
fn described(serial: &'static str, truth: &Value) -> Device {
    Device {
        serial,
        size: [640, 480],
        fps: 5,
        depth_unit_m: 0.001,
        cameras: ["depth", "color"].map(|sensor| stated(&truth["sensors"][sensor]["lens"])),
        color_from_depth: ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.025, 0.0, 0.0]),
        baseline_m: 0.05,
        options: Vec::new(),
    }
}

/// The same as the library records it; and what is true of it.
fn made_bag(folder: &Path, count: usize) -> (PathBuf, Value) {
    let truth: Value =
        serde_json::from_slice(&std::fs::read(recording("rgbd.truth.json")).unwrap()).unwrap();
    let sets = walk_images(count);
    let device = described("000000012345", &truth);
    let path = folder.join("walk.bag");
    record(&path, &device, if count > 10 { PACE } else { Duration::from_millis(30) }, &sets);
    (path, truth)
}

/// What was fed to the library's software device comes out of its recording, to the byte.
#[test]
fn a_made_recording_gives_every_sensor_as_it_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _) = made_bag(folder.path(), 6);
    let fed = walk_images(6);
    let mut source = open(Origin::Bag(path)).unwrap();
    let description = source.description();
    assert_eq!(description.serial.as_deref(), Some("000000012345"));
    assert!(
        description.mode.as_ref().is_some_and(|mode| mode.contains("firmware 5.16.0.1")),
        "{description:?}"
    );
    let mut whole = 0;
    let error = loop {
        match source.next_frame(POLL) {
            Ok(set) if set.frames.len() == 4 => {
                let seen = images(&set);
                assert!(
                    fed.contains(&seen),
                    "frame set {} is none of those recorded",
                    set.sequence
                );
                whole += 1;
            }
            Ok(_) | Err(CaptureError::TimedOut { .. }) => {}
            Err(error) => break error,
        }
    };
    assert_eq!(error, CaptureError::Ended);
    // Starting takes the first; the library drops what it has no time for.
    assert!(whole >= 3, "{whole} of 6 frame sets came");
}

fn rotation(pose: &Value) -> UnitQuaternion<f64> {
    let [w, x, y, z] = ["w", "x", "y", "z"].map(|k| pose["rotation"][k].as_f64().unwrap());
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

fn translation(pose: &Value) -> Vector3<f64> {
    Vector3::from_iterator((0..3).map(|k| pose["translation"][k].as_f64().unwrap()))
}

fn named<'a>(extrinsics: &'a Value, name: &str) -> &'a Value {
    extrinsics.as_array().unwrap().iter().find(|pose| pose["name"] == name).unwrap()
}

/// The product on the library: a session over HTTP on the recorded walk; and a device that stops,
/// which its camera reports within 2 s. The session says so once it has searched what came before.
#[test]
fn a_made_walk_is_calibrated_by_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let (path, truth) = made_bag(folder.path(), usize::MAX);
    let source = format!("{{ kind = \"realsense\", path = {:?} }}", path.display().to_string());
    let served =
        Served::start(folder.path(), &format!("[[camera]]\nname = \"front\"\nsource = {source}\n"));
    let mut events = served.events("", Some("0"));
    let request = json!({"target": truth["target"], "lens": "brown"});
    let started = served.post("/v1/cameras/front/sessions", &request);
    assert_eq!(started.status, 201, "{}", started.text());
    let id = started.json()["id"].as_str().unwrap().to_owned();
    let (mut last_frame, mut silence) = (Instant::now(), Duration::ZERO);
    let mut waits_for = vec!["camera", "session"];
    while !waits_for.is_empty() {
        let event = events.next();
        if event.name == "frame" {
            last_frame = Instant::now();
        }
        if event.data["reason"].as_str().is_some_and(|reason| reason.contains("has ended")) {
            if event.name == "camera" {
                silence = last_frame.elapsed();
            }
            waits_for.retain(|name| *name != event.name);
        }
    }
    assert!(silence < Duration::from_secs(2), "reported {silence:?} after the last frame");
    let camera = served.get("/v1/cameras/front").json();
    assert_eq!(camera["identity"]["serial"], "000000012345", "{camera}");
    assert!(camera["reason"].as_str().unwrap().starts_with("the recording has ended"), "{camera}");
    let session = served.post_nothing(&format!("/v1/sessions/{id}/stop")).json();
    assert_eq!(session["state"], "finished", "{session}");
    let calibration = served
        .get(&format!("/v1/calibrations/{}", session["calibration"].as_str().unwrap()))
        .json();

    let sensors = &calibration["sensors"];
    for sensor in ["infrared", "infrared2"] {
        assert!(sensors[sensor]["lens"].is_object(), "{sensor}: {}", calibration["verdict"]);
    }
    assert!(sensors["depth"].is_object(), "{}", calibration["verdict"]);
    for sensor in ["color", "infrared"] {
        for name in ["fx", "fy", "cx", "cy"] {
            let number = |of: &Value| of[name].as_f64().unwrap();
            let off = number(&sensors[sensor]["lens"]) - number(&truth["sensors"][sensor]["lens"]);
            let sigmas = off.abs() / number(&sensors[sensor]["lens_std"]);
            assert!(
                sigmas < 4.5,
                "{sensor} {name}: off by {off:.3}, {sigmas:.1} standard deviations"
            );
        }
    }
    let found = named(&calibration["extrinsics"], "color_from_depth");
    let truly = named(&truth["extrinsics"], "color_from_depth");
    let distance_m = (translation(found) - translation(truly)).norm();
    let rotation_error_deg = rotation(found).angle_to(&rotation(truly)).to_degrees();
    assert!(
        distance_m < 1e-3 && rotation_error_deg < 0.05,
        "{distance_m} m, {rotation_error_deg}°; {}",
        calibration["verdict"]
    );
    eprintln!(
        "color from depth: off by {:.2} mm and {rotation_error_deg:.4}°; {}",
        distance_m * 1e3,
        calibration["verdict"]
    );
}
