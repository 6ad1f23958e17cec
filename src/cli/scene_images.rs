//! Images of a static scene, with their features.

use crate::calibration::scene::correspondence::SceneImage;
use crate::cli::in_order::in_order;
use crate::cli::sources::{FrameSets, SourcedFrames, Unreadable};
use crate::cli::{Failure, progress};
use crate::imaging::decode;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;
use crate::imaging::nominal_focal::{NominalFocal, nominal_focal};

/// Images used at most: of more, as of a video, every so manyth is taken.
const MAX_IMAGES: usize = 60;

/// What is read of the images of a scene.
pub(super) struct SceneImages {
    /// The features of every image, in order.
    pub images: Vec<SceneImage>,
    /// The focal length that all files state alike.
    pub nominal_focal: Option<NominalFocal>,
}

/// Finds the features of the images that `frame_sets` gives, called once to count them.
///
/// # Errors
/// When an image cannot be read.
pub(super) fn scene_images<'a>(
    frame_sets: impl Fn() -> FrameSets<'a>,
    threads: usize,
) -> Result<SceneImages, Failure> {
    let step = frame_sets().count().div_ceil(MAX_IMAGES).max(1);
    let (mut images, mut focals) = (Vec::new(), Vec::new());
    let spinner = progress::spinner("finding features");
    in_order(
        frame_sets().step_by(step),
        threads,
        || {
            |frames: Result<SourcedFrames, Unreadable>| {
                let frames = frames.map_err(|unreadable| unreadable.reason)?;
                scene_image(&frames)
            }
        },
        |image| {
            spinner.inc(1);
            let (image, focal) = image.map_err(Failure::failed)?;
            images.push(image);
            focals.push(focal);
            Ok::<(), Failure>(())
        },
    )?;
    spinner.finish_and_clear();
    let alike = focals.windows(2).all(|pair| pair[0] == pair[1]);
    let nominal_focal = focals.first().copied().flatten().filter(|_| alike);
    Ok(SceneImages { images, nominal_focal })
}

fn scene_image(frames: &SourcedFrames) -> Result<(SceneImage, Option<NominalFocal>), String> {
    let name = frames.path();
    let frame = frames
        .set
        .frame(SensorKind::Color)
        .ok_or_else(|| format!("{name}: has no image sensor"))?;
    let mut luma = GrayImage::default();
    decode::luma(frame, &mut luma).map_err(|error| format!("{name}: {error}"))?;
    let focal = nominal_focal(&frame.bytes, luma.size());
    Ok((SceneImage::of(name, luma.view()), focal))
}
