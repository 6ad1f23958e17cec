//! `plumb simulate`: renders a recording, with the ground truth inside and beside it.

pub mod operated;
pub mod operated_outcome;
mod scene;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::calibration::target::CalibrationTarget;
use crate::cli::files::check_not_read;
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
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::{Frame, FrameSet, PixelFormat, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::imaging::timestamp::{DeviceTime, HostTime};
use crate::recording::{McapWriter, RecordingError};
use crate::simulation::{
    FrameTruth, RgbdFrame, RgbdOptions, RgbdWorld, SimulatedFrame, TexturedDepth, TexturedWorld,
    TexturedWorldOptions, World,
};

use scene::SceneFile;

/// The time of the first frame of every simulated recording: 2026-01-01T00:00:00Z.
const START_UTC_NS: i64 = 1_767_225_600_000_000_000;
/// The camera's name in simulated recordings.
const CAMERA: &str = "front";

/// Render a recording with exact ground truth beside it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The recording to write; its ground truth is written beside it as .truth.json
    #[arg(long, value_name = "FILE.mcap", required_unless_present = "operator")]
    out: Option<PathBuf>,
    /// Seed of the random number generator [default: the scene's seed, or 1]
    #[arg(long)]
    seed: Option<u64>,
    /// A scene as TOML: camera, lens, board, walk (recordings/README.md lists the keys)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    operated: operated::OperatedArgs,
    /// Print the ground truth as JSON
    #[arg(long)]
    json: bool,
}

/// Renders the recording.
///
/// # Errors
/// A usage failure for an invalid scene; a failure when a file cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let Some(out) = &args.out else {
        return args.operated.run(args.seed.unwrap_or(1), args.json);
    };
    if let Some(config) = &args.config {
        check_not_read(out, &[config])?;
    }
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
    if let Some(TexturedCamera { depth: Some(_), .. }) = rendering.textured()
        && let Some(rgbd) = &scene.rgbd
    {
        state_depth(&mut writer, rgbd).map_err(Failure::failed)?;
    }
    let bar = progress::bar("rendering", scene.frames as usize);
    for index in 0..scene.frames {
        let (time_s, truth, images) = rendering.frame(index);
        writer.write(&frame_set(index, time_s, images)).map_err(Failure::failed)?;
        frames.push(truth);
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

/// The world to render, with one sensor or three.
struct Rendering {
    kind: Kind,
    jpeg_quality: u8,
}

enum Kind {
    Color(Box<World>),
    Rgbd(Box<RgbdWorld>),
    Textured(Box<TexturedCamera>),
}

/// A camera that moves through a textured world, with or without a depth camera beside it.
struct TexturedCamera {
    world: TexturedWorld,
    depth: Option<TexturedDepth>,
    fps: f64,
}

impl TexturedCamera {
    fn new(options: &TexturedWorldOptions, scene: &SceneFile) -> Self {
        let depth = scene
            .rgbd
            .as_ref()
            .map(|rgbd| TexturedDepth::new(rgbd.depth.clone(), rgbd.color_from_depth));
        Self { world: TexturedWorld::new(options.clone()), depth, fps: scene.world.fps }
    }
}

/// Writes what a device states about its depth sensor, which is the ground truth here.
fn state_depth(writer: &mut McapWriter, rgbd: &RgbdOptions) -> Result<(), RecordingError> {
    let (sensor, depth) = (SensorKind::Depth, &rgbd.depth);
    writer.write_lens(sensor, depth.size, &depth.lens, START_UTC_NS)?;
    writer.write_pose(sensor, &rgbd.color_from_depth, START_UTC_NS)
}

impl Rendering {
    fn new(scene: &SceneFile) -> Self {
        let kind = match (&scene.textured, &scene.rgbd) {
            (Some(options), _) => Kind::Textured(Box::new(TexturedCamera::new(options, scene))),
            (None, Some(rgbd)) => Kind::Rgbd(Box::new(RgbdWorld::new(rgbd))),
            (None, None) => Kind::Color(Box::new(World::new(&scene.world))),
        };
        Self { kind, jpeg_quality: scene.jpeg_quality }
    }

    fn textured(&self) -> Option<&TexturedCamera> {
        match &self.kind {
            Kind::Textured(camera) => Some(camera),
            Kind::Color(_) | Kind::Rgbd(_) => None,
        }
    }

    /// The `index`-th frames, with their time and their ground truth.
    fn frame(&mut self, index: u64) -> (f64, TrueFrameDocument, Vec<Frame>) {
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
                (truth.time_s, before_board(&truth), vec![jpeg(&image, SensorKind::Color)])
            }
            Kind::Rgbd(world) => {
                let RgbdFrame { color, infrared, depth, truth, .. } = world.frame(index);
                let frames = vec![
                    jpeg(&color, SensorKind::Color),
                    jpeg(&infrared, SensorKind::Infrared),
                    depth_frame(&depth),
                ];
                (truth.time_s, before_board(&truth), frames)
            }
            Kind::Textured(camera) => {
                let TexturedCamera { world, depth, fps } = camera.as_ref();
                let place = index as usize;
                let mut frames = vec![jpeg(&world.image(place), SensorKind::Color)];
                frames.extend(depth.as_ref().map(|depth| depth_frame(&depth.image(world, place))));
                let truth = TrueFrameDocument {
                    sequence: index,
                    camera_from_board: None,
                    camera_from_scene: Some(PoseDocument::from(&world.camera_from_world(place))),
                    motion_px: None,
                };
                (index as f64 / fps, truth, frames)
            }
        }
    }
}

/// The ground truth of a frame with a board that moves.
fn before_board(truth: &FrameTruth) -> TrueFrameDocument {
    TrueFrameDocument {
        sequence: truth.index,
        camera_from_board: Some(PoseDocument::from(&truth.camera_from_board)),
        camera_from_scene: None,
        motion_px: Some(truth.motion_px).filter(|motion| motion.is_finite()),
    }
}

fn depth_frame(depth: &DepthImage) -> Frame {
    file_frame(SensorKind::Depth, PixelFormat::Png, depth.size(), depth.to_png())
}

fn file_frame(sensor: SensorKind, format: PixelFormat, size: ImageSize, bytes: Vec<u8>) -> Frame {
    Frame { sensor, size, format, stride: 0, bytes: Arc::from(bytes) }
}

fn frame_set(sequence: u64, time_s: f64, frames: Vec<Frame>) -> FrameSet {
    let since_ns = (time_s * 1e9).round() as i64;
    FrameSet {
        sequence,
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
        target: match scene.textured {
            Some(_) => CalibrationTarget::Scene.into(),
            None => scene.world.board.into(),
        },
        sensors: BTreeMap::from([sensor(SensorKind::Color, color.size, &color.lens)]),
        extrinsics: Vec::new(),
        frames,
        depth: None,
    };
    if let Some(RgbdOptions { infrared, depth, color_from_depth, time_offset_s, .. }) = &scene.rgbd
    {
        truth.sensors.extend([sensor(SensorKind::Depth, depth.size, &depth.lens)]);
        truth.extrinsics.push(ExtrinsicsDocument::exact("color_from_depth", color_from_depth));
        if scene.textured.is_none() {
            truth.sensors.extend([sensor(SensorKind::Infrared, infrared.size, &infrared.lens)]);
            let exact = ExtrinsicsDocument::exact("color_from_infrared", color_from_depth);
            truth.extrinsics.push(exact);
        }
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
