//! Images of a static scene with their features, and the depth images that were taken with them.

use std::sync::Arc;

use crate::calibration::scene::correspondence::SceneImage;
use crate::cli::in_order::in_order;
use crate::cli::search::warn_of_rotation;
use crate::cli::sources::{FrameSets, SourcedFrames, Unreadable};
use crate::cli::{Failure, progress};
use crate::imaging::decode;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::frame::SensorKind;
use crate::imaging::gray::GrayImage;
use crate::imaging::nominal_focal::{NominalFocal, nominal_focal};
use crate::imaging::stated_camera::{stated_camera, states_rotation};

/// The most images that are used: of more, as in a video, an evenly spaced selection is taken.
const MAX_IMAGES: usize = 60;

/// The images of a scene.
pub(super) struct SceneImages {
    /// The features of every image, in order.
    pub images: Vec<SceneImage>,
    /// The depth image taken with each; `None` where there is none.
    pub depth: Vec<Option<Arc<DepthImage>>>,
    /// The focal length stated by the files, if all state the same.
    pub nominal_focal: Option<NominalFocal>,
}

/// One image.
struct ReadImage {
    image: SceneImage,
    depth: Option<Arc<DepthImage>>,
    nominal_focal: Option<NominalFocal>,
    states_rotation: bool,
}

/// Finds the features of the images that `frame_sets` returns; it is called once to count them.
/// Frame sets without an image, as from sensors that are not taken together, are skipped unless
/// none has one.
///
/// # Errors
/// When an image or a depth image cannot be read.
pub(super) fn scene_images<'a>(
    frame_sets: impl Fn() -> FrameSets<'a>,
    threads: usize,
) -> Result<SceneImages, Failure> {
    let has_image = |frames: &Result<SourcedFrames, Unreadable>| {
        frames.as_ref().map_or(true, |frames| frames.set.frame(SensorKind::Color).is_some())
    };
    let count = frame_sets().filter(has_image).count();
    let is_taken = |frames: &Result<SourcedFrames, Unreadable>| count == 0 || has_image(frames);
    if count > MAX_IMAGES {
        tracing::warn!("{count} images given: {MAX_IMAGES} of them are used, evenly spaced");
    }
    // An image is taken where the rounded number of images taken grows.
    let is_chosen = |place: usize| {
        count <= MAX_IMAGES || (place + 1) * MAX_IMAGES / count > place * MAX_IMAGES / count
    };
    let (mut images, mut depth, mut focals) = (Vec::new(), Vec::new(), Vec::new());
    let mut rotated = 0;
    let spinner = progress::spinner("finding features");
    in_order(
        frame_sets()
            .filter(is_taken)
            .enumerate()
            .filter_map(|(place, frames)| is_chosen(place).then_some(frames)),
        threads,
        || {
            |frames: Result<SourcedFrames, Unreadable>| {
                let frames = frames.map_err(|unreadable| unreadable.reason)?;
                scene_image(&frames)
            }
        },
        |image| {
            spinner.inc(1);
            let read = image.map_err(Failure::failed)?;
            images.push(read.image);
            depth.push(read.depth);
            focals.push(read.nominal_focal);
            rotated += usize::from(read.states_rotation);
            Ok::<(), Failure>(())
        },
    )?;
    spinner.finish_and_clear();
    warn_of_rotation(rotated, images.len());
    let alike = focals.windows(2).all(|pair| pair[0] == pair[1]);
    let nominal_focal = focals.first().copied().flatten().filter(|_| alike);
    Ok(SceneImages { images, depth, nominal_focal })
}

fn scene_image(frames: &SourcedFrames) -> Result<ReadImage, String> {
    let name = frames.path();
    let frame = frames
        .set
        .frame(SensorKind::Color)
        .ok_or_else(|| format!("{name}: {}", frames.no_image()))?;
    let mut luma = GrayImage::default();
    decode::luma(frame, &mut luma).map_err(|error| format!("{name}: {error}"))?;
    let depth = frames.set.frame(SensorKind::Depth).map(DepthImage::from_frame).transpose();
    let depth = depth.map_err(|error| format!("{name}: depth: {error}"))?;
    let nominal_focal = nominal_focal(&frame.bytes, luma.size());
    let mut image = SceneImage::of(name, luma.view());
    image.stated = stated_camera(&frame.bytes);
    let states_rotation = states_rotation(&frame.bytes);
    Ok(ReadImage { image, depth: depth.map(Arc::new), nominal_focal, states_rotation })
}
