//! `plumb autocalibrate`: calibrates from images of a static scene, without a target.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use crate::calibration::result::SceneScale;
use crate::calibration::scene::{SceneCalibration, SceneDepth, SceneOptions, calibrate_scene};
use crate::cli::calibration_output::named;
use crate::cli::estimated::{check_given, parameter};
use crate::cli::files::{check_no_image, write_file};
use crate::cli::in_order::all_cores;
use crate::cli::lens_name::SceneLensName;
use crate::cli::scene_depth::stated_depth;
use crate::cli::scene_images::{SceneImages, scene_images};
use crate::cli::search_args::check_sources;
use crate::cli::sources::FrameSets;
use crate::cli::{Failure, output, progress};
use crate::document::calibration::CalibrationDocument;
use crate::estimation::problem::GivenParameter;
use crate::export::colmap_scene::{ColmapScene, colmap_scene};
use crate::geometry::lens::Lens;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::point_cloud::{CloudPoint, to_ply};

/// Calibrate a camera from images of a static scene, without a target.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The lens model to fit.
    #[arg(long, default_value = "auto")]
    lens: SceneLensName,
    /// Hold a lens parameter fixed, as in fx=600. May be repeated.
    #[arg(long, value_name = "NAME=VALUE", value_parser = parameter)]
    given: Vec<GivenParameter>,
    /// Number of threads [default: all cores]; the result does not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Print the calibration as one JSON document.
    #[arg(long)]
    json: bool,
    /// Write the calibration document to FILE.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write the scene's points to FILE (PLY).
    #[arg(long, value_name = "FILE.ply")]
    points: Option<PathBuf>,
    /// Write COLMAP's cameras.txt, images.txt and points3D.txt to DIR, which is created if it does
    /// not exist.
    #[arg(long, value_name = "DIR")]
    colmap: Option<PathBuf>,
    /// Images, folders of images, quoted globs, or recordings (.mcap, ROS bags); with depth beside
    /// color, lengths are in meters.
    #[arg(required = true, value_name = "SOURCE")]
    sources: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// When an image cannot be read, or the images do not determine the lens.
pub fn run(args: &Args) -> Result<(), Failure> {
    let threads = args.threads.map_or_else(all_cores, usize::from);
    let started = Instant::now();
    check_sources(&args.sources)?;
    for (option, file) in [("--out", &args.out), ("--points", &args.points)] {
        file.as_deref().map_or(Ok(()), |file| check_no_image(option, file))?;
    }
    if args.out.is_some() && args.out == args.points {
        return Err(Failure::usage("--out and --points name the same file: choose two names"));
    }
    for (k, parameter) in args.given.iter().enumerate() {
        if args.given[..k].iter().any(|earlier| earlier.name == parameter.name) {
            return Err(Failure::usage(format!(
                "--given {} twice: give one value",
                parameter.name
            )));
        }
    }
    let frame_sets = || FrameSets::new(args.sources.iter().cloned());
    let SceneImages { images, depth, nominal_focal } = scene_images(frame_sets, threads)?;
    if let Some(image) = images.first() {
        check_given(&args.given, image.size)?;
    }
    let options = SceneOptions {
        lens: args.lens.into(),
        given: args.given.clone(),
        nominal_focal,
        threads,
        ..SceneOptions::default()
    };
    let spinner = progress::spinner("solving");
    let solved = calibrate_scene(&images, &options);
    spinner.finish_and_clear();
    let calibration = with_unit(solved.map_err(Failure::failed)?, depth, &args.sources);
    let document = CalibrationDocument {
        elapsed_ms: Some(started.elapsed().as_secs_f64() * 1000.0),
        ..CalibrationDocument::from(&named(calibration.clone().into_calibration()))
    };
    if let Some(path) = &args.out {
        let json = serde_json::to_string_pretty(&document).map_err(Failure::failed)? + "\n";
        write_file(path, json.as_bytes())?;
    }
    if let Some(path) = &args.points {
        let units = match calibration.scale {
            Some(_) => "meters",
            None => "units of the greatest distance between two cameras",
        };
        write_file(path, &to_ply(&cloud(&calibration), units, "scene"))?;
    }
    if let Some(folder) = &args.colmap {
        write_colmap(folder, &calibration)?;
    }
    if args.json {
        output::print_json(&document)
    } else {
        output::print_text(&summary(&calibration))
    }
}

/// The calibration with lengths in meters, if the depth images that came with the images determine
/// the scale. If there are depth images that do not, the reason is added.
fn with_unit(
    mut calibration: SceneCalibration,
    depth: Vec<Option<Arc<DepthImage>>>,
    sources: &[String],
) -> SceneCalibration {
    let Some(size) = depth.iter().flatten().map(|image| image.size()).next() else {
        return calibration;
    };
    match stated_depth(sources, size) {
        Ok(sensor) => calibration.in_meters(&SceneDepth { sensor, images: depth }),
        Err(reason) => {
            calibration.verdict.reasons.push(format!("lengths have no unit: {reason}"));
            calibration
        }
    }
}

fn cloud(calibration: &SceneCalibration) -> Vec<CloudPoint> {
    let point = |point: &crate::calibration::scene::ScenePoint| CloudPoint {
        point_m: [point.point.x as f32, point.point.y as f32, point.point.z as f32],
        color: [128; 3],
    };
    calibration.points.iter().map(point).collect()
}

fn write_colmap(folder: &Path, calibration: &SceneCalibration) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(|error| {
        Failure::failed(format!("{}: cannot be made ({error})", folder.display()))
    })?;
    let ColmapScene { files, note } = colmap_scene(calibration).map_err(Failure::failed)?;
    for (name, text) in files {
        write_file(&folder.join(name), text.as_bytes())?;
    }
    if let Some(note) = note {
        tracing::warn!("{}: {note}", folder.display());
    }
    Ok(())
}

/// The most important results, in readable form.
fn summary(calibration: &SceneCalibration) -> String {
    let (sensor, verdict) = (&calibration.sensor, &calibration.verdict);
    let used = calibration.views.iter().filter(|view| view.camera_from_scene.is_some()).count();
    let mut lines = vec![
        format!("color: {} lens for {} images", sensor.lens.model(), sensor.image_size),
        format!(
            "  images: {used} of {} used, {} points, rms {:.4} px",
            calibration.views.len(),
            calibration.points.len(),
            sensor.rms_px
        ),
    ];
    let names = Lens::parameter_names(sensor.lens.model());
    for ((name, value), std) in names.iter().zip(sensor.lens.parameters()).zip(&sensor.lens_std) {
        if *std > 0.0 || value != 0.0 {
            let held =
                if calibration.held_by_prior.contains(name) { " (by the prior)" } else { "" };
            lines.push(format!("  {name:4} {value:>14.6} ± {std:.6}{held}"));
        }
    }
    for view in calibration.views.iter().filter(|view| view.camera_from_scene.is_none()) {
        let reason = view.reason.as_deref().unwrap_or("no reason given");
        lines.push(format!("  not used: {}: {reason}", view.name));
    }
    if let Some(SceneScale { relative_std, readings, views }) = calibration.scale {
        lines.push(format!(
            "  lengths in meters, from depth: ± {:.2} % ({readings} readings in {views} images)",
            100.0 * relative_std
        ));
    }
    lines.push(format!("verdict: {}", verdict.grade.name()));
    lines.extend(verdict.reasons.iter().map(|reason| format!("  {reason}")));
    lines.join("\n") + "\n"
}
