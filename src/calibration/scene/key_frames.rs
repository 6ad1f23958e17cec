//! Which frames of a moving camera are worth keeping: those that see the scene from elsewhere, or
//! more of it, or in which much of it is not found again. It depends on the images alone, so that a
//! replay keeps the same ones.

use crate::calibration::admission::Rejection;
use crate::calibration::scene::correspondence::{SceneImage, point_pair};
use crate::calibration::scene::pair_geometry::{is_one_view, scene_geometry};
use crate::calibration::view::FrameFacts;
use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::degeneracy::{TwoViewGeometry, TwoViewKind};
use crate::features::detector::FeatureOptions;
use crate::features::matching::match_descriptors;
use crate::geometry::median::median;

/// The most features of a live frame: what is matched takes the square of it.
pub const LIVE_FEATURES: FeatureOptions = FeatureOptions { max_features: 2000 };

/// The most key frames of a session: a solve matches each with each.
pub const MOST_KEY_FRAMES: usize = 30;

/// Frames with fewer features have nothing to match.
pub const LEAST_FEATURES: usize = 60;

/// The strongest features of two images, which decide whether to keep one of them.
const COMPARED_FEATURES: usize = 800;
/// The strongest features of an image by which the most similar key frame is found.
const PREVIEWED_FEATURES: usize = 250;
/// As many preliminary matches agree by chance.
const LEAST_PREVIEW_MATCHES: usize = 4;
/// The most key frames that an image is compared with beside the last one.
const MOST_COMPARED_FRAMES: usize = 4;

/// New ground: the image has moved by this part of its diagonal in the median. A step sideways by a
/// tenth of the distance to the scene moves it by a tenth of the focal length, which is 0.8
/// diagonals of an ordinary lens.
const STEP_DIAGONALS: f64 = 0.08;
/// Parallax: matches are this part of the diagonal away from where one plane would have them, in
/// the median. Half as much depth as distance gives a quarter of the displacement.
const PARALLAX_DIAGONALS: f64 = 0.02;
/// A camera that moved by less than this part of a key frame's step stands still in a hand, whatever
/// is not found again: blur, noise and what moves in front of it lose features as well. Chosen, not
/// swept.
const STILL_STEP_FRACTION: f64 = 0.1;

/// A frame that a session keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyFrame {
    /// Counts the session's key frames, from 0.
    pub number: u32,
    /// The frame.
    pub frame: FrameFacts,
    /// What it shows.
    pub image: SceneImage,
}

/// Decides whether `image`, which came after `before`, becomes a key frame beside `kept`.
///
/// # Errors
/// The first reason against it.
pub fn admit_key_frame(
    image: &SceneImage,
    before: Option<&SceneImage>,
    kept: &[KeyFrame],
) -> Result<(), Rejection> {
    let features = image.feature_count();
    if features < LEAST_FEATURES {
        return Err(Rejection::NoTexture { features });
    }
    let Some(last) = kept.last() else { return Ok(()) };
    if last.image.size != image.size {
        return Err(Rejection::OtherImageSize { got: image.size, expected: last.image.size });
    }
    let from_last = KeyFrameStep::between(&last.image, image);
    if let Some(step) = &from_last {
        step.check(last.number)?;
    }
    // Back where it was before, or seen from there for the first time after a gap. An image that
    // shows nothing of the last key frame may show something of another.
    let mut similar = most_similar_first(image, kept);
    similar.truncate(if from_last.is_some() { 1 } else { MOST_COMPARED_FRAMES });
    similar.retain(|key| key.number != last.number);
    let step = |key: &KeyFrame| Some((key.number, KeyFrameStep::between(&key.image, image)?));
    match similar.into_iter().find_map(step) {
        Some((view, step)) => step.check(view),
        None if from_last.is_some() => Ok(()),
        None => {
            let matches = before.map_or(0, |before| shared_points(before, image).len());
            Err(Rejection::UnknownScene { matches })
        }
    }
}

/// Where `image` shows what a key frame shows: the matches of their strongest features that agree
/// on the geometry of two views, the key frame's first. Empty where they show nothing together.
pub fn shared_points(key_frame: &SceneImage, image: &SceneImage) -> Vec<PointPair> {
    let pairs = strongest_matches(key_frame, image);
    let features = compared_features(key_frame, image);
    let geometry = scene_geometry(&pairs, features, image.size)
        .map(|found| found.geometry)
        .filter(|found| found.kind != TwoViewKind::Still || is_one_view(found, features));
    geometry.map_or_else(Vec::new, |found| found.inliers.iter().map(|k| pairs[*k]).collect())
}

/// How many features of the image that has fewer are compared.
fn compared_features(first: &SceneImage, second: &SceneImage) -> usize {
    first.feature_count().min(second.feature_count()).min(COMPARED_FEATURES)
}

fn strongest_matches(first: &SceneImage, second: &SceneImage) -> Vec<PointPair> {
    let matches =
        match_descriptors(&first.table(COMPARED_FEATURES), &second.table(COMPARED_FEATURES));
    matches.iter().map(|pair| point_pair(first, second, *pair)).collect()
}

/// What a camera did between two images that show something together, as parts of what makes the
/// later one a key frame.
struct KeyFrameStep {
    /// Displacement and parallax.
    motion: f64,
    /// The part of the compared features that agree on nothing. Around a thing that stays in the
    /// middle of the image it grows where displacement and parallax of other matches do not: all of
    /// them lost is a new view, whatever they say.
    lost: f64,
}

impl KeyFrameStep {
    /// `None` of images that show nothing together.
    fn between(first: &SceneImage, second: &SceneImage) -> Option<Self> {
        let pairs = strongest_matches(first, second);
        let features = compared_features(first, second);
        let geometry = scene_geometry(&pairs, features, second.size)?.geometry;
        if geometry.kind == TwoViewKind::Still {
            let step = Self { motion: 0.0, lost: 0.0 };
            return is_one_view(&geometry, features).then_some(step);
        }
        let diagonal_px = second.size.diagonal_px();
        let motion = geometry.displacement_px / (STEP_DIAGONALS * diagonal_px)
            + parallax_px(&geometry, &pairs) / (PARALLAX_DIAGONALS * diagonal_px);
        let lost = (1.0 - geometry.inliers.len() as f64 / features.max(1) as f64).max(0.0);
        Some(Self { motion, lost })
    }

    /// Refuses a step from key frame `view` that is too small.
    fn check(&self, view: u32) -> Result<(), Rejection> {
        let Self { motion, lost } = *self;
        if motion < STILL_STEP_FRACTION {
            Err(Rejection::TooSimilar { view })
        } else if motion + lost >= 1.0 {
            Ok(())
        } else {
            Err(Rejection::SmallStep { view, part: motion + lost })
        }
    }
}

/// How far matches are from where the best plane has them, in pixels: the median.
fn parallax_px(geometry: &TwoViewGeometry, pairs: &[PointPair]) -> f64 {
    let Some(homography) = &geometry.homography else { return 0.0 };
    let inliers = geometry.inliers.iter().map(|k| &pairs[*k]);
    let away =
        inliers.filter_map(|pair| Some((homography.apply(pair.first)? - pair.second).norm()));
    median(away.collect()).unwrap_or(0.0)
}

/// The key frames that may share something with `image`, by how many of their strongest features
/// it shares, the most first.
fn most_similar_first<'a>(image: &SceneImage, kept: &'a [KeyFrame]) -> Vec<&'a KeyFrame> {
    let table = image.table(PREVIEWED_FEATURES);
    let shared = |key: &KeyFrame| {
        let matches = match_descriptors(&key.image.table(PREVIEWED_FEATURES), &table).len();
        (matches, key.number)
    };
    let mut similar: Vec<_> = kept.iter().map(|key| (shared(key), key)).collect();
    similar.retain(|((matches, _), _)| *matches >= LEAST_PREVIEW_MATCHES);
    similar.sort_by_key(|(shared, _)| std::cmp::Reverse(*shared));
    similar.into_iter().map(|(_, key)| key).collect()
}
