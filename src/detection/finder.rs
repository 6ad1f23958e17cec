//! The detector of a target, whatever its kind.

use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::no_target::NoTarget;
use crate::detection::coded::recognition::recognize;
use crate::detection::detector::Detector;
use crate::detection::tracking::TrackedBoard;
use crate::geometry::target::Target;
use crate::imaging::gray::GrayView;

/// Finds one target in images. Its buffers are kept from image to image.
#[derive(Debug)]
pub struct TargetFinder {
    target: Target,
    of_kind: DetectorOfKind,
}

#[derive(Debug)]
enum DetectorOfKind {
    Plain(Box<Detector>),
    Coded(Box<TargetDetector>),
}

/// The same reason with the name of the board that is seen in place of `target`.
fn named(none: NoTarget, image: GrayView<'_>, target: &Target) -> NoTarget {
    if !matches!(none, NoTarget::NoMarkers { .. } | NoTarget::OtherBoard { .. }) {
        return none;
    }
    match recognize(image) {
        Some(seen) => NoTarget::Recognized { seen: seen.to_string(), target: target.to_string() },
        None => none,
    }
}

impl TargetFinder {
    /// A finder of `target`.
    pub fn new(target: &Target) -> Self {
        let of_kind = match TargetDetector::new(*target) {
            Some(coded) => DetectorOfKind::Coded(Box::new(coded)),
            None => DetectorOfKind::Plain(Box::new(Detector::new(target.lattice()))),
        };
        Self { target: *target, of_kind }
    }

    /// The target that is searched for.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// Finds the target in `image`. Part of a board with markers is always answered: they prove
    /// which part.
    ///
    /// # Errors
    /// [`NoBoard`] says why there is none.
    pub fn find(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        match &mut self.of_kind {
            DetectorOfKind::Plain(detector) => detector.find_board(image, options),
            DetectorOfKind::Coded(detector) => {
                let found =
                    detector.find(image).map_err(|none| named(none, image, &self.target))?;
                Ok(found.into_detection(self.target.lattice()))
            }
        }
    }

    /// Finds it where it was in the last image, else anywhere. A board with markers is searched for
    /// each time.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn track(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<TrackedBoard, NoBoard> {
        match &mut self.of_kind {
            DetectorOfKind::Plain(detector) => detector.track_board(image, options),
            DetectorOfKind::Coded(_) => {
                Ok(TrackedBoard { detection: self.find(image, options)?, followed: false })
            }
        }
    }
}
