//! `plumb solve`: calibrates from given correspondences.

use std::path::PathBuf;
use std::time::Instant;

use crate::calibration::{InstrumentObservations, SolveOptions, solve};
use crate::cli::Failure;
use crate::cli::calibration_output::{OutputArgs, named};
use crate::cli::estimated::{EstimatedArgs, check_given};
use crate::cli::files::read_document;
use crate::cli::lens_name::LensName;
use crate::document::problem::{Method, ProblemDocument};
use crate::estimation::problem::{CameraProblem, LensChoice};

/// Calibrate a camera from given correspondences of points and pixels.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The lens model to fit [default: the one in PROBLEM.json, or auto].
    #[arg(long)]
    lens: Option<LensName>,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    estimated: EstimatedArgs,
    /// Maximum number of threads. A solve takes milliseconds and uses only one; the result does not
    /// depend on this.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// The problem:
    /// `{"image_size":[w,h],"views":[{"name","object":[[X,Y,Z],…],"image":[[u,v],…]}]}`, meters and
    /// pixels; with "method":"dlt" one view of points that do not lie on a plane.
    #[arg(value_name = "PROBLEM.json")]
    problem: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// When the problem cannot be read, or does not determine a calibration.
pub fn run(args: &Args) -> Result<(), Failure> {
    args.output.check()?;
    let document: ProblemDocument = read_document(&args.problem)?;
    let in_file = |error: &dyn std::fmt::Display| {
        Failure::failed(format!("{}: {error}", args.problem.display()))
    };
    if document.method == Method::Dlt && !(args.lens.is_none() && args.estimated.is_default()) {
        return Err(Failure::usage(
            "the method dlt estimates a pinhole camera with skew from one view: leave out --lens, --skew, --square-pixels, --given, --board-shape and --shutter",
        ));
    }
    let problem = CameraProblem::try_from(&document).map_err(|error| in_file(&error))?;
    let mut options = document.options();
    options.lens = args.lens.map_or(options.lens, LensChoice::from);
    args.estimated.check_no_lens()?;
    args.estimated.add_to(&mut options)?;
    check_given(&options.given, problem.image_size)?;
    let started = Instant::now();
    let method = document.method.into();
    let options = SolveOptions { camera: options, method, ..SolveOptions::default() };
    let observations = InstrumentObservations::of_views(None, problem);
    let solved = solve(&observations, &options).map_err(|error| in_file(&error))?;
    let elapsed_ms = started.elapsed().as_secs_f64() * 1000.0;
    args.output.give(&named(solved), Some(elapsed_ms))
}
