//! Compares a calibration with a static scene, without a board: the lens is estimated from the
//! images alone and compared with the calibrated one, with the uncertainties of both.

use crate::calibration::result::ImageCalibration;
use crate::calibration::scene::{SceneOptions, calibrate_scene};
use crate::calibration::solve::{UNCERTAINTY_COLUMNS, sensor_uncertainty};
use crate::cli::lens_change::LensChange;
use crate::cli::scene_images::scene_images;
use crate::cli::search_args::SearchArgs;
use crate::cli::sources::FrameSets;
use crate::cli::verified::{CERTAIN_PX, LEAST_LIMIT_PX, LIMIT_SIGMAS, Verified, same_size};
use crate::cli::{Failure, progress};
use crate::estimation::problem::LensChoice;
use crate::estimation::uncertainty::Distance;

/// The result; `file` is the path of the calibration.
///
/// # Errors
/// When the images cannot be read, are of another size, or do not determine a lens.
pub(super) fn verify_scene(
    file: &str,
    sensor: &ImageCalibration,
    args: &SearchArgs,
) -> Result<Verified, Failure> {
    args.check_sources()?;
    let threads = args.thread_count();
    let frame_sets = || FrameSets::new(args.sources.iter().cloned()).reading(&args.reading);
    let images = scene_images(frame_sets, threads)?.images;
    if let Some(image) = images.first() {
        same_size(image.size, file, sensor)?;
    }
    let lens = LensChoice::Model(sensor.lens.model());
    let options = SceneOptions { lens, threads, ..SceneOptions::default() };
    let spinner = progress::spinner("solving");
    let solved = calibrate_scene(&images, &options);
    spinner.finish_and_clear();
    let scene = solved.map_err(Failure::failed)?.into_calibration();
    scene.guide().and_then(|scene| compared(sensor, scene)).ok_or_else(|| {
        Failure::failed(
            "the images do not determine the lens: show texture in all parts of the image",
        )
    })
}

/// The comparison of two lenses, each with its uncertainty; `None` if the projection uncertainty of
/// one is unknown.
fn compared(calibrated: &ImageCalibration, scene: &ImageCalibration) -> Option<Verified> {
    let uncertainty = sensor_uncertainty(scene, UNCERTAINTY_COLUMNS, Distance::Infinity)?;
    let LensChange { seen_px: moved_px, visible_px: scene_px } =
        LensChange::between(&calibrated.lens, &scene.lens, &uncertainty, LIMIT_SIGMAS)?;
    let calibrated_px = LIMIT_SIGMAS * calibrated.uncertainty_px.median;
    let limit_px = scene_px.hypot(calibrated_px).max(LEAST_LIMIT_PX);
    let mut reasons = Vec::new();
    let holds = moved_px <= limit_px;
    if !holds {
        reasons.push(
            "the scene does not fit the calibrated lens, which has changed (refocused, zoomed, knocked?): calibrate again"
                .to_owned(),
        );
    }
    if limit_px > CERTAIN_PX {
        let remedy = if scene_px > calibrated_px {
            "give more images, from more places and with texture in all of the image"
        } else {
            "calibrate again with more views, tilted more strongly"
        };
        reasons.push(format!(
            "lens changes of less than {limit_px:.1} px cannot be detected (uncertainty of the scene's lens {scene_px:.1} px, of the calibration {calibrated_px:.1} px): {remedy}"
        ));
    }
    Some(Verified {
        holds,
        moved_px,
        limit_px,
        visible_px: Some(limit_px),
        rms_px: None,
        best_rms_px: Some(scene.rms_px),
        views: scene.views.iter().filter(|view| view.used).count(),
        depth: None,
        reasons,
    })
}
