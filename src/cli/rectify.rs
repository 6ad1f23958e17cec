//! `plumb rectify`: writes images of two cameras with horizontal epipolar lines.

use std::path::PathBuf;

use nalgebra::Matrix4;
use serde::Serialize;

use crate::calibration::result::Calibration;
use crate::calibration::stereo_pair::StereoPair;
use crate::cli::files::read_calibration;
use crate::cli::result_image::{ResultFiles, mapped_png, result_name};
use crate::cli::row_differences::{RowDifferences, differences};
use crate::cli::sources::{FrameSets, SourcedFrames, TopicArgs, Unreadable, files_of};
use crate::cli::target_args::read_target;
use crate::cli::{Failure, output, progress};
use crate::detection::board_detection::{DetectOptions, Detection};
use crate::detection::finder::TargetFinder;
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::rectification::{RectifiedCamera, StereoRectification};
use crate::geometry::target::Target;
use crate::imaging::decode::luma;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;
use crate::imaging::image_file::is_image;
use crate::imaging::rectify::rectifying_maps;
use crate::imaging::remap::{Interpolation, PixelMap};

/// Frames with a larger time difference than this were not taken together, in nanoseconds: half of
/// the interval between frames at 60 a second.
const TOGETHER_NS: i64 = 8_000_000;
/// The side of a square, which does not affect where a board is found.
const ANY_SQUARE_M: f64 = 0.025;

/// Rectify the images of a stereo pair, so that epipolar lines are image rows, and measure the row
/// differences of a board's corners
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration of the rig, as `plumb calibrate --rig … --out FILE` and
    /// GET /v1/rigs/{rig}/calibration give it
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Which two of its cameras, the left (or the upper) one first [default: the rig's two]
    #[arg(long, value_name = "LEFT,RIGHT")]
    cameras: Option<String>,
    /// 0: the results have only valid pixels; 1: all source pixels are retained
    #[arg(long, default_value_t = 0.0)]
    alpha: f64,
    /// The folder to write to, with a folder for each camera in it; created if it does not exist.
    /// Results are PNG files with the images' names
    #[arg(long, value_name = "DIR", default_value = "rectified")]
    out: PathBuf,
    /// The board whose corners measure the row differences: its inner corners, as in 9x6 [default:
    /// the board of the calibration]
    #[arg(long, value_name = "COLSxROWS")]
    board: Option<BoardSize>,
    /// The board as a file: a chessboard, ChArUco board or AprilGrid
    #[arg(long, value_name = "FILE", conflicts_with = "board")]
    target: Option<PathBuf>,
    /// Print one JSON document: the matrices R, P and Q, and each pair with its results and the
    /// differences of its rows
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: TopicArgs,
    /// Images of the left camera: a file, a folder, a quoted glob or a recording
    left: String,
    /// Images of the right camera, taken together with them, in the same order
    right: String,
}

#[derive(Debug, Serialize)]
struct RectificationReport {
    alpha: f64,
    axis: &'static str,
    baseline_m: f64,
    image_size: [u32; 2],
    /// Maps (x, y, disparity, 1) to homogeneous coordinates in the left rectified frame.
    q: [[f64; 4]; 4],
    cameras: [RectifiedCameraReport; 2],
    pairs: Vec<RectifiedImages>,
    /// Over all pairs; null where no board was seen.
    rows: Option<RowDifferences>,
}

#[derive(Debug, Serialize)]
struct RectifiedCameraReport {
    name: String,
    r: [[f64; 3]; 3],
    p: [[f64; 4]; 3],
    /// The fraction of the rectified image that the camera sees.
    seen_fraction: f64,
}

#[derive(Debug, Serialize)]
struct RectifiedImages {
    images: [String; 2],
    out: [String; 2],
    /// Row differences of the board's corners; null if they were not measured.
    rows: Option<RowDifferences>,
    /// Why they were not measured.
    reason: Option<String>,
}

/// If the rows of rectified images differ by more than this, in pixels rms, the images were not
/// taken at the same time by the calibrated pair. Chosen, not swept: the calibrated pairs of
/// opencv-samples give 0.09, with the cameras exchanged 22.7, with other frames 40.3 and more.
const NO_PAIR_PX: f64 = 5.0;

/// Runs the command.
///
/// # Errors
/// When the calibration is not of a stereo pair, an image cannot be read or written, or the images
/// were not taken at the same time by the pair.
pub fn run(args: &Args) -> Result<(), Failure> {
    if !(0.0..=1.0).contains(&args.alpha) {
        return Err(Failure::usage(format!("--alpha {}: give a number from 0 to 1", args.alpha)));
    }
    let calibration = read_calibration(&args.rig)?;
    let board = calibration.target.and_then(|target| target.board());
    let target = target(args, board)?;
    let (pair, stereo) = stereo(args, &calibration)?;
    check_names(args)?;
    let folders = pair.names.each_ref().map(|name| args.out.join(name));
    for folder in &folders {
        std::fs::create_dir_all(folder).map_err(|error| {
            Failure::failed(format!("{}: cannot be made ({error})", folder.display()))
        })?;
    }
    let mut rectifier = Rectifier {
        maps: rectifying_maps(&pair.cameras, &stereo),
        stereo,
        sensors: pair.sensors.each_ref().map(|id| id.kind),
        folders,
        files: ResultFiles::of([&args.left, &args.right]),
        finder: target.as_ref().map(TargetFinder::new),
        all_differences: Vec::new(),
    };
    let mut pairs = Vec::new();
    let spinner = progress::spinner("rectifying");
    let read = |path: &String| FrameSets::new(std::iter::once(path.clone())).reading(&args.reading);
    let (mut left, mut right) = (read(&args.left), read(&args.right));
    while let Some(frames) = taken_together(left.next(), right.next(), args)? {
        pairs.push(rectifier.rectify(&frames).map_err(Failure::failed)?);
        spinner.inc(1);
    }
    spinner.finish_and_clear();
    report(args, &pair, &rectifier, pairs)
}

/// The board for measuring row differences; `None` if none is known.
fn target(args: &Args, calibrated: Option<Target>) -> Result<Option<Target>, Failure> {
    Ok(match (args.board, &args.target) {
        (Some(board), _) => {
            Some(Chessboard::new(board, ANY_SQUARE_M).map_err(Failure::usage)?.into())
        }
        (None, Some(file)) => Some(read_target(file)?),
        (None, None) => calibrated,
    })
}

/// The requested pair, the left camera first, and its rectification.
fn stereo(
    args: &Args,
    calibration: &Calibration,
) -> Result<(StereoPair, StereoRectification), Failure> {
    let in_file =
        |error: &dyn std::fmt::Display| Failure::failed(format!("{}: {error}", args.rig.display()));
    let asked = args.cameras.as_deref().map(|names| {
        let two = names.split_once(',').map(|(first, second)| [first.trim(), second.trim()]);
        two.ok_or_else(|| {
            Failure::usage(format!("--cameras {names}: write two names, as in left,right"))
        })
    });
    let pair = StereoPair::of(calibration, asked.transpose()?).map_err(|error| in_file(&error))?;
    let stereo = pair.rectify(args.alpha).map_err(|error| in_file(&error))?;
    if stereo.second_from_first_m > 0.0 {
        let [first, second] = &pair.names;
        let beyond = if stereo.axis.coordinate() == 0 { "right of" } else { "below" };
        return Err(Failure::usage(format!(
            "{}: `{first}` is {beyond} `{second}`: give --cameras {second},{first} and the images of `{second}` first",
            args.rig.display()
        )));
    }
    Ok((pair, stereo))
}

/// If the images of both cameras have names in common, images with equal names were taken together,
/// and each must have its counterpart.
fn check_names(args: &Args) -> Result<(), Failure> {
    let names = |source: &String| -> Vec<String> {
        let files = files_of(source).into_iter().filter(|file| is_image(file));
        let stem = |file: PathBuf| Some(file.file_stem()?.to_string_lossy().into_owned());
        files.filter_map(stem).collect()
    };
    let (left, right) = (names(&args.left), names(&args.right));
    if left == right || !left.iter().any(|name| right.contains(name)) {
        return Ok(());
    }
    let alone = |of: &[String], other: &[String]| of.iter().find(|n| !other.contains(n)).cloned();
    let (name, source) = match (alone(&left, &right), alone(&right, &left)) {
        (Some(name), _) => (name, &args.right),
        (None, Some(name)) => (name, &args.left),
        (None, None) => return Ok(()),
    };
    Err(Failure::failed(format!(
        "{source} has no image of the name {name}, which the other camera has: give images that were taken together equal names, and leave out those of one camera alone"
    )))
}

/// A frame of each camera, taken together; `None` at the end of both.
fn taken_together(
    left: Option<Result<SourcedFrames, Unreadable>>,
    right: Option<Result<SourcedFrames, Unreadable>>,
    args: &Args,
) -> Result<Option<[SourcedFrames; 2]>, Failure> {
    let frames = match (left, right) {
        (None, None) => return Ok(None),
        (Some(left), Some(right)) => [left, right],
        (left, _) => {
            let (more, less) = match left.is_some() {
                true => (&args.left, &args.right),
                false => (&args.right, &args.left),
            };
            return Err(Failure::failed(format!(
                "{more} has more images than {less}: give as many of each camera, taken together"
            )));
        }
    };
    let [left, right] =
        frames.map(|frames| frames.map_err(|unreadable| Failure::failed(unreadable.reason)));
    let (left, right) = (left?, right?);
    let off_ns = left.set.host_time.utc_ns.abs_diff(right.set.host_time.utc_ns);
    if left.recording.is_some() && right.recording.is_some() && off_ns > TOGETHER_NS.unsigned_abs()
    {
        return Err(Failure::failed(format!(
            "{} and {} were taken {} ms from each other: give recordings of the same time, without gaps",
            left.path(),
            right.path(),
            off_ns / 1_000_000
        )));
    }
    Ok(Some([left, right]))
}

/// Rectifies pair after pair.
struct Rectifier {
    maps: [PixelMap; 2],
    stereo: StereoRectification,
    /// The sensors of the images.
    sensors: [SensorKind; 2],
    folders: [PathBuf; 2],
    files: ResultFiles,
    finder: Option<TargetFinder>,
    all_differences: Vec<f64>,
}

impl Rectifier {
    fn rectify(&mut self, frames: &[SourcedFrames; 2]) -> Result<RectifiedImages, String> {
        let images = frames.each_ref().map(SourcedFrames::path);
        let [left, right] = &self.folders;
        let out = [left.join(result_name(&frames[0])), right.join(result_name(&frames[1]))];
        let mut gray = Vec::new();
        for (k, out) in out.iter().enumerate() {
            let (image, file) = rectified(&frames[k], self.sensors[k], &self.maps[k])?;
            self.files.write(&images[k], out, &file)?;
            gray.push(image);
        }
        let measured = self.differences(&gray);
        self.all_differences.extend(measured.iter().flatten());
        Ok(RectifiedImages {
            images,
            out: out.map(|path| path.display().to_string()),
            rows: measured.as_ref().ok().and_then(|all| RowDifferences::of(all)),
            reason: measured.err(),
        })
    }

    /// The row differences of a board's corners, or the reason why there are none.
    fn differences(&mut self, gray: &[GrayImage]) -> Result<Vec<f64>, String> {
        let finder = self
            .finder
            .as_mut()
            .ok_or("no board is given to measure row differences with: give --board or --target")?;
        let options = DetectOptions { allow_partial: true };
        let mut found: Vec<Detection> = Vec::new();
        for (image, which) in gray.iter().zip(["left", "right"]) {
            let detection = finder.find(image.view(), &options);
            found.push(detection.map_err(|no_board| format!("the {which} image: {no_board}"))?);
        }
        let [left, right] = found.as_slice() else { return Err("no pair".to_owned()) };
        differences([left, right], self.stereo.axis).map_err(str::to_owned)
    }
}

/// One rectified image: its luma, and the file.
fn rectified(
    frames: &SourcedFrames,
    sensor: SensorKind,
    map: &PixelMap,
) -> Result<(GrayImage, Vec<u8>), String> {
    let path = frames.path();
    let in_path = |reason: String| format!("{path}: {reason}");
    let frame = frames.image_of(sensor).map_err(in_path)?;
    let other_size = || {
        format!(
            "{path}: {} pixels, but the calibration is for {}; give images of the calibrated cameras, the left one's first",
            frame.size,
            map.source_size()
        )
    };
    let mut source = GrayImage::default();
    luma(frame, &mut source).map_err(|error| in_path(error.to_string()))?;
    let gray = map.gray(source.view(), Interpolation::Bicubic).ok_or_else(other_size)?;
    let file = mapped_png(frame, map).map_err(in_path)?.ok_or_else(other_size)?;
    Ok((gray, file))
}

fn report(
    args: &Args,
    pair: &StereoPair,
    rectifier: &Rectifier,
    pairs: Vec<RectifiedImages>,
) -> Result<(), Failure> {
    let Rectifier { maps, stereo, all_differences, .. } = rectifier;
    let rows = RowDifferences::of(all_differences);
    if args.json {
        let camera = |k: usize| {
            let RectifiedCamera { rectified_from_camera: r, projection: p } = &stereo.cameras[k];
            RectifiedCameraReport {
                name: pair.names[k].clone(),
                r: std::array::from_fn(|row| std::array::from_fn(|col| r[(row, col)])),
                p: std::array::from_fn(|row| std::array::from_fn(|col| p[(row, col)])),
                seen_fraction: maps[k].seen_fraction(),
            }
        };
        let q: Matrix4<f64> = stereo.point_from_disparity();
        return output::print_json(&RectificationReport {
            alpha: args.alpha,
            axis: stereo.axis.name(),
            baseline_m: stereo.second_from_first_m.abs(),
            image_size: [stereo.image_size.width, stereo.image_size.height],
            q: std::array::from_fn(|row| std::array::from_fn(|col| q[(row, col)])),
            cameras: [camera(0), camera(1)],
            pairs,
            rows,
        });
    }
    let lines = stereo.axis.lines();
    let words = |rows: &RowDifferences| {
        let RowDifferences { corners, rms_px, worst_px, .. } = rows;
        format!(
            "{lines} of {corners} corners differ by {rms_px:.3} px rms, {worst_px:.3} px at worst"
        )
    };
    for RectifiedImages { images, rows, reason, .. } in &pairs {
        let measured = rows.as_ref().map(words);
        let reason = reason.as_deref().unwrap_or_default();
        let measured = measured.unwrap_or_else(|| format!("{lines} not measured: {reason}"));
        output::print_line(&format!("{}, {}: {measured}", images[0], images[1]))?;
    }
    let all = rows.as_ref().map_or_else(|| format!("{lines} not measured"), words);
    let count = pairs.len();
    output::print_line(&format!("{}: {count} rectified pairs; {all}", args.out.display()))?;
    match rows.filter(|rows| rows.rms_px > NO_PAIR_PX) {
        Some(RowDifferences { rms_px, .. }) => Err(Failure::failed(format!(
            "{lines} differ by {rms_px:.2} px rms, more than the {NO_PAIR_PX} px of any stereo pair: check that the images are of this rig, taken at the same time, and that the left camera comes first"
        ))),
        None => Ok(()),
    }
}
