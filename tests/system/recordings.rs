//! The recordings that the project ships: small enough, whole, and made from their scenes to the
//! byte.

use std::fs;
use std::path::{Path, PathBuf};

use plumb::document::truth::{RECORD, TruthDocument};
use plumb::imaging::decode;
use plumb::imaging::depth_image::DepthImage;
use plumb::imaging::frame::{FrameSet, SensorKind};
use plumb::imaging::gray::GrayImage;
use plumb::recording::{ReadOptions, Recording, metadata};

fn recordings() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings")
}

fn frame_sets(path: &Path) -> Vec<FrameSet> {
    let mut recording = Recording::open(path, &ReadOptions::default()).unwrap();
    let announced = recording.frame_set_count();
    let mut sets = Vec::new();
    while let Some(set) = recording.next_frame_set().unwrap() {
        sets.push(set);
    }
    assert_eq!(announced, Some(sets.len()));
    sets
}

#[test]
fn every_recording_is_whole_small_and_has_its_truth() {
    let megabytes = |name: &str| fs::metadata(recordings().join(name)).unwrap().len() as f64 / 1e6;
    assert!(megabytes("walk.mcap") + megabytes("hard.mcap") < 8.0);
    assert!(megabytes("rgbd.mcap") < 12.0);
    assert!(megabytes("room.mcap") < 4.0);
    for (name, sensors) in [("walk.mcap", 1), ("hard.mcap", 1), ("rgbd.mcap", 3), ("room.mcap", 2)]
    {
        let path = recordings().join(name);
        let sets = frame_sets(&path);
        let record = metadata(&path, RECORD).unwrap().unwrap();
        let truth = TruthDocument::from_record(&record).unwrap();
        assert_eq!((truth.frames.len(), truth.sensors.len()), (sets.len(), sensors), "{name}");
        let mut luma = GrayImage::default();
        for (set, frame) in sets.iter().zip(&truth.frames) {
            assert_eq!((set.sequence, set.frames.len()), (frame.sequence, sensors), "{name}");
            for frame in &set.frames {
                let decoded = match frame.sensor {
                    SensorKind::Depth => DepthImage::from_frame(frame).unwrap().size(),
                    _ => {
                        decode::luma(frame, &mut luma).unwrap();
                        luma.size()
                    }
                };
                assert_eq!(decoded, frame.size);
            }
        }
    }
}

#[test]
fn a_scene_gives_its_recording_to_the_byte() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["walk", "hard", "rgbd", "room"] {
        let scene = fs::read_to_string(recordings().join(format!("{name}.toml"))).unwrap();
        let short: Vec<&str> = scene
            .lines()
            .map(|line| if line.starts_with("frames") { "frames = 2" } else { line })
            .collect();
        let (config, out) =
            (folder.path().join("scene.toml"), folder.path().join(format!("{name}.mcap")));
        fs::write(&config, short.join("\n")).unwrap();
        let arguments =
            ["simulate", "--config", config.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let done = std::process::Command::new(env!("CARGO_BIN_EXE_plumb"))
            .args(arguments)
            .output()
            .unwrap();
        assert!(done.status.success(), "{done:?}");
        let shipped = frame_sets(&recordings().join(format!("{name}.mcap")));
        let again = frame_sets(&out);
        assert_eq!(again.len(), 2, "{name}");
        for (again, shipped) in again.iter().zip(shipped) {
            assert_eq!(
                format!("{:?}", again.frames),
                format!("{:?}", shipped.frames),
                "{name} #{}",
                again.sequence
            );
        }
    }
}
