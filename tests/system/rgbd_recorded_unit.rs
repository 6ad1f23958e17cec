//! A recording whose depth is not in millimeters: the unit that it states is used.

use std::path::Path;

use plumb::imaging::depth_encoding::DepthEncoding;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::factory::FactoryCalibration;
use plumb::imaging::frame::SensorKind;
use plumb::imaging::image_file::frame_from_file;
use plumb::recording::{McapWriter, ReadOptions, Recording};
use serde_json::Value;

use crate::program::plumb;
use crate::served::recording;

/// Writes the bundled recording with its depth in units of half a millimeter.
fn in_half_millimeters(to: &Path) {
    let mut from = Recording::open(&recording("rgbd.mcap"), &ReadOptions::default()).unwrap();
    let factory = from.factory();
    let encoding = Some(DepthEncoding::metric(0.0005));
    let factory = FactoryCalibration { depth_encoding: encoding, ..factory };
    let mut writer = McapWriter::create(to, "front").unwrap();
    let mut is_first = true;
    while let Some(mut set) = from.next_frame_set().unwrap() {
        if std::mem::take(&mut is_first) {
            writer.write_factory(&factory, set.host_time.utc_ns).unwrap();
        }
        for frame in set.frames.iter_mut().filter(|frame| frame.sensor == SensorKind::Depth) {
            let depth = DepthImage::from_frame(frame).unwrap();
            let doubled = depth.readings().iter().map(|mm| mm * 2).collect();
            let doubled = DepthImage::new(depth.size(), doubled).unwrap();
            *frame = frame_from_file(SensorKind::Depth, doubled.to_png());
        }
        writer.write(&set).unwrap();
    }
    writer.finish().unwrap();
}

fn calibrated(path: &Path) -> Value {
    let path = path.display().to_string();
    let asked = ["--lens", "brown", "--board", "9x6", "--square", "40mm"];
    let finished = plumb([["calibrate", "--json"].as_slice(), &asked, &[&path]].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    serde_json::from_str(&finished.stdout).unwrap()
}

#[test]
fn the_unit_of_depth_that_a_recording_states_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("half.mcap");
    in_half_millimeters(&path);
    let (ordinary, half) = (calibrated(&recording("rgbd.mcap")), calibrated(&path));
    assert_eq!(half["sensors"]["depth"]["unit_m"], 0.0005, "{half}");
    let close = |at: &str| {
        let of = |document: &Value| document.pointer(at).unwrap().as_f64().unwrap();
        let (ordinary, half) = (of(&ordinary), of(&half));
        assert!(
            (ordinary - half).abs() < 1e-6 * ordinary.abs().max(1.0),
            "{at}: {half} {ordinary}"
        );
    };
    for axis in 0..3 {
        close(&format!("/extrinsics/0/translation/{axis}"));
    }
    close("/sensors/depth/lens/fx");
    assert_eq!(half["extrinsics"].as_array().unwrap().len(), 2, "{half}");
}
