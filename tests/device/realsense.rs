//! The RealSense library itself, without a camera: recordings, what is wrong with files, and no device.
//! `eval "$(tests/device/realsense_library.sh)" && cargo test --features realsense --test realsense`

#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stderr,
    clippy::excessive_precision,
    reason = "a test program"
)]

#[path = "../system/shared_data.rs"]
mod shared_data;

use std::time::{Duration, Instant};

use plumb::capture::realsense::{Camera, CameraOptions, Origin, list_devices};
use plumb::capture::{CaptureError, FrameSource, SourceOpener};
use plumb::geometry::lens::LensModel;
use plumb::imaging::frame::SensorKind;
use shared_data::shared_data;

const POLL: Duration = Duration::from_millis(200);

fn open(origin: Origin) -> Result<Box<dyn FrameSource>, CaptureError> {
    Camera::new(CameraOptions { origin, ..CameraOptions::default() }).open()
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
fn a_recording_tells_its_factory_calibration_as_the_file_states_it() {
    let Some(folder) = shared_data("realsense-bag") else { return };
    let mut source = open(Origin::Bag(folder.join("single_depth_color_640x480.bag"))).unwrap();
    let description = source.description();
    assert_eq!(description.serial.as_deref(), Some("728612070259"));
    assert_eq!(description.model.as_deref(), Some("Intel RealSense D435"));
    assert!(description.mode.as_ref().is_some_and(|mode| mode.contains("firmware 05.09.14.00")), "{description:?}");
    let depth = description.factory.sensor(SensorKind::Depth).unwrap();
    assert_eq!(depth.depth_unit_m, Some(0.001));
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    assert!(near(depth.stated.focal_px[0], 390.43145752) && near(depth.stated.principal_px[1], 242.18734741));
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
    for (read, stated) in color_from_depth.translation().iter().zip([0.01431131, 0.00060231, 0.00061080]) {
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

#[test]
fn what_is_wrong_with_a_file_is_told_at_once() {
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
fn without_a_device_that_is_told_at_once() {
    assert_eq!(refusal(Origin::OnlyDevice), "the RealSense camera was lost: no RealSense camera is plugged in");
    let error = refusal(Origin::Serial("012345".to_owned()));
    assert!(error.starts_with("012345 was lost: it is not plugged in"), "{error}");
    let listing = list_devices();
    assert!(listing.devices.is_empty());
    assert!(listing.missing.unwrap().contains("the library sees no camera"));
}
