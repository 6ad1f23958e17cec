//! `plumb calibrate`: calibrates from images or a recording.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use crate::calibration::result::CalibratedView;
use crate::calibration::sensor::SensorId;
use crate::calibration::{self, InstrumentObservations, SolveOptions};
use crate::cli::calibrate_rgbd;
use crate::cli::calibration_output::{OutputArgs, named};
use crate::cli::choose::{ChooseArgs, ViewsAndOthers};
use crate::cli::estimated::{EstimatedArgs, check_given};
use crate::cli::gather::gather;
use crate::cli::lens_name::LensName;
use crate::cli::rig::{self, NamedSource, named_source};
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::is_recording;
use crate::cli::target_args::TargetArgs;
use crate::cli::{Failure, progress};
use crate::estimation::camera::CameraOptions;
use crate::geometry::target::Target;
use crate::imaging::frame::SensorKind;

/// Calibrate a camera, an RGB-D camera or a rig from images or recordings of a calibration board.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    search: SearchArgs,
    #[command(flatten)]
    target: TargetArgs,
    /// The lens model to fit.
    #[arg(long, default_value = "auto")]
    lens: LensName,
    /// A camera of a rig, as left=FOLDER_OR_RECORDING, instead of SOURCE; repeat for each camera.
    /// Images of the same name, or recorded frames of the same time, form a frame set.
    #[arg(long, value_name = "NAME=SOURCE", value_parser = named_source)]
    rig: Vec<NamedSource>,
    #[command(flatten)]
    estimated: EstimatedArgs,
    #[command(flatten)]
    choose: ChooseArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// Runs the command.
///
/// # Errors
/// When a source does not exist, the board is in too few images, or they do not determine the lens.
pub fn run(args: &Args) -> Result<(), Failure> {
    args.output.check()?;
    let mut options = CameraOptions { lens: args.lens.into(), ..CameraOptions::default() };
    args.estimated.add_to(&mut options)?;
    let target = args.target.read()?;
    if !args.rig.is_empty() {
        args.choose.refuse("those of a rig")?;
        if !args.search.sources.is_empty() {
            return Err(Failure::usage("give either SOURCE or --rig NAME=SOURCE, not both"));
        }
        let given = args.estimated.lenses();
        let started = Instant::now();
        let calibration =
            rig::calibrate(&args.rig, &args.search, target, &options, given.as_slice())?;
        let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
        return args.output.give(&named(calibration), Some(elapsed_ms));
    }
    args.estimated.check_no_lens()?;
    check_one_camera(&args.search.sources)?;
    if let [source] = args.search.sources.as_slice()
        && calibrate_rgbd::has_depth(source, &args.search.reading)
    {
        args.choose.refuse("color with depth")?;
        let detect = args.search.detect_options();
        let (calibration, elapsed_ms) =
            calibrate_rgbd::calibrate(source, &args.search.reading, target, &options, detect)?;
        return args.output.give(&calibration, Some(elapsed_ms));
    }
    let gathered = gather(&args.search, target)?;
    let target = gathered.target_as_seen();
    solve(args, target, gathered.finish()?, &options)
}

/// Solves the problem and returns the calibration; images that are no views keep their positions.
fn solve(
    args: &Args,
    target: Target,
    images: ViewsAndOthers,
    options: &CameraOptions,
) -> Result<(), Failure> {
    check_given(&options.given, images.0.image_size)?;
    let picked = args.choose.pick(images, &target, options, args.output.is_json())?;
    let Some(((problem, others), options)) = picked else { return Ok(()) };
    let spinner = progress::spinner("solving");
    let observations = InstrumentObservations::of_views(Some(target), problem);
    let options = SolveOptions { camera: options, ..SolveOptions::default() };
    let solved = calibration::solve(&observations, &options);
    spinner.finish_and_clear();
    let mut solved = solved.map_err(|error| {
        let left_out = left_out(&others);
        Failure::failed(format!("{}: {error}{left_out}", args.search.title()))
    })?;
    if let Some(color) = solved.image_mut(&SensorId::own(SensorKind::Color)) {
        for (place, view) in others {
            color.views.insert(place.min(color.views.len()), view);
        }
    }
    args.output.give(&named(solved), None)
}

/// How many images are no views, and the reason of most of them; empty if there are none.
fn left_out(others: &[(usize, CalibratedView)]) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let reasons = others.iter().filter_map(|(_, view)| view.reason.as_deref());
    reasons.for_each(|reason| *counts.entry(reason).or_default() += 1);
    let commonest = counts.into_iter().max_by_key(|(_, count)| *count);
    commonest.map_or_else(String::new, |(reason, count)| {
        format!("; {} images were not used, most often ({count}): {reason}", others.len())
    })
}

/// Several folders or recordings may be of one camera or of several: this is not guessed.
fn check_one_camera(sources: &[String]) -> Result<(), Failure> {
    let whole: Vec<&String> = sources
        .iter()
        .filter(|source| Path::new(source).is_dir() || is_recording(Path::new(source)))
        .collect();
    let [first, second, ..] = whole.as_slice() else { return Ok(()) };
    Err(Failure::usage(format!(
        "{first} and {second}: are these one camera or two? For two cameras use plumb calibrate --rig left={first} --rig right={second}; for one, give its images as a quoted glob: \"{first}/*\""
    )))
}
