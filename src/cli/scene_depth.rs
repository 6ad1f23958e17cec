//! What is known about the depth that comes with the images of a scene.

use std::path::Path;

use crate::calibration::solve::rgbd_input::DepthSensor;
use crate::cli::sources::is_recording;
use crate::document::sensors_file::SensorsFile;
use crate::geometry::pixel::ImageSize;
use crate::imaging::depth_encoding::DepthEncoding;
use crate::imaging::factory::FactoryCalibration;
use crate::imaging::frame::SensorKind;
use crate::recording::{ReadOptions, Recording};

/// What the device of all `sources` states about its depth; their images are of `size`. If sources
/// state different things, they are of several devices, and nothing is known about their depth.
///
/// # Errors
/// The reason why a source's statements cannot be read, in one line.
pub(super) fn stated_depth(sources: &[String], size: ImageSize) -> Result<DepthSensor, String> {
    let mut known: Option<DepthSensor> = None;
    for source in sources {
        let Some(factory) = stated_by(source)? else { continue };
        let of_source = depth_sensor(&factory, size);
        if known.as_ref().is_some_and(|known| *known != of_source) {
            return Err("the sources state different depth cameras".to_owned());
        }
        known = Some(of_source);
    }
    Ok(known.unwrap_or_else(|| depth_sensor(&FactoryCalibration::default(), size)))
}

/// What a source states about its sensors; `None` for images, which state nothing.
fn stated_by(source: &str) -> Result<Option<FactoryCalibration>, String> {
    let path = Path::new(source);
    if !path.is_dir() && !is_recording(path) {
        return Ok(None);
    }
    let recording =
        Recording::open(path, &ReadOptions::default()).map_err(|error| error.to_string())?;
    if !matches!(recording, Recording::Folder(_)) {
        return Ok(Some(recording.factory()));
    }
    let Some(file) = SensorsFile::of_folder(path).map_err(|error| error.to_string())? else {
        return Ok(None);
    };
    file.warn_of_unused(path);
    let stated = file.factory(|sensor| recording.image_size(sensor));
    stated.map(Some).map_err(|error| format!("{source}: {error}"))
}

/// In recordings that do not state it, 16-bit depth is in millimeters (ROS REP 118).
fn depth_sensor(factory: &FactoryCalibration, size: ImageSize) -> DepthSensor {
    let DepthEncoding { reading, invalid } =
        factory.depth_encoding.unwrap_or(DepthEncoding::ORDINARY);
    let factory = factory.sensor(SensorKind::Depth).and_then(|stated| stated.depth_lens(size));
    DepthSensor { reading, invalid, factory, with_infrared: false }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::depth_camera::PosedDepthLens;
    use crate::geometry::lens::Lens;
    use crate::geometry::pose::Pose;
    use crate::imaging::frame::{Frame, FrameSet, PixelFormat};
    use crate::imaging::timestamp::HostTime;
    use crate::recording::McapWriter;

    const SIZE: ImageSize = ImageSize::new(4, 2);

    fn lens() -> Lens {
        Lens::pinhole(CameraMatrix { fx: 5.0, fy: 5.0, cx: 2.0, cy: 1.0, skew: 0.0 })
    }

    fn color_from_depth() -> Pose {
        Pose::new(UnitQuaternion::identity(), Vector3::new(0.025, 0.0, 0.0))
    }

    #[test]
    fn a_recording_s_statement_is_read_for_the_size_it_holds_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = McapWriter::create(&path, "front").unwrap();
        writer.write_lens(SensorKind::Depth, SIZE, &lens(), 5).unwrap();
        writer.write_pose(SensorKind::Depth, &color_from_depth(), 5).unwrap();
        let frame = Frame {
            sensor: SensorKind::Depth,
            size: SIZE,
            format: PixelFormat::Depth16,
            stride: 8,
            bytes: [7; 16].as_slice().into(),
        };
        let host_time = HostTime { utc_ns: 9 };
        let (device_time, name, frames) = (None, None, vec![frame]);
        let set = FrameSet { sequence: 0, host_time, device_time, name, frames };
        writer.write(&set).unwrap();
        writer.finish().unwrap();
        let sources = [path.display().to_string()];
        let stated = stated_depth(&sources, SIZE).unwrap();
        let PosedDepthLens { lens: stated_lens, depth_from_color } = stated.factory.unwrap();
        assert_eq!(stated_lens.matrix, lens().matrix);
        assert_eq!(depth_from_color, color_from_depth().inverse());
        assert_eq!(stated.reading, DepthEncoding::ORDINARY.reading);
        let other = stated_depth(&sources, ImageSize::new(8, 4)).unwrap();
        assert_eq!(other.factory, None);
        assert_eq!(stated_depth(&["a.png".to_owned()], SIZE).unwrap().factory, None);
    }

    #[test]
    fn folders_must_state_the_same_camera() {
        let folders = [0.001, 0.001, 0.01].map(|unit_m| {
            let folder = tempfile::tempdir().unwrap();
            for sensor in ["color", "depth"] {
                std::fs::create_dir(folder.path().join(sensor)).unwrap();
                let file = folder.path().join(sensor).join("0.pgm");
                std::fs::write(file, b"P5 1 1 65535\n77").unwrap();
            }
            let text = format!("[depth]\nkind = \"depth\"\nunit_m = {unit_m}\n");
            std::fs::write(folder.path().join("sensors.toml"), text).unwrap();
            folder
        });
        let source = |k: usize| folders[k].path().display().to_string();
        let same = stated_depth(&[source(0), source(1)], SIZE).unwrap();
        assert_eq!(same.reading, DepthEncoding::ORDINARY.reading);
        assert_eq!(same.factory, None);
        let stated_lens = "lens = { model = \"pinhole\", fx = 5.0, fy = 5.0, cx = 2.0, cy = 1.0 }";
        let rotation = "rotation = { w = 1.0, x = 0.0, y = 0.0, z = 0.0 }";
        let text = format!(
            "[depth]\nkind = \"depth\"\nunit_m = 0.001\n{stated_lens}\n[[extrinsics]]\nname = \"color_from_depth\"\n{rotation}\ntranslation = [0.025, 0.0, 0.0]"
        );
        std::fs::write(folders[1].path().join("sensors.toml"), text).unwrap();
        let stated = stated_depth(&[source(1)], ImageSize::new(1, 1)).unwrap();
        let depth_from_color = color_from_depth().inverse();
        assert_eq!(stated.factory, Some(PosedDepthLens { lens: lens(), depth_from_color }));
        let different = stated_depth(&[source(0), source(2)], SIZE).unwrap_err();
        assert!(different.contains("different depth cameras"), "{different}");
        std::fs::remove_file(folders[0].path().join("sensors.toml")).unwrap();
        let missing = stated_depth(&[source(0)], SIZE).unwrap_err();
        assert!(missing.contains("sensors.toml") && !missing.contains('\n'), "{missing}");
    }
}
