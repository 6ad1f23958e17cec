//! `plumb simulate`: renders a recording, with what is true of it inside and beside it.

pub mod operated;
mod scene;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::cli::{Failure, output, progress};
use crate::document::calibration::ExtrinsicsDocument;
use crate::document::pose::PoseDocument;
use crate::document::reading::{to_json, to_json_pretty};
use crate::document::truth::{
    self, TrueDepthDocument, TrueFrameDocument, TrueSensorDocument, TruthDocument,
};
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::imaging::decode::encode_jpeg;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::imaging::timestamp::{DeviceTime, HostTime};
use crate::recording::McapWriter;
use crate::simulation::{FrameTruth, RgbdFrame, RgbdOptions, RgbdWorld, SimulatedFrame, World};

use scene::SceneFile;

/// When the first frame of every simulated recording was taken: 2026-01-01T00:00:00Z.
const START_UTC_NS: i64 = 1_767_225_600_000_000_000;
/// The camera's name in simulated recordings.
const CAMERA: &str = "front";

/// Renders a recording with exact ground truth beside it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The recording to write; what is true of it goes beside it, with the ending .truth.json
    #[arg(long, value_name = "FILE.mcap", required_unless_present = "operator")]
    out: Option<PathBuf>,
    /// What everything random follows from [default: as the scene says, or 1]
    #[arg(long)]
    seed: Option<u64>,
    /// A scene as TOML: camera, lens, board, walk (recordings/README.md lists the keys)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    operated: operated::OperatedArgs,
    /// Print what is true as JSON
    #[arg(long)]
    json: bool,
}

/// Renders the recording.
///
/// # Errors
/// A usage failure for a scene that cannot be; a failure when a file cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let Some(out) = &args.out else {
        return args.operated.run(args.seed.unwrap_or(1), args.json);
    };
    let scene = SceneFile::load(args.config.as_deref(), args.seed)?;
    let truth = render(&scene, out)?;
    let beside = out.with_extension("truth.json");
    let pretty = to_json_pretty(&truth).map_err(Failure::failed)?;
    std::fs::write(&beside, pretty + "\n").map_err(|error| cannot_write(&beside, &error))?;
    if args.json {
        return output::print_line(&to_json(&truth).map_err(Failure::failed)?);
    }
    let (frames, out) = (truth.frames.len(), out.display());
    output::print_line(&format!("{out}: {frames} frames, their truth in {}", beside.display()))
}

fn render(scene: &SceneFile, out: &Path) -> Result<TruthDocument, Failure> {
    let mut writer = McapWriter::create(out, CAMERA).map_err(Failure::failed)?;
    let mut rendering = Rendering::new(scene);
    let mut frames = Vec::new();
    let bar = progress::bar("rendering", scene.frames as usize);
    for index in 0..scene.frames {
        let (truth, images) = rendering.frame(index);
        writer.write(&frame_set(&truth, images)).map_err(Failure::failed)?;
        frames.push(TrueFrameDocument {
            sequence: index,
            camera_from_board: PoseDocument::from(&truth.camera_from_board),
            motion_px: Some(truth.motion_px).filter(|motion| motion.is_finite()),
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let truth = truth_of(scene, frames);
    writer
        .write_metadata(truth::RECORD, truth.to_record().map_err(Failure::failed)?)
        .map_err(Failure::failed)?;
    writer.finish().map_err(Failure::failed)?;
    Ok(truth)
}

/// The world that is rendered, with one sensor or three.
struct Rendering {
    kind: Kind,
    jpeg_quality: u8,
}

enum Kind {
    Color(Box<World>),
    Rgbd(Box<RgbdWorld>),
}

impl Rendering {
    fn new(scene: &SceneFile) -> Self {
        let kind = match &scene.rgbd {
            Some(rgbd) => Kind::Rgbd(Box::new(RgbdWorld::new(rgbd))),
            None => Kind::Color(Box::new(World::new(&scene.world))),
        };
        Self { kind, jpeg_quality: scene.jpeg_quality }
    }

    fn frame(&mut self, index: u64) -> (FrameTruth, Vec<Frame>) {
        let jpeg = |image: &GrayImage, sensor| {
            file_frame(
                sensor,
                PixelFormat::Jpeg,
                image.size(),
                encode_jpeg(image.view(), self.jpeg_quality),
            )
        };
        match &mut self.kind {
            Kind::Color(world) => {
                let SimulatedFrame { image, truth } = world.frame(index);
                (truth, vec![jpeg(&image, SensorKind::Color)])
            }
            Kind::Rgbd(world) => {
                let RgbdFrame { color, infrared, depth, truth, .. } = world.frame(index);
                let depth =
                    file_frame(SensorKind::Depth, PixelFormat::Png, depth.size(), depth.to_png());
                (
                    truth,
                    vec![
                        jpeg(&color, SensorKind::Color),
                        jpeg(&infrared, SensorKind::Infrared),
                        depth,
                    ],
                )
            }
        }
    }
}

fn file_frame(sensor: SensorKind, format: PixelFormat, size: ImageSize, bytes: Vec<u8>) -> Frame {
    Frame { sensor, size, format, stride: 0, bytes: Arc::from(bytes) }
}

fn frame_set(truth: &FrameTruth, frames: Vec<Frame>) -> FrameSet {
    let since_ns = (truth.time_s * 1e9).round() as i64;
    FrameSet {
        sequence: truth.index,
        host_time: HostTime { utc_ns: START_UTC_NS + since_ns },
        device_time: Some(DeviceTime { monotonic_ns: since_ns }),
        name: None,
        frames,
    }
}

fn truth_of(scene: &SceneFile, frames: Vec<TrueFrameDocument>) -> TruthDocument {
    let sensor = |kind: SensorKind, size: ImageSize, lens: &Lens| {
        let image_size = [size.width, size.height];
        (kind.name().to_owned(), TrueSensorDocument { image_size, lens: lens.into() })
    };
    let color = &scene.world.sensor;
    let mut truth = TruthDocument {
        seed: scene.world.seed,
        target: scene.world.board.into(),
        sensors: BTreeMap::from([sensor(SensorKind::Color, color.size, &color.lens)]),
        extrinsics: Vec::new(),
        frames,
        depth: None,
    };
    if let Some(RgbdOptions { infrared, depth, color_from_depth, time_offset_s, .. }) = &scene.rgbd
    {
        truth.sensors.extend([
            sensor(SensorKind::Infrared, infrared.size, &infrared.lens),
            sensor(SensorKind::Depth, depth.size, &depth.lens),
        ]);
        truth.extrinsics = ["color_from_depth", "color_from_infrared"]
            .map(|name| ExtrinsicsDocument::exact(name, color_from_depth))
            .to_vec();
        truth.depth = Some(TrueDepthDocument {
            unit_m: depth.unit_m,
            scale: depth.error.scale,
            offset: depth.error.offset,
            noise_per_m: depth.noise_per_m,
            step_per_m: depth.step_per_m,
            time_offset_s: *time_offset_s,
        });
    }
    truth
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    Failure::failed(format!("{}: cannot be written: {error}", path.display()))
}
