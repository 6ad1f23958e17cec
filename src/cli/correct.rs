//! `plumb correct`: depth images without their systematic error, if requested registered to the
//! color camera.

use std::cell::OnceCell;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::{ImageFormat, RgbImage};
use serde::Serialize;

use crate::calibration::depth_calibration::DepthCalibration;
use crate::calibration::result::{Calibration, ImageCalibration};
use crate::calibration::sensor::SensorId;
use crate::cli::files::read_calibration;
use crate::cli::plane_errors::{BeforeAndAfter, PlaneErrors};
use crate::cli::result_image::ResultFiles;
use crate::cli::sources::{FrameSets, TopicArgs, is_recording};
use crate::cli::{Failure, output, progress};
use crate::geometry::median::median;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::decode;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::{Frame, SensorKind};
use crate::imaging::image_file::frame_from_file;
use crate::imaging::point_cloud::to_ply;
use crate::imaging::registration::DepthRegistration;

/// Write corrected (and registered) depth as 16-bit PNG, and colored point clouds
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration document of a camera with depth, as `plumb calibrate --out` gives it
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// color: register depth to the color image; depth: register color to the depth image, written
    /// beside it as NAME-color.png
    #[arg(long, value_name = "SENSOR", value_parser = ["color", "depth"])]
    register: Option<String>,
    /// Also write the points as NAME.ply, in the color camera's frame, with colors where there is a
    /// color image
    #[arg(long)]
    cloud: bool,
    /// For images in which color shows the calibration board (held still), report the depth error
    /// on the board before and after correction, and draw it as NAME-error.png
    #[arg(long)]
    errors: bool,
    /// Correct and register each image N times; elapsed_ms is the fastest
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeat: u32,
    /// Unit of the written depth images, in meters; a pixel of 0 means no reading
    #[arg(long, value_name = "METRES", default_value_t = 0.001)]
    unit: f64,
    /// The folder to write to; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON document: what was written, and how much of it is outside the calibrated
    /// depth range
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reading: TopicArgs,
    /// Depth images (16-bit PNG or PGM), folders of them, or recordings with depth
    #[arg(required = true, value_name = "DEPTH")]
    depth: Vec<String>,
}

#[derive(Debug, Serialize)]
struct CorrectionReport {
    unit_m: f64,
    registered: Option<String>,
    written: Vec<CorrectedImage>,
}

#[derive(Debug, Serialize)]
struct CorrectedImage {
    path: String,
    out: String,
    readings: usize,
    beyond_calibrated_range: usize,
    too_far_for_unit: usize,
    /// Time of correction and registration alone, without reading and writing.
    elapsed_ms: f64,
    /// The error relative to the board that color sees, if requested and seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    off_board: Option<BeforeAndAfter>,
}

/// A depth image, with the color that comes with it.
struct ColoredDepth {
    depth: DepthImage,
    /// The color image, where it is needed.
    color: Option<RgbImage>,
    /// The same as it came.
    color_frame: Option<Frame>,
}

/// Corrects every depth image; failures are reported at the end, after the others.
///
/// # Errors
/// A failure for a calibration without depth, or if any image could not be corrected.
pub fn run(args: &Args) -> Result<(), Failure> {
    if !(args.unit > 0.0 && args.unit < 1.0) {
        return Err(Failure::usage(format!(
            "--unit {}: give meters per unit, as in 0.001",
            args.unit
        )));
    }
    let calibration = read_calibration(&args.calibration)?;
    let mut corrector = Corrector::new(args, &calibration)?;
    fs::create_dir_all(&args.out).map_err(|error| {
        Failure::failed(format!("{}: cannot be made ({error})", args.out.display()))
    })?;
    let spinner = progress::spinner("correcting");
    let mut give = |path: String, name: String, image: Result<ColoredDepth, String>| {
        spinner.inc(1);
        corrector.give(&path, &name, image);
    };
    for source in &args.depth {
        let place = Path::new(source);
        if place.is_dir() && !place.join("depth").is_dir() && !is_recording(place) {
            for path in images_in(place)? {
                give(path.display().to_string(), stem(&path), read(&path));
            }
        } else if place.is_dir() || is_recording(place) {
            for frames in FrameSets::new(std::iter::once(source.clone())).reading(&args.reading) {
                let frames = frames.map_err(|unreadable| Failure::failed(unreadable.reason))?;
                let Some(depth) = frames.set.frame(SensorKind::Depth) else { continue };
                let (name, color) = (&frames.set.name, frames.set.frame(SensorKind::Color));
                let name = name.clone().unwrap_or_else(|| format!("{:06}", frames.set.sequence));
                give(frames.path(), name, with_color(args, depth, color));
            }
        } else {
            give(source.clone(), stem(place), read(place));
        }
    }
    spinner.finish_and_clear();
    let Corrector { written, failures, .. } = corrector;
    report(args, written, &failures)
}

/// Corrects depth images, one after the other.
struct Corrector<'a> {
    args: &'a Args,
    depth: &'a DepthCalibration,
    color: &'a ImageCalibration,
    color_from_depth: Pose,
    /// Computed for the first image that fits.
    registration: OnceCell<DepthRegistration>,
    plane_errors: Option<PlaneErrors>,
    files: ResultFiles,
    written: Vec<CorrectedImage>,
    failures: Vec<String>,
}

impl<'a> Corrector<'a> {
    /// # Errors
    /// A failure for a calibration that lacks depth, color, or their relative pose.
    fn new(args: &'a Args, calibration: &'a Calibration) -> Result<Self, Failure> {
        let plane_errors = args.errors.then(|| PlaneErrors::new(calibration)).transpose()?;
        let file = args.calibration.display();
        let missing = |what: &str| {
            Failure::failed(format!(
                "{file}: calibrates no {what}; calibrate from a recording with color and depth"
            ))
        };
        let [target, source] = [SensorKind::Color, SensorKind::Depth].map(SensorId::own);
        let depth = calibration.depth().ok_or_else(|| missing("depth sensor"))?;
        let color = calibration.color().ok_or_else(|| missing("color sensor"))?;
        let stated = calibration.pose(&target, &source);
        let stated = stated.ok_or_else(|| missing("color_from_depth"))?;
        Ok(Self {
            args,
            depth,
            color,
            color_from_depth: stated.target_from_source,
            registration: OnceCell::new(),
            plane_errors,
            files: ResultFiles::of(&args.depth),
            written: Vec::new(),
            failures: Vec::new(),
        })
    }

    /// Corrects the image of `path`; `name` is the base name of its files.
    fn give(&mut self, path: &str, name: &str, image: Result<ColoredDepth, String>) {
        match image.and_then(|image| self.corrected(path, name, &image)) {
            Ok(one) => self.written.push(one),
            Err(problem) => self.failures.push(format!("{path}: {problem}")),
        }
    }

    fn corrected(
        &mut self,
        path: &str,
        name: &str,
        seen: &ColoredDepth,
    ) -> Result<CorrectedImage, String> {
        fits(&seen.depth, self.depth.camera.image_size)?;
        let registration = self.registration.get_or_init(|| {
            let color = self.color;
            let camera = &self.depth.camera;
            DepthRegistration::new(camera, &color.lens, color.image_size, &self.color_from_depth)
        });
        let mut write = |name: String, bytes: &[u8]| {
            let out = self.args.out.join(name);
            self.files.write(path, &out, bytes).map(|()| out.display().to_string())
        };
        let color = seen.color.as_ref();
        let image = NamedDepth { path, name, image: &seen.depth, color };
        let mut one = correct(self.args, registration, self.depth.invalid, &image, &mut write)?;
        if let Some((errors, frame)) = self.plane_errors.as_mut().zip(seen.color_frame.as_ref())
            && let Some((off, drawn)) = errors.of(frame, &seen.depth)?
        {
            write(format!("{name}-error.png"), &encode_png(&drawn)?)?;
            one.off_board = Some(off);
        }
        Ok(one)
    }
}

/// A depth image to correct, with its color image if that is needed.
struct NamedDepth<'a> {
    /// Its source, for messages.
    path: &'a str,
    /// The base name of its files.
    name: &'a str,
    image: &'a DepthImage,
    color: Option<&'a RgbImage>,
}

/// `invalid` is the reading that means "no reading", if there is one. `write` takes a file's name
/// and its content.
fn correct(
    args: &Args,
    registration: &DepthRegistration,
    invalid: Option<u16>,
    seen: &NamedDepth<'_>,
    mut write: impl FnMut(String, &[u8]) -> Result<String, String>,
) -> Result<CorrectedImage, String> {
    let NamedDepth { path, name, image, color } = *seen;
    let (mut corrected, elapsed_ms) = timed(args, || match args.register.as_deref() {
        Some("color") => registration.register(image, invalid, args.unit),
        _ => registration.correct(image, invalid, args.unit),
    });
    if needs_color(args) {
        let depths = registration.depths_m(image, invalid);
        if args.cloud {
            write(
                format!("{name}.ply"),
                &to_ply(&registration.points(&depths, color), "meters", "color"),
            )?;
        }
        if args.register.as_deref() == Some("depth") {
            let color = color
                .ok_or("there is no color image with it; give a recording with color and depth")?;
            write(
                format!("{name}-color.png"),
                &encode_png(&registration.color_in_depth(&depths, color))?,
            )?;
        }
    }
    if args.register.as_deref() == Some("color") {
        corrected.beyond = registration.correct(image, invalid, args.unit).beyond;
    }
    Ok(CorrectedImage {
        path: path.to_owned(),
        out: write(format!("{name}.png"), &corrected.image.to_png())?,
        readings: corrected.image.readings().iter().filter(|reading| **reading > 0).count(),
        beyond_calibrated_range: corrected.beyond,
        too_far_for_unit: corrected.overflowed,
        elapsed_ms,
        off_board: None,
    })
}

/// The result of `work`, and the shortest time of its repetitions, in milliseconds.
fn timed<T>(args: &Args, work: impl Fn() -> T) -> (T, f64) {
    let once = || {
        let started = Instant::now();
        let result = work();
        (result, started.elapsed().as_secs_f64() * 1e3)
    };
    let (mut result, mut least) = once();
    for _ in 1..args.repeat {
        let (again, elapsed_ms) = once();
        (result, least) = (again, least.min(elapsed_ms));
    }
    (result, least)
}

fn needs_color(args: &Args) -> bool {
    args.cloud || args.register.as_deref() == Some("depth")
}

fn encode_png(image: &RgbImage) -> Result<Vec<u8>, String> {
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, ImageFormat::Png).map_err(|error| error.to_string())?;
    Ok(file.into_inner())
}

fn report(args: &Args, written: Vec<CorrectedImage>, failures: &[String]) -> Result<(), Failure> {
    let (count, beyond) =
        (written.len(), written.iter().map(|one| one.beyond_calibrated_range).sum::<usize>());
    let too_far: usize = written.iter().map(|one| one.too_far_for_unit).sum();
    let off: Vec<[f64; 2]> =
        written.iter().filter_map(|one| Some(one.off_board?.rms_m())).collect();
    if args.json {
        output::print_json(&CorrectionReport {
            unit_m: args.unit,
            registered: args.register.clone(),
            written,
        })?;
    } else if count > 0 {
        let images = if count == 1 { "image" } else { "images" };
        output::print_line(&format!("{}: {count} corrected depth {images}", args.out.display()))?;
        if beyond > 0 {
            output::print_line(&format!(
                "{beyond} readings are outside the calibrated depth range: the correction at the nearest end of the range was used"
            ))?;
        }
        if too_far > 0 {
            output::print_line(&format!(
                "{too_far} readings exceed the 16-bit range at --unit {} and were left out: give a larger unit",
                args.unit
            ))?;
        }
        if args.errors {
            output::print_line(&off_line(&off))?;
        }
    }
    match failures {
        [] => Ok(()),
        [first, ..] if failures.len() + count > 1 => Err(Failure::failed(format!(
            "{} of {} depth images could not be corrected; the first: {first}",
            failures.len(),
            failures.len() + count
        ))),
        [first, ..] => Err(Failure::failed(first)),
    }
}

/// The medians of all images' rms errors before and after correction, as a line. Medians, because a
/// board that moves between the color and the depth exposure has an error however good the
/// correction is.
fn off_line(off: &[[f64; 2]]) -> String {
    let middle_mm = |k: usize| median(off.iter().map(|one| 1e3 * one[k]).collect());
    match (middle_mm(0), middle_mm(1)) {
        (Some(before), Some(after)) => format!(
            "depth error on the board: {before:.2} mm rms before and {after:.2} mm after, medians over the images (number: {})",
            off.len()
        ),
        _ => "no color image with depth shows the calibration's board: give a recording of it"
            .to_owned(),
    }
}

fn fits(image: &DepthImage, expected: ImageSize) -> Result<(), String> {
    let size = image.size();
    if size == expected {
        return Ok(());
    }
    Err(format!(
        "{size} pixels, but the calibration is for {expected}; give depth of the calibrated camera"
    ))
}

/// The depth image of a file, without color.
fn read(path: &Path) -> Result<ColoredDepth, String> {
    let bytes =
        fs::read(path).map_err(|error| format!("cannot be read ({error}); check the path"))?;
    let depth = decoded(&frame_from_file(SensorKind::Depth, bytes))?;
    Ok(ColoredDepth { depth, color: None, color_frame: None })
}

/// The depth image of a frame set, with its color.
fn with_color(args: &Args, depth: &Frame, color: Option<&Frame>) -> Result<ColoredDepth, String> {
    let depth = decoded(depth)?;
    let needed = color.filter(|_| needs_color(args)).map(decode::rgb).transpose();
    let image = needed.map_err(|error| format!("its color image: {error}"))?;
    Ok(ColoredDepth { depth, color: image, color_frame: color.cloned() })
}

fn decoded(frame: &Frame) -> Result<DepthImage, String> {
    DepthImage::from_frame(frame).map_err(|error| error.to_string())
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn images_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let refused =
        |error| Failure::failed(format!("{}: cannot be read ({error})", folder.display()));
    let entries =
        fs::read_dir(folder).map_err(refused)?.collect::<Result<Vec<_>, _>>().map_err(refused)?;
    let mut paths: Vec<_> = entries
        .into_iter()
        .map(|entry| entry.path())
        .filter(|path| crate::imaging::image_file::is_image(path))
        .collect();
    paths.sort();
    if paths.is_empty() {
        return Err(Failure::failed(format!(
            "{}: no depth images in this folder: it needs 16-bit .png or .pgm files",
            folder.display()
        )));
    }
    Ok(paths)
}
