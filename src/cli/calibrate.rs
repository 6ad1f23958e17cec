//! `plumb calibrate`: from pictures or a recording to a calibration.

use std::path::Path;

use crate::calibration::solve::solve_views;
use crate::cli::calibrate_rgbd;
use crate::cli::calibration_output::{OutputArgs, finished};
use crate::cli::gather::Gathered;
use crate::cli::in_order::{all_cores, in_order};
use crate::cli::length::Length;
use crate::cli::lens_name::LensName;
use crate::cli::search::searcher;
use crate::cli::sources::FrameSets;
use crate::cli::{Failure, progress};
use crate::detection::board_detection::DetectOptions;
use crate::estimation::camera::CameraOptions;
use crate::geometry::board::{BoardSize, Chessboard};

/// Calibrates a camera from pictures of a chessboard, or from a recording.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Inner corners of the board, COLSxROWS, as in 9x6: where four squares meet, along a row and along a column.
    #[arg(long)]
    board: BoardSize,
    /// The side of one square, with its unit, as in 25mm.
    #[arg(long)]
    square: Length,
    /// The lens model to fit.
    #[arg(long, default_value = "auto")]
    lens: LensName,
    /// Also use pictures in which only part of the board is seen.
    #[arg(long)]
    allow_partial: bool,
    #[command(flatten)]
    output: OutputArgs,
    /// How many pictures to search at once; all cores unless given.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Images, folders of images, quoted globs, or recordings (.mcap).
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// When a source is not there, the board is in too few pictures, or they leave the lens open.
pub fn run(args: &Args) -> Result<(), Failure> {
    let target = Chessboard::new(args.board, args.square.metres).map_err(Failure::usage)?;
    args.output.check()?;
    for source in &args.sources {
        check_there(source)?;
    }
    let detect = DetectOptions { allow_partial: args.allow_partial };
    let options = CameraOptions { lens: args.lens.into(), ..CameraOptions::default() };
    if let [source] = args.sources.as_slice()
        && calibrate_rgbd::has_depth(source)
    {
        return args.output.give(&calibrate_rgbd::calibrate(source, target, &options, detect)?, None);
    }
    let gathered = search(args, target, detect)?;
    let (problem, others) = gathered.finish()?;
    let spinner = progress::spinner("solving");
    let solved = solve_views(&problem, &options);
    spinner.finish_and_clear();
    let mut solved = solved.map_err(|error| Failure::failed(format!("{}: {error}", args.sources.join(" "))))?;
    for (place, view) in others {
        solved.sensor.views.insert(place.min(solved.sensor.views.len()), view);
    }
    let calibration = finished(Some(target), solved);
    args.output.give(&calibration, None)
}

fn search(args: &Args, target: Chessboard, options: DetectOptions) -> Result<Gathered, Failure> {
    let mut gathered = Gathered::new(target);
    let spinner = progress::spinner("searching pictures");
    in_order(
        FrameSets::new(args.sources.iter().cloned()),
        args.threads.map_or_else(all_cores, usize::from),
        || searcher(args.board, options, 1),
        |looked| {
            spinner.inc(1);
            gathered.add(looked)
        },
    )?;
    spinner.finish_and_clear();
    Ok(gathered)
}

/// A mistyped source must not be lost among the pictures that could be read.
fn check_there(source: &str) -> Result<(), Failure> {
    let is_glob = source.contains(['*', '?', '[']);
    if Path::new(source).exists() || is_glob {
        return Ok(());
    }
    Err(Failure::failed(format!("{source}: there is no such file or folder; check the path")))
}
