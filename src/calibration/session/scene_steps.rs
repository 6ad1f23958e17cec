//! How a camera moved from image to image in front of a scene: why its key frames are too few.

use crate::calibration::admission::Rejection;
use crate::calibration::scene::correspondence::SceneImage;

/// Frames of another scene that are remembered, the newest.
const COUNTED: usize = 100;
/// Images that show nothing of the key frames are not given as the reason if this many times as
/// many images are too similar to them.
const FEW: u64 = 4;

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
                if self.between_neighbors.len() == COUNTED {
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
    pub(super) fn why_few(&self, similar: u64, unknown: u64) -> String {
        // A person who walks past the camera hides the scene in a few images.
        let unknown = if unknown * FEW < similar { 0 } else { unknown };
        match (similar, unknown) {
            (0, _) => self.why_unknown(),
            (_, 0) if self.has_moved => {
                "the camera moved too little; start again and move it around the scene, or sideways by a tenth of its distance and more".to_owned()
            }
            (_, 0) => {
                "the camera stood still or hardly moved; start again and move it around the scene".to_owned()
            }
            _ => format!(
                "{similar} images are too much like them, {unknown} show nothing of them; {}",
                self.why_unknown()
            ),
        }
    }

    /// Why images share nothing with key frames, and what to do.
    pub(super) fn why_unknown(&self) -> String {
        let mut counts = self.between_neighbors.clone();
        counts.sort_unstable();
        match counts.get(counts.len() / 2) {
            Some(0) => {
                "neighbors share nothing (a median of 0 matches agree): the steps were too large or the texture too little; start again with smaller steps, in front of something with texture".to_owned()
            }
            Some(median) => format!(
                "neighbors share a median of {median} matches: the camera went on to another scene, or around this one by too large steps; start again with smaller steps, and keep one scene in view"
            ),
            None => {
                "the steps were too large for images to share anything; start again with smaller steps".to_owned()
            }
        }
    }
}
