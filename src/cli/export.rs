//! `plumb export`: a stored calibration in another program's format.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use clap::builder::PossibleValue;
use serde::Serialize;

use crate::cli::files::{check_not_read, read_calibration, write_file};
use crate::cli::{Failure, output};
use crate::export::other_images::{OtherImages, for_other_images};
use crate::export::{ExportOptions, Exported, Format, export};
use crate::geometry::image_region::ImageRegion;
use crate::geometry::pixel::ImageSize;

/// Convert a stored calibration to another program's format.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration document, as `plumb calibrate --out` and GET /v1/calibrations/{id} give it.
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The format to write.
    #[arg(long)]
    format: Format,
    /// The sensor to export, for formats with a single sensor: color, infrared, infrared2, depth,
    /// or a camera of a rig [default: color]. Stereo formats take two, as in left,right [default:
    /// the two cameras of a rig]; kalibr takes several, in chain order.
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// For ros, ros_stereo and opencv_stereo: free scaling parameter of the rectified image, as in
    /// OpenCV. 0: only valid pixels; 1: all source pixels are retained.
    #[arg(long, default_value_t = 0.0)]
    alpha: f64,
    /// Convert the calibration to images cropped to this region of the original images, in pixels
    /// from the top left, as in 160,120,320,240.
    #[arg(long, value_name = "LEFT,TOP,WIDTH,HEIGHT")]
    crop: Option<ImageRegion>,
    /// Convert the calibration to images scaled to this width (after --crop).
    #[arg(long, value_name = "PIXELS", requires = "height")]
    width: Option<u32>,
    /// Height of the scaled images.
    #[arg(long, value_name = "PIXELS", requires = "width")]
    height: Option<u32>,
    /// Output file [default: standard output]; for ros_stereo, the folder for the two files.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON document that holds the file and what to know about it.
    #[arg(long)]
    json: bool,
}

impl ValueEnum for Format {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()).help(self.description()))
    }
}

#[derive(Debug, Serialize)]
struct ExportedDocument<'a> {
    format: &'a str,
    media_type: &'a str,
    file_name: &'a str,
    note: Option<&'a str>,
    content: &'a str,
}

/// Runs the command.
///
/// # Errors
/// When the calibration cannot be read, or the format cannot represent it.
pub fn run(args: &Args) -> Result<(), Failure> {
    if !(0.0..=1.0).contains(&args.alpha) {
        return Err(Failure::usage(format!("--alpha {}: give a number from 0 to 1", args.alpha)));
    }
    let calibration = read_calibration(&args.calibration)?;
    let in_file =
        |error: &dyn Display| Failure::failed(format!("{}: {error}", args.calibration.display()));
    let size = args.width.zip(args.height).map(|(width, height)| ImageSize::new(width, height));
    // Two names are for a stereo format, and apply to the images of both.
    let sensor = args.sensor.clone().filter(|names| !names.contains(','));
    let other = OtherImages { crop: args.crop, size, sensor };
    let calibration = for_other_images(&calibration, &other).map_err(|error| in_file(&error))?;
    let options = ExportOptions { sensor: args.sensor.clone(), alpha: args.alpha };
    let exported = export(&calibration, args.format, &options).map_err(|error| in_file(&error))?;
    if let Some(note) = &exported.note {
        tracing::warn!("{note}");
    }
    if let Some(path) = &args.out {
        // A JSON document may replace the one that it was made from.
        if args.format != Format::Json {
            check_not_read(path, &[&args.calibration])?;
        }
        write(path, &exported)?;
    }
    match (args.json, &args.out) {
        (true, _) => print_document(args.format, &exported),
        (false, None) => output::print_bytes(&exported.bytes),
        (false, Some(_)) => Ok(()),
    }
}

/// Writes the file, or into the folder if the format has several files.
fn write(path: &Path, exported: &Exported) -> Result<(), Failure> {
    if exported.files.is_empty() {
        return write_file(path, &exported.bytes);
    }
    std::fs::create_dir_all(path).map_err(|error| {
        Failure::failed(format!("{}: cannot be made ({error})", path.display()))
    })?;
    exported.files.iter().try_for_each(|file| write_file(&path.join(&file.file_name), &file.bytes))
}

fn print_document(format: Format, exported: &Exported) -> Result<(), Failure> {
    output::print_json(&ExportedDocument {
        format: format.name(),
        media_type: exported.media_type,
        file_name: &exported.file_name,
        note: exported.note.as_deref(),
        content: &String::from_utf8_lossy(&exported.bytes),
    })
}
