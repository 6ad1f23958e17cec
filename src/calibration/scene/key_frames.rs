//! Which frames of a moving camera are worth keeping: those that see the scene from elsewhere, or
//! more of it. It depends on the images alone, so that a replay keeps the same ones.

use crate::calibration::admission::Rejection;
use crate::calibration::scene::correspondence::{SceneImage, point_pair};
use crate::calibration::view::FrameFacts;
use crate::estimation::two_view::PointPair;
use crate::estimation::two_view::degeneracy::{TwoViewGeometry, TwoViewKind, two_view_geometry};
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
const COMPARED: usize = 800;
/// The strongest features of an image by which the most similar key frame is found.
const PREVIEWED: usize = 250;
/// As many preliminary matches agree by chance.
const LEAST_PREVIEWED: usize = 4;

/// New ground: the image has moved by this part of its diagonal in the median. A step sideways by a
/// tenth of the distance to the scene moves it by a tenth of the focal length, which is 0.8
/// diagonals of an ordinary lens.
const DISPLACED: f64 = 0.08;
/// Parallax: matches are this part of the diagonal away from where one plane would have them, in
/// the median. Half as much depth as distance gives a quarter of the displacement.
const PARALLAX: f64 = 0.02;

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

/// Decides whether `image` becomes a key frame beside `kept`.
///
/// # Errors
/// The first reason against it.
pub fn admit_key_frame(image: &SceneImage, kept: &[KeyFrame]) -> Result<(), Rejection> {
    let features = image.feature_count();
    if features < LEAST_FEATURES {
        return Err(Rejection::NoTexture { features });
    }
    let Some(last) = kept.last() else { return Ok(()) };
    if last.image.size != image.size {
        return Err(Rejection::OtherImageSize { got: image.size, expected: last.image.size });
    }
    let after_last = KeyFrameStep::between(&last.image, image);
    if after_last.is_small() {
        return Err(Rejection::TooSimilar { view: last.number });
    }
    // Back where it was before, or seen from there for the first time after a gap.
    let Some(similar) = most_similar(image, kept).filter(|k| k.number != last.number) else {
        return after_last.known();
    };
    let after_similar = KeyFrameStep::between(&similar.image, image);
    if after_similar.is_small() {
        return Err(Rejection::TooSimilar { view: similar.number });
    }
    after_last.known().or_else(|_| after_similar.known())
}

/// Where `image` shows what a key frame shows: the matches of their strongest features that agree
/// on the geometry of two views, the key frame's first. Empty where they show nothing together.
pub fn shared_points(key_frame: &SceneImage, image: &SceneImage) -> Vec<PointPair> {
    let pairs = strongest_matches(key_frame, image);
    let geometry = two_view_geometry(&pairs, image.size);
    geometry.map_or_else(Vec::new, |found| found.inliers.iter().map(|k| pairs[*k]).collect())
}

fn strongest_matches(first: &SceneImage, second: &SceneImage) -> Vec<PointPair> {
    let matches = match_descriptors(&first.table(COMPARED), &second.table(COMPARED));
    matches.iter().map(|pair| point_pair(first, second, *pair)).collect()
}

/// What a camera did between two images.
struct KeyFrameStep {
    /// Matches that agree.
    matches: usize,
    /// How much the later image adds, 1 for enough; `None` where they show nothing together.
    novelty: Option<f64>,
}

impl KeyFrameStep {
    fn between(first: &SceneImage, second: &SceneImage) -> Self {
        let pairs = strongest_matches(first, second);
        let Some(geometry) = two_view_geometry(&pairs, second.size) else {
            return Self { matches: 0, novelty: None };
        };
        let diagonal_px = second.size.diagonal_px();
        let novelty = match geometry.kind {
            TwoViewKind::Still => 0.0,
            _ => {
                geometry.displacement_px / (DISPLACED * diagonal_px)
                    + parallax_px(&geometry, &pairs) / (PARALLAX * diagonal_px)
            }
        };
        Self { matches: geometry.inliers.len(), novelty: Some(novelty) }
    }

    fn is_small(&self) -> bool {
        self.novelty.is_some_and(|novelty| novelty < 1.0)
    }

    fn known(&self) -> Result<(), Rejection> {
        let Self { matches, novelty } = *self;
        novelty.map(drop).ok_or(Rejection::UnknownScene { matches })
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

/// The key frame that shares most of its strongest features with `image`.
fn most_similar<'a>(image: &SceneImage, kept: &'a [KeyFrame]) -> Option<&'a KeyFrame> {
    let table = image.table(PREVIEWED);
    let shared = |key: &&KeyFrame| {
        let matches = match_descriptors(&key.image.table(PREVIEWED), &table).len();
        (matches, key.number)
    };
    let (best, (matches, _)) =
        kept.iter().map(|key| (key, shared(&key))).max_by_key(|(_, s)| *s)?;
    (matches >= LEAST_PREVIEWED).then_some(best)
}
