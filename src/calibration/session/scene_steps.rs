//! How a camera moved from image to image in front of a scene: why its key frames are too few.

use crate::calibration::admission::{Rejection, SIZE_CHANGED};
use crate::calibration::scene::correspondence::SceneImage;

/// Frames of another scene that are remembered, the newest.
const REMEMBERED_FRAMES: usize = 100;
/// Images that show nothing of the key frames are not given as the reason if this many times as
/// many images are too similar to them.
const SIMILAR_PER_UNKNOWN: u64 = 4;

/// Why key frames are too few.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum FewKeyFrames {
    /// Hardly an image that could be one.
    #[error("start again and move the camera around the scene")]
    FewImages,
    /// Most images were rejected for their size.
    #[error("{SIZE_CHANGED}")]
    SizeChanged,
    /// Most images have few features.
    #[error(
        "the images have too little texture or are blurred; start again in front of something with texture"
    )]
    NoTexture,
    /// Most images are like a key frame, though the camera moved.
    #[error(
        "the camera moved too little; start again and move it around the scene, or sideways by at least a tenth of the distance to it"
    )]
    SmallSteps,
    /// Most images are like a key frame.
    #[error("the camera stood still or hardly moved; start again and move it around the scene")]
    StoodStill,
    /// Most images share nothing with the key frames.
    #[error(transparent)]
    NothingShared(NothingShared),
    /// Many images are like a key frame, many others share nothing with any.
    #[error(
        "{similar} images are too similar to the key frames, {unknown} share nothing with them; {why}"
    )]
    SimilarAndUnknown { similar: u64, unknown: u64, why: NothingShared },
}

/// Why images share nothing with the key frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum NothingShared {
    /// Nor do they with their neighbors.
    #[error(
        "consecutive images share no inlier matches (median 0): the steps were too large, or there was too little texture; start again with smaller steps, in front of something with texture"
    )]
    UnmatchedNeighbors,
    /// They do with their neighbors: `matches` is the median number of inlier matches.
    #[error(
        "consecutive images share {matches} inlier matches (median): the camera moved on to another scene, or took too large steps around this one; start again with smaller steps, and keep one scene in view"
    )]
    MatchedNeighbors { matches: usize },
    /// No image with a neighbor to compare it with.
    #[error(
        "the steps were too large for images to share anything; start again with smaller steps"
    )]
    Unmeasured,
}

/// The steps of one camera.
#[derive(Debug, Clone, Default)]
pub(super) struct SceneSteps {
    before: Option<SceneImage>,
    /// For the newest frames that showed nothing of the key frames: the number of inlier matches
    /// with the previous frame.
    between_neighbors: Vec<usize>,
    /// A step was too small for a key frame, but larger than the motion of a camera held still.
    has_moved: bool,
}

impl SceneSteps {
    /// The last image.
    pub(super) fn before(&self) -> Option<&SceneImage> {
        self.before.as_ref()
    }

    /// Takes the next image and the decision on it.
    pub(super) fn note(&mut self, image: &SceneImage, admission: &Result<(), Rejection>) {
        self.before = Some(image.clone());
        match admission {
            Err(Rejection::UnknownScene { matches }) => {
                if self.between_neighbors.len() == REMEMBERED_FRAMES {
                    self.between_neighbors.remove(0);
                }
                self.between_neighbors.push(*matches);
            }
            Err(Rejection::SmallStep { .. }) => self.has_moved = true,
            _ => {}
        }
    }

    /// Why there are few key frames, when `similar` images show too little new and `unknown` none
    /// of them.
    pub(super) fn why_few(&self, similar: u64, unknown: u64) -> FewKeyFrames {
        // A person who walks past the camera hides the scene in a few images.
        let unknown = if unknown * SIMILAR_PER_UNKNOWN < similar { 0 } else { unknown };
        match (similar, unknown) {
            (0, _) => FewKeyFrames::NothingShared(self.why_unknown()),
            (_, 0) if self.has_moved => FewKeyFrames::SmallSteps,
            (_, 0) => FewKeyFrames::StoodStill,
            _ => FewKeyFrames::SimilarAndUnknown { similar, unknown, why: self.why_unknown() },
        }
    }

    /// Why images share nothing with key frames, and what to do.
    pub(super) fn why_unknown(&self) -> NothingShared {
        let mut counts = self.between_neighbors.clone();
        counts.sort_unstable();
        match counts.get(counts.len() / 2) {
            Some(0) => NothingShared::UnmatchedNeighbors,
            Some(median) => NothingShared::MatchedNeighbors { matches: *median },
            None => NothingShared::Unmeasured,
        }
    }
}
