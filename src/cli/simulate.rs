//! `plumb simulate`: renders a recording, with what is true of it inside and beside it.

mod scene;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::cli::{Failure, output, progress};
use crate::document::pose::PoseDocument;
use crate::document::reading::{to_json, to_json_pretty};
use crate::document::truth::{self, TrueFrameDocument, TrueSensorDocument, TruthDocument};
use crate::imaging::decode::encode_jpeg;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::timestamp::{DeviceTime, HostTime};
use crate::recording::McapWriter;
use crate::simulation::{FrameTruth, SimulatedFrame, World};

use scene::Scene;

/// When the first frame of every simulated recording was taken: 2026-01-01T00:00:00Z.
const START_UTC_NS: i64 = 1_767_225_600_000_000_000;
/// The camera's name in simulated recordings.
const CAMERA: &str = "front";

/// Render a recording with exact ground truth beside it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The recording to write; what is true of it goes beside it, with the ending .truth.json
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// What everything random follows from [default: as the scene says, or 1]
    #[arg(long)]
    seed: Option<u64>,
    /// A scene as TOML: camera, lens, board, walk (recordings/README.md lists the keys)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print what is true as JSON
    #[arg(long)]
    json: bool,
}

/// Renders the recording.
///
/// # Errors
/// A usage failure for a scene that cannot be; a failure when a file cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let scene = Scene::load(args.config.as_deref(), args.seed)?;
    let truth = render(&scene, &args.out)?;
    let beside = args.out.with_extension("truth.json");
    let pretty = to_json_pretty(&truth).map_err(Failure::failed)?;
    std::fs::write(&beside, pretty + "\n").map_err(|error| cannot_write(&beside, &error))?;
    if args.json {
        return output::print_line(&to_json(&truth).map_err(Failure::failed)?);
    }
    let (frames, out) = (truth.frames.len(), args.out.display());
    output::print_line(&format!("{out}: {frames} frames, their truth in {}", beside.display()))
}

fn render(scene: &Scene, out: &Path) -> Result<TruthDocument, Failure> {
    let mut writer = McapWriter::create(out, CAMERA).map_err(Failure::failed)?;
    let mut world = World::new(&scene.world);
    let mut frames = Vec::new();
    let bar = progress::bar("rendering", scene.frames as usize);
    for index in 0..scene.frames {
        let SimulatedFrame { image, truth } = world.frame(index);
        let set = frame_set(&truth, encode_jpeg(image.view(), scene.jpeg_quality), image.size());
        writer.write(&set).map_err(Failure::failed)?;
        frames.push(TrueFrameDocument {
            sequence: index,
            camera_from_board: PoseDocument::from(&truth.camera_from_board),
            motion_px: Some(truth.motion_px).filter(|motion| motion.is_finite()),
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let sensor = world.sensor();
    let image_size = [sensor.size.width, sensor.size.height];
    let color = TrueSensorDocument { image_size, lens: (&sensor.lens).into() };
    let truth = TruthDocument {
        seed: scene.world.seed,
        target: world.board().into(),
        sensors: BTreeMap::from([(SensorKind::Color.name().to_owned(), color)]),
        extrinsics: Vec::new(),
        frames,
    };
    writer.write_metadata(truth::RECORD, truth.to_record().map_err(Failure::failed)?).map_err(Failure::failed)?;
    writer.finish().map_err(Failure::failed)?;
    Ok(truth)
}

fn frame_set(truth: &FrameTruth, jpeg: Vec<u8>, size: crate::geometry::pixel::ImageSize) -> FrameSet {
    let since_ns = (truth.time_s * 1e9).round() as i64;
    let bytes = Arc::from(jpeg);
    FrameSet {
        sequence: truth.index,
        host_time: HostTime { utc_ns: START_UTC_NS + since_ns },
        device_time: Some(DeviceTime { monotonic_ns: since_ns }),
        name: None,
        frames: vec![Frame { sensor: SensorKind::Color, size, format: PixelFormat::Jpeg, stride: 0, bytes }],
    }
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    Failure::failed(format!("{}: cannot be written: {error}", path.display()))
}
