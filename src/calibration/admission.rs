//! Why a frame did not become a view: each reason is a value, counted and shown, never an error.

use std::collections::BTreeMap;

use crate::calibration::placement::Placement;
use crate::calibration::rounded::in_differing_digits;
use crate::calibration::view::FrameFacts;
use crate::detection::board_detection::{Detection, NoBoard};
use crate::geometry::pixel::ImageSize;
use crate::imaging::no_image::NoImage;

/// Why a session has too few views where most frames were rejected for their size, and what to do.
pub(super) const SIZE_CHANGED: &str =
    "the images changed size during the session; keep the camera at one size and start again";

/// Why a frame did not become a view.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// The image could not be decoded.
    #[error("the image cannot be read: {detail}")]
    Unreadable {
        /// The decoder's message.
        detail: String,
    },
    /// The frame set has no image: depth came without the color image.
    #[error("frame set {name}: {missing}")]
    NoImage {
        /// The frame set's name, or its sequence number.
        name: String,
        /// What is missing, and where.
        missing: NoImage,
    },
    /// No board was found in it.
    #[error("no board: {0}")]
    NoBoard(NoBoard),
    /// Only part of the board was seen.
    #[error("only {seen} of {expected} corners are in view")]
    Partial {
        /// How many corners were seen.
        seen: usize,
        /// How many the board has.
        expected: usize,
    },
    /// The board's edges are too blurred for accurate corners.
    #[error(
        "blurred: edges are {} px wide, the limit is {} px",
        in_differing_digits([*blur_px, *limit_px], 1)[0],
        in_differing_digits([*blur_px, *limit_px], 1)[1]
    )]
    Blurred {
        /// Width of the board's edges, as a Gaussian's standard deviation in pixels.
        blur_px: f64,
        /// The most that is accepted.
        limit_px: f64,
    },
    /// The board moves between frames: its corners are smeared, and a rolling shutter distorts it.
    #[error("moving at {speed_px_per_s:.0} px/s, the limit is {limit_px_per_s:.0} px/s")]
    Moving {
        /// Speed of the fastest corner since the previous frame, in pixels a second.
        speed_px_per_s: f64,
        /// The most that is accepted.
        limit_px_per_s: f64,
    },
    /// Too much like a view that is kept already.
    #[error("too similar to view {view}")]
    TooSimilar {
        /// The kept view that it resembles most.
        view: u32,
    },
    /// A camera in front of a scene moved too little since a kept view.
    #[error("too close to view {view}: {:.0} % of the required motion", 100.0 * part)]
    SmallStep {
        /// The kept view that it resembles most.
        view: u32,
        /// The step, as a fraction of what it takes to be kept, 0 to 1.
        part: f64,
    },
    /// It would add too little information to that of the session's views.
    #[error(
        "too little new information: it would lower the projection uncertainty by {} %, and {} % is required; move the board to the suggested pose",
        in_differing_digits([100.0 * gain, 100.0 * needed], 1)[0],
        in_differing_digits([100.0 * gain, 100.0 * needed], 1)[1]
    )]
    LittleInformation {
        /// The relative drop of the projections' uncertainty with it, 0 to 1.
        gain: f64,
        /// The drop that a view must bring to be kept.
        needed: f64,
    },
    /// The image's size is not that of the session's first one.
    #[error(
        "the image is {got}, but the session's images are {expected}: keep the camera at one resolution"
    )]
    OtherImageSize {
        /// This image's size.
        got: ImageSize,
        /// The session's size.
        expected: ImageSize,
    },
    /// Too few features to recognize a scene by.
    #[error(
        "only {features} features: point the camera at something with texture, in focus and lit"
    )]
    NoTexture {
        /// How many there are.
        features: usize,
    },
    /// A scene of which no kept view shows anything.
    #[error(
        "it does not show the scene of the kept views (inlier matches with the previous frame: {matches}): go back, and take smaller steps"
    )]
    UnknownScene {
        /// The number of inlier matches with the previous frame.
        matches: usize,
    },
    /// The session has as many views as it may keep.
    #[error("the session has reached its maximum of {limit} views; stop it to solve")]
    Full {
        /// The most views a session keeps.
        limit: u32,
    },
}

impl Rejection {
    /// The stable names, as counted in [`Rejections`], in the order of documents; those of
    /// [`NoBoard::KINDS`] are among them.
    pub const KINDS: [&'static str; 22] = [
        "no_corners",
        "no_grid",
        "other_size",
        "low_contrast",
        "image_too_small",
        "cut_off",
        "incomplete",
        "no_lattice",
        "no_markers",
        "other_board",
        "two_places",
        "mirrored",
        "partial",
        "blurred",
        "moving",
        "too_similar",
        "unreadable",
        "no_image",
        "other_image_size",
        "no_texture",
        "unknown_scene",
        "full",
    ];

    /// Whether the board was seen well, but the view is not new.
    pub fn is_known_already(&self) -> bool {
        matches!(
            self,
            Self::TooSimilar { .. } | Self::SmallStep { .. } | Self::LittleInformation { .. }
        )
    }

    /// A short stable name for counters, documents and events.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::NoBoard(reason) => reason.kind(),
            Self::Partial { .. } => "partial",
            Self::Blurred { .. } => "blurred",
            Self::Moving { .. } => "moving",
            Self::TooSimilar { .. } | Self::SmallStep { .. } | Self::LittleInformation { .. } => {
                "too_similar"
            }
            Self::Unreadable { .. } => "unreadable",
            Self::NoImage { .. } => "no_image",
            Self::OtherImageSize { .. } => "other_image_size",
            Self::NoTexture { .. } => "no_texture",
            Self::UnknownScene { .. } => "unknown_scene",
            Self::Full { .. } => "full",
        }
    }
}

/// How often each reason rejected a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejections {
    counts: BTreeMap<&'static str, u64>,
}

impl Default for Rejections {
    fn default() -> Self {
        Self { counts: Rejection::KINDS.into_iter().map(|kind| (kind, 0)).collect() }
    }
}

impl Rejections {
    /// Counts one more of `rejection`.
    pub fn count(&mut self, rejection: &Rejection) {
        *self.counts.entry(rejection.kind()).or_default() += 1;
    }

    /// Takes back one of `rejection`: the frame was kept after all, since another camera saw the
    /// board in the same frame set.
    pub(super) fn take_back(&mut self, rejection: &Rejection) {
        if let Some(count) = self.counts.get_mut(rejection.kind()) {
            *count = count.saturating_sub(1);
        }
    }

    /// Each kind with its count, in a fixed order.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        Rejection::KINDS.into_iter().map(|kind| (kind, self.of(kind)))
    }

    /// How often `kind` rejected a frame.
    pub fn of(&self, kind: &str) -> u64 {
        self.counts.get(kind).copied().unwrap_or(0)
    }

    /// The kind that rejected most frames, if any was rejected.
    pub fn most_frequent(&self) -> Option<&'static str> {
        let most = self.iter().max_by_key(|(_, count)| *count);
        most.filter(|(_, count)| *count > 0).map(|(kind, _)| kind)
    }

    /// Replaces the counts by the sum of others.
    pub fn set_sum<'a>(&mut self, others: impl IntoIterator<Item = &'a Self>) {
        *self = Self::default();
        for (kind, count) in others.into_iter().flat_map(Self::iter) {
            *self.counts.entry(kind).or_default() += count;
        }
    }

    /// How many frames were rejected.
    pub fn total(&self) -> u64 {
        self.counts.values().sum()
    }

    /// From stored counts; kinds that no longer exist are left out.
    pub fn from_counts<'a>(counts: impl IntoIterator<Item = (&'a str, u64)>) -> Self {
        let mut rejections = Self::default();
        for (kind, count) in counts {
            if let Some(known) = rejections.counts.get_mut(kind) {
                *known = count;
            }
        }
        rejections
    }
}

/// The limits that a detection must meet to become a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdmissionOptions {
    /// The widest blur of the board's edges, as a fraction of the image's diagonal, but never less
    /// than 2 px. Default: 0.0025 (2 px at 640×480, 5.5 px at 1920×1080).
    pub blur_limit: f64,
    /// The fastest corner, in image diagonals a second. Default: 0.4 (320 px/s at 640×480).
    pub speed_limit: f64,
    /// The least distance from every kept view, in steps ([`Placement::steps_to`]): closer ones
    /// repeat an image, with the same errors. Default: 0.3 (4 % of the image's width, or 3°).
    pub novelty_steps: f64,
    /// The information that a view must add, as a fraction of what the kept ones added on average.
    /// If N views add the same, each lowers the uncertainty of projections by 1/(2N). Default: 0.3,
    /// so that images of a set in which none adds much are kept.
    pub worth: f64,
    /// The most views of a session. Default: 150.
    pub view_limit: u32,
}

impl Default for AdmissionOptions {
    fn default() -> Self {
        Self {
            blur_limit: 0.0025,
            speed_limit: 0.4,
            novelty_steps: 0.3,
            worth: 0.3,
            view_limit: 150,
        }
    }
}

const LEAST_BLUR_LIMIT_PX: f64 = 2.0;
/// If the board jumps by more than this fraction of the diagonal, the two frames are not one
/// motion: the recording has a cut, or is a set of photographs.
const CUT_DIAGONALS: f64 = 0.25;
/// If more time than this lies between two frames, in seconds, no speed is estimated.
pub(crate) const ONE_MOVEMENT_S: f64 = 0.5;

/// The previous frame, if it shows a board.
#[derive(Debug, Clone, PartialEq)]
pub struct PreviousBoard {
    /// Its time, in nanoseconds.
    pub time_ns: i64,
    /// The detected board.
    pub detection: Detection,
}

/// Decides whether a detection is sharp, still, whole and different from the kept views; returns
/// its placement if so. How much information it would add is decided elsewhere
/// ([`crate::calibration::information::camera_information`]). It depends on the frames only, not on
/// estimates made meanwhile: a replay keeps the same views.
///
/// # Errors
/// The first reason against it, the most useful to the operator first.
pub fn admit(
    detection: &Detection,
    seen: &FrameFacts,
    before: Option<&PreviousBoard>,
    kept: &[Placement],
    options: &AdmissionOptions,
) -> Result<Placement, Rejection> {
    let size = seen.image_size;
    let limit_px = (options.blur_limit * size.diagonal_px()).max(LEAST_BLUR_LIMIT_PX);
    if detection.blur_px > limit_px {
        return Err(Rejection::Blurred { blur_px: detection.blur_px, limit_px });
    }
    let limit_px_per_s = options.speed_limit * size.diagonal_px();
    match before.and_then(|before| speed_px_per_s(detection, seen, before)) {
        Some(speed_px_per_s) if speed_px_per_s > limit_px_per_s => {
            return Err(Rejection::Moving { speed_px_per_s, limit_px_per_s });
        }
        _ => {}
    }
    let (seen, expected) = (detection.corners.len(), detection.board.corner_count());
    let placement = Placement::of(detection, size).ok_or(Rejection::Partial { seen, expected })?;
    let alike = kept
        .iter()
        .map(|other| placement.steps_to(other))
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(&b.1));
    match alike {
        Some((view, steps)) if steps < options.novelty_steps => {
            Err(Rejection::TooSimilar { view: view as u32 })
        }
        _ => Ok(placement),
    }
}

/// Speed of the fastest corner since the previous frame; `None` if too much time passed.
fn speed_px_per_s(detection: &Detection, seen: &FrameFacts, before: &PreviousBoard) -> Option<f64> {
    let elapsed_s = (seen.time_ns() - before.time_ns) as f64 * 1e-9;
    // A named frame is an image file; the times of files in a folder are not those of a motion.
    if seen.name.is_some() || !(elapsed_s > 0.0 && elapsed_s < ONE_MOVEMENT_S) {
        return None;
    }
    let corners = detection.corners.iter();
    let shared = corners.filter_map(|corner| {
        let corners = &before.detection.corners;
        let at = corners.binary_search_by_key(&(corner.index.row, corner.index.col), |c| {
            (c.index.row, c.index.col)
        });
        Some(corner.pixel.distance_px(corners[at.ok()?].pixel))
    });
    let moved_px = shared.max_by(f64::total_cmp)?;
    (moved_px < CUT_DIAGONALS * seen.image_size.diagonal_px()).then_some(moved_px / elapsed_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_without_a_board_has_a_count_of_its_own() {
        for kind in NoBoard::KINDS {
            assert!(Rejection::KINDS.contains(&kind), "{kind}");
        }
        let mut rejections = Rejections::default();
        rejections.count(&Rejection::NoBoard(NoBoard::LowContrast { range: 3 }));
        rejections.count(&Rejection::NoBoard(NoBoard::Blurred { blur_px: 9.0 }));
        rejections.count(&Rejection::Blurred { blur_px: 4.0, limit_px: 2.0 });
        let counted: Vec<_> = rejections.iter().filter(|(_, count)| *count > 0).collect();
        assert_eq!(counted, [("low_contrast", 1), ("blurred", 2)]);
    }
}
