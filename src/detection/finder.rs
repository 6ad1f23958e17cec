//! The detector of a target, whatever its kind.

use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::no_target::NoTarget;
use crate::detection::coded::recognition::{LEAST_CROSSINGS, recognize};
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
pub const RECOGNIZED_EVERY: u32 = 30;
/// The same where nothing was recognized each time: it is doubled up to this. A scene without any
/// board has chessboard-like corners too. Eight seconds of a camera; chosen.
const RECOGNIZED_AT_LEAST_EVERY: u32 = 240;

/// Which other board is seen in a sequence of images.
#[derive(Debug)]
struct OtherBoard {
    /// Its name, as it was recognized last.
    seen: Option<String>,
    /// Frames until it is recognized again.
    frames_left: u32,
    /// Frames from the last recognition to the next.
    interval: u32,
}

impl OtherBoard {
    /// In an image alone, or the first of a sequence.
    fn at_start() -> Self {
        Self { seen: None, frames_left: 0, interval: RECOGNIZED_EVERY }
    }

    /// After an image in which `of_kind` found its board. A chessboard that moves is often lost for
    /// a few frames: another board is searched for only where it is lost for longer.
    fn after_found(of_kind: &DetectorOfKind) -> Self {
        match of_kind {
            DetectorOfKind::Plain(_) => Self { frames_left: RECOGNIZED_EVERY, ..Self::at_start() },
            DetectorOfKind::Coded(_) => Self::at_start(),
        }
    }

    /// The same reason, or the name of the board with markers that is seen in place of `target`.
    fn named(&mut self, none: NoBoard, image: GrayView<'_>, target: &Target) -> NoBoard {
        if !may_be_of_another(&none) {
            return none;
        }
        if self.frames_left == 0 {
            self.seen = recognize(image).map(|seen| seen.to_string());
            self.interval = match self.seen {
                Some(_) => RECOGNIZED_EVERY,
                None => RECOGNIZED_AT_LEAST_EVERY.min(2 * self.interval),
            };
            self.frames_left = self.interval;
        }
        self.frames_left -= 1;
        match self.seen.clone() {
            Some(seen) => NoTarget::Recognized { seen, target: target.with_proportions() }.into(),
            None => none,
        }
    }
}

/// Whether another board with markers may be why this one is not found: there are corners to
/// recognize it by. The squares between markers are chessboard-like, and a few of them may form a
/// grid, but none as large as the chessboard that is asked for.
fn may_be_of_another(none: &NoBoard) -> bool {
    match none {
        NoBoard::NoGrid { corners, .. } => *corners >= LEAST_CROSSINGS,
        NoBoard::OtherSize { cols, rows, board } => {
            *cols < board.cols.max(board.rows) || *rows < board.cols.min(board.rows)
        }
        NoBoard::Target(none) => {
            matches!(none, NoTarget::NoMarkers { .. } | NoTarget::OtherBoard { .. })
        }
        _ => false,
    }
}

impl TargetFinder {
    /// A finder of `target`.
    pub fn new(target: &Target) -> Self {
        let of_kind = match TargetDetector::new(*target) {
            Some(coded) => DetectorOfKind::Coded(Box::new(coded)),
            None => DetectorOfKind::Plain(Box::new(Detector::new(target.lattice()))),
        };
        Self { target: *target, of_kind, other: OtherBoard::at_start() }
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
        let found = self.find_unnamed(image, options);
        found.map_err(|none| OtherBoard::at_start().named(none, image, &self.target))
    }

    /// As [`Self::find`], in the next image of a sequence: another board is named as it was
    /// recognized last, at most eight seconds ago.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn find_in_sequence(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        let found = self.find_unnamed(image, options);
        self.named(found, image)
    }

    /// As [`Self::find`], but another board is not named: recognition takes several times as long.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn find_unnamed(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        match &mut self.of_kind {
            DetectorOfKind::Plain(detector) => detector.find_board(image, options),
            DetectorOfKind::Coded(detector) => {
                Ok(detector.find(image)?.into_detection(self.target.lattice()))
            }
        }
    }

    /// Finds it where it was in the last image, else anywhere. Another board with markers is named
    /// as it was recognized last, at most eight seconds ago.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn track(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<TrackedBoard, NoBoard> {
        let tracked = match &mut self.of_kind {
            DetectorOfKind::Plain(detector) => detector.track_board(image, options),
            DetectorOfKind::Coded(detector) => {
                detector.track(image).map_err(NoBoard::from).map(|tracked| TrackedBoard {
                    detection: tracked.detection.into_detection(self.target.lattice()),
                    followed: tracked.followed,
                })
            }
        };
        self.named(tracked, image)
    }

    /// What was found in the next image of a sequence, or the name of what is seen in its place.
    fn named<T>(&mut self, found: Result<T, NoBoard>, image: GrayView<'_>) -> Result<T, NoBoard> {
        if found.is_ok() {
            self.other = OtherBoard::after_found(&self.of_kind);
        }
        found.map_err(|none| self.other.named(none, image, &self.target))
    }
}
