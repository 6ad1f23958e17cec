//! `plumb uncertainty`: the projection uncertainty of a calibration over the image.

use std::path::PathBuf;

use crate::calibration::solve::{UNCERTAINTY_COLUMNS, sensor_uncertainty};
use crate::cli::files::{check_not_read, read_calibration, write_file};
use crate::cli::length::Length;
use crate::cli::{Failure, output};
use crate::document::uncertainty::UncertaintyMapDocument;
use crate::estimation::uncertainty::{Distance, MedianAndWorst, UncertaintyMap};
use crate::imaging::draw::heat_map::{GridValues, ONE_SIGMA_PX, heat_map_png};

/// Report a calibration's projection uncertainty over the image.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The calibration document, as `plumb calibrate --out` and GET /v1/calibrations/{id} give it.
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The sensor: color, infrared, infrared2, or a camera of a rig [default: the first].
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// The distance of the scene, with its unit, as in 2m [default: infinity].
    #[arg(long, value_name = "LENGTH")]
    distance: Option<Length>,
    /// Where to write a heat map with contours, as PNG.
    #[arg(long, value_name = "FILE.png")]
    out: Option<PathBuf>,
    /// Print the uncertainty on a grid of pixels as one JSON document.
    #[arg(long)]
    json: bool,
}

/// Columns of the grid of numbers and of the one of the image, along the image's longer side.
const COLUMNS: [u32; 2] = [UNCERTAINTY_COLUMNS, 49];

/// Runs the command.
///
/// # Errors
/// When the calibration cannot be read, or has no covariance of the sensor.
pub fn run(args: &Args) -> Result<(), Failure> {
    if let Some(out) = &args.out {
        check_not_read(out, &[&args.calibration])?;
    }
    let calibration = read_calibration(&args.calibration)?;
    let file = args.calibration.display();
    let sensors = || {
        let sensors = calibration.image_sensors();
        sensors.map(|(id, sensor)| (calibration.name_of(id), sensor))
    };
    let found = sensors().find(|(name, _)| args.sensor.as_ref().is_none_or(|asked| asked == name));
    let known = || sensors().map(|(name, _)| name).collect::<Vec<_>>().join(", ");
    let unknown =
        || Failure::failed(format!("{file}: there is no such image sensor; it has {}", known()));
    let (name, sensor) = found.ok_or_else(unknown)?;
    let distance =
        args.distance.map_or(Distance::Infinity, |distance| Distance::Meters(distance.meters));
    let none =
        || Failure::failed(format!("{file}: it holds no covariance of {name}; calibrate again"));
    let map = |columns| sensor_uncertainty(sensor, columns, distance).ok_or_else(none);
    if let Some(path) = &args.out {
        let map = map(COLUMNS[1])?;
        let png = heat_map_png(&drawable(&map), ONE_SIGMA_PX);
        write_file(
            path,
            &png.ok_or_else(|| Failure::failed("the heat map cannot be written as PNG"))?,
        )?;
    }
    let map = map(COLUMNS[0])?;
    if args.json {
        return output::print_json(&UncertaintyMapDocument::new(&name, distance, &map));
    }
    let MedianAndWorst { median_px, worst_px } = map.median_and_worst().ok_or_else(none)?;
    let center = map.center().ok_or_else(none)?;
    output::print_line(&format!(
        "{name}: projection uncertainty (1 sigma): {center:.3} px at the center, {median_px:.3} px median, {worst_px:.3} px worst"
    ))
}

fn drawable(map: &UncertaintyMap) -> GridValues<'_> {
    GridValues {
        size: map.grid.size,
        cols: map.grid.cols as usize,
        rows: map.grid.rows as usize,
        values: &map.std_px,
    }
}
