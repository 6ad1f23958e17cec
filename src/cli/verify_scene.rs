//! A calibration against a static scene, without a board: the lens is estimated from the images
//! alone and compared with the calibrated one, where both are uncertain.

use nalgebra::DMatrix;

use crate::calibration::result::ImageCalibration;
use crate::calibration::scene::{SceneOptions, SceneSensor, calibrate_scene};
use crate::cli::scene_images::scene_images;
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::FrameSets;
use crate::cli::verified::{
    CERTAIN_PX, COLUMNS, LEAST_LIMIT_PX, LIMIT_SIGMAS, Verified, same_size,
};
use crate::cli::{Failure, progress};
use crate::estimation::problem::LensChoice;
use crate::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use crate::geometry::median::median;

/// The answer; `file` is what the calibration was read from.
///
/// # Errors
/// When the images cannot be read, are of another size, or do not determine a lens.
pub(super) fn verify_scene(
    (file, sensor): (&str, &ImageCalibration),
    args: &SearchArgs,
) -> Result<Verified, Failure> {
    args.check_sources()?;
    let threads = args.thread_count();
    let frame_sets = || FrameSets::new(args.sources.iter().cloned()).reading(&args.reading);
    let images = scene_images(frame_sets, threads)?.images;
    if let Some(image) = images.first() {
        same_size(image.size, (file, sensor))?;
    }
    let lens = LensChoice::Model(sensor.lens.model());
    let options = SceneOptions { lens, threads, ..SceneOptions::default() };
    let spinner = progress::spinner("solving");
    let solved = calibrate_scene(&images, &options);
    spinner.finish_and_clear();
    let scene = solved.map_err(Failure::failed)?;
    let views = scene.views.iter().filter(|view| view.camera_from_scene.is_some()).count();
    compared(sensor, &scene.sensor, views).ok_or_else(|| {
        Failure::failed("the images leave the lens open: show texture in all of the image")
    })
}

/// The comparison of two lenses, each with its uncertainty; `None` where no projection is known.
fn compared(calibrated: &ImageCalibration, scene: &SceneSensor, views: usize) -> Option<Verified> {
    let grid = PixelGrid::over(scene.image_size, COLUMNS);
    let rows = &scene.lens_covariance;
    let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j]);
    let map = projection_uncertainty(&scene.lens, &covariance, grid, Distance::Infinity)?;
    let seen = projection_difference(&calibrated.lens, &scene.lens, grid, &map.weights);
    let moved_px = median(seen.into_iter().flatten().map(|[x, y]| x.hypot(y)).collect())?;
    let scene_px = LIMIT_SIGMAS * map.median_and_worst()?.0;
    let calibrated_px = LIMIT_SIGMAS * calibrated.uncertainty_px.median;
    let limit_px = scene_px.hypot(calibrated_px).max(LEAST_LIMIT_PX);
    let mut reasons = Vec::new();
    let holds = moved_px <= limit_px;
    if !holds {
        reasons.push(
            "the lens that the scene shows is another one (refocused, zoomed, knocked?): calibrate again"
                .to_owned(),
        );
    }
    if limit_px > CERTAIN_PX {
        let remedy = if scene_px > calibrated_px {
            "give more images, from more places and with texture in all of the image"
        } else {
            "calibrate again with more and more tilted views"
        };
        reasons.push(format!(
            "scene ({scene_px:.1} px) and calibration ({calibrated_px:.1} px) together hide changes of less than {limit_px:.1} px: {remedy}"
        ));
    }
    Some(Verified {
        holds,
        moved_px,
        limit_px,
        visible_px: Some(scene_px),
        rms_px: None,
        best_rms_px: Some(scene.rms_px),
        views,
        depth: None,
        reasons,
    })
}
