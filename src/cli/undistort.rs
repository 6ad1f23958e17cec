//! `plumb undistort`: writes images without the lens's distortion.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::files::{image_sensor, read_calibration};
use crate::cli::result_image::{ResultFiles, mapped_png, result_name};
use crate::cli::sources::{FrameSets, SourcedFrames, TopicArgs};
use crate::cli::{Failure, output, progress};
use crate::document::lens::LensDocument;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::ImageSize;
use crate::imaging::frame::SensorKind;
use crate::imaging::undistort::{UndistortOptions, Undistortion};

/// Write undistorted images
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration document, as `plumb calibrate --out` and GET /v1/calibrations/{id} give it
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The folder to write to; created if it does not exist. Results are PNG files with the images'
    /// names
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The camera or sensor that took the images, if the calibration has several
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// 0: the result has only valid pixels; 1: all source pixels are retained
    #[arg(long, default_value_t = 0.0)]
    balance: f64,
    /// Print one JSON document: the lens of an ideal camera that would take the results, and each
    /// image's result
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: TopicArgs,
    /// Images, folders, quoted globs or recordings
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<String>,
}

#[derive(Debug, Serialize)]
struct UndistortionReport {
    image_size: [u32; 2],
    lens: LensDocument,
    seen_fraction: f64,
    written: Vec<UndistortedImage>,
}

#[derive(Debug, Serialize)]
struct UndistortedImage {
    path: String,
    out: String,
}

/// Undistorts every image; failures are reported at the end, after the others.
///
/// # Errors
/// A failure for a calibration that cannot be read, or if any image could not be undistorted.
pub fn run(args: &Args) -> Result<(), Failure> {
    if !(0.0..=1.0).contains(&args.balance) {
        return Err(Failure::usage(format!(
            "--balance {}: give a number from 0 to 1",
            args.balance
        )));
    }
    let calibration = read_calibration(&args.calibration)?;
    let file = args.calibration.display().to_string();
    let (id, sensor) = image_sensor(&calibration, args.sensor.as_deref(), &file)?;
    let options = UndistortOptions { balance: args.balance, size: None };
    let undistortion = Undistortion::new(&sensor.lens, sensor.image_size, &options);
    std::fs::create_dir_all(&args.out).map_err(|error| {
        Failure::failed(format!("{}: cannot be made ({error})", args.out.display()))
    })?;
    let mut written = Vec::new();
    let mut failures = Vec::new();
    let mut files = ResultFiles::of(&args.images);
    let spinner = progress::spinner("undistorting");
    for frames in FrameSets::new(args.images.iter().cloned()).reading(&args.reading) {
        let outcome = match frames {
            Ok(frames) => undistorted(&frames, id.kind, &undistortion, &args.out, &mut files),
            Err(unreadable) => Err(unreadable.reason),
        };
        match outcome {
            Ok(one) => written.push(one),
            Err(line) => failures.push(line),
        }
        spinner.inc(1);
    }
    spinner.finish_and_clear();
    report(
        args,
        &undistortion.lens,
        sensor.image_size,
        undistortion.map.seen_fraction(),
        written,
        &failures,
    )
}

fn report(
    args: &Args,
    lens: &Lens,
    size: ImageSize,
    seen_fraction: f64,
    written: Vec<UndistortedImage>,
    failures: &[String],
) -> Result<(), Failure> {
    let count = written.len();
    if args.json {
        let image_size = [size.width, size.height];
        output::print_json(&UndistortionReport {
            image_size,
            lens: lens.into(),
            seen_fraction,
            written,
        })?;
    } else if count > 0 {
        output::print_line(&format!("{}: {count} undistorted images", args.out.display()))?;
    }
    match failures {
        [] => Ok(()),
        [one] => Err(Failure::failed(one)),
        [first, ..] => {
            let all = failures.len() + count;
            Err(Failure::failed(format!(
                "{} of {all} images could not be undistorted; the first: {first}",
                failures.len()
            )))
        }
    }
}

/// Undistorts one image into `folder`. The error is one line with the reason.
fn undistorted(
    frames: &SourcedFrames,
    sensor: SensorKind,
    undistortion: &Undistortion,
    folder: &Path,
    files: &mut ResultFiles,
) -> Result<UndistortedImage, String> {
    let path = frames.path();
    let in_path = |reason: String| format!("{path}: {reason}");
    let frame = frames.image_of(sensor).map_err(in_path)?;
    let flat = mapped_png(frame, &undistortion.map).map_err(in_path)?.ok_or_else(|| {
        let (size, expected) = (frame.size, undistortion.map.source_size());
        format!("{path}: {size} pixels, but the calibration is for {expected}; give images of the calibrated camera")
    })?;
    let out = folder.join(result_name(frames));
    files.write(&path, &out, &flat)?;
    Ok(UndistortedImage { path, out: out.display().to_string() })
}
