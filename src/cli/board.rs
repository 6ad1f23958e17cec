//! `plumb board`: draws a board as measured by a calibration.

use std::path::PathBuf;

use crate::calibration::result::ImageCalibration;
use crate::calibration::rounded::value_with_std;
use crate::cli::files::{check_not_read, image_sensor, read_calibration, write_file};
use crate::cli::{Failure, output};
use crate::document::board_shape::BoardShapeDocument;
use crate::imaging::draw::board_drawing::{BoardOffsets, board_png};

/// Draw the board shape that a calibration measured: heights, and in-plane offsets of the corners.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration document, as `plumb calibrate --out` and GET /v1/calibrations/{id} give it.
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The sensor: color, infrared, infrared2, or a camera of a rig [default: the first with a
    /// measured board].
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// Where to write the image, as PNG.
    #[arg(long, value_name = "FILE.png")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// When the calibration cannot be read, or has measured no board.
pub fn run(args: &Args) -> Result<(), Failure> {
    check_not_read(&args.out, &[&args.calibration])?;
    let calibration = read_calibration(&args.calibration)?;
    let file = args.calibration.display();
    let is_asked = |name: &str| args.sensor.as_ref().is_none_or(|asked| asked == name);
    let measured = |(id, sensor): (_, &ImageCalibration)| {
        let name = calibration.name_of(id);
        is_asked(&name).then(|| sensor.board_shape.clone()).flatten().map(|shape| (name, shape))
    };
    if args.sensor.is_some() {
        image_sensor(&calibration, args.sensor.as_deref(), &file.to_string())?;
    }
    let (name, shape) = calibration.image_sensors().find_map(measured).ok_or_else(|| {
        Failure::failed(format!(
            "{file}: it has no measured board shape, because its views show no deviation from a flat board; calibrate with --board-shape free to estimate it anyway"
        ))
    })?;
    let drawn = BoardShapeDocument::from(&shape);
    let offsets = BoardOffsets { points: &drawn.points, offsets_m: &drawn.offsets_m };
    let png = board_png(offsets)
        .ok_or_else(|| Failure::failed(format!("{file}: its board has no extent to draw")))?;
    write_file(&args.out, &png)?;
    let [rms, std] = [shape.unevenness_m, shape.unevenness_std_m].map(|m| m * 1000.0);
    output::print_line(&format!(
        "{name}: the board is uneven by {} mm (rms)",
        value_with_std(rms, std)
    ))
}
