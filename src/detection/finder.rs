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
    other: OtherBoard,
}

#[derive(Debug)]
enum DetectorOfKind {
    Plain(Box<Detector>),
    Coded(Box<TargetDetector>),
}

/// Frames of a sequence from one recognition of another board to the next: it takes several times
/// as long as a search, and what is held before a camera stays for a second.
const RECOGNIZED_EVERY: u32 = 30;

/// Which other board is seen in a sequence of images.
#[derive(Debug, Default)]
struct OtherBoard {
    /// Its name, as it was recognized last.
    seen: Option<String>,
    /// Frames until it is recognized again.
    frames_left: u32,
}

impl OtherBoard {
    /// The same reason, with the name of the board that is seen in place of `target`.
    fn named(&mut self, none: NoTarget, image: GrayView<'_>, target: &Target) -> NoTarget {
        if !matches!(none, NoTarget::NoMarkers { .. } | NoTarget::OtherBoard { .. }) {
            return none;
        }
        if self.frames_left == 0 {
            self.seen = recognize(image).map(|seen| seen.to_string());
            self.frames_left = RECOGNIZED_EVERY;
        }
        self.frames_left -= 1;
        match self.seen.clone() {
            Some(seen) => NoTarget::Recognized { seen, target: target.with_proportions() },
            None => none,
        }
    }
}

impl TargetFinder {
    /// A finder of `target`.
    pub fn new(target: &Target) -> Self {
        let of_kind = match TargetDetector::new(*target) {
            Some(coded) => DetectorOfKind::Coded(Box::new(coded)),
            None => DetectorOfKind::Plain(Box::new(Detector::new(target.lattice()))),
        };
        Self { target: *target, of_kind, other: OtherBoard::default() }
    }

    /// The target that is searched for.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// Finds the target in `image`. Part of a board with markers is always answered: they prove
    /// which part. Another board with markers is named.
    ///
    /// # Errors
    /// [`NoBoard`] says why there is none.
    pub fn find(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        let Self { target, of_kind, .. } = self;
        match of_kind {
            DetectorOfKind::Plain(detector) => detector.find_board(image, options),
            DetectorOfKind::Coded(detector) => {
                let found = detector.find(image);
                let mut other = OtherBoard::default();
                let found = found.map_err(|none| other.named(none, image, target))?;
                Ok(found.into_detection(target.lattice()))
            }
        }
    }

    /// Finds it where it was in the last image, else anywhere. Another board with markers is named
    /// as it was seen within the last second or so.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn track(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<TrackedBoard, NoBoard> {
        let Self { target, of_kind, other } = self;
        match of_kind {
            DetectorOfKind::Plain(detector) => detector.track_board(image, options),
            DetectorOfKind::Coded(detector) => {
                let tracked = detector.track(image);
                if tracked.is_ok() {
                    *other = OtherBoard::default();
                }
                let tracked = tracked.map_err(|none| other.named(none, image, target))?;
                let detection = tracked.detection.into_detection(target.lattice());
                Ok(TrackedBoard { detection, followed: tracked.followed })
            }
        }
    }
}
