//! Why a frame did not become a view: each reason is a value, counted and shown, never an error.

use std::collections::BTreeMap;

use crate::detection::board_detection::NoBoard;
use crate::geometry::pixel::ImageSize;

/// Why a frame did not become a view.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// The picture could not be decoded.
    #[error("the picture cannot be read: {detail}")]
    Unreadable {
        /// What the decoder said.
        detail: String,
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
    /// The board's edges are too soft for exact corners.
    #[error("blurred: edges are {blur_px:.1} px wide, at most {limit_px:.1} px can be used")]
    Blurred {
        /// Width of the board's edges, as a Gaussian's standard deviation in pixels.
        blur_px: f64,
        /// The most that is kept.
        limit_px: f64,
    },
    /// The board moves between frames: its corners are smeared, and a rolling shutter bends it.
    #[error("moving at {speed_px_per_s:.0} px/s, at most {limit_px_per_s:.0} px/s can be used")]
    Moving {
        /// Speed of the fastest corner since the frame before, in pixels a second.
        speed_px_per_s: f64,
        /// The most that is kept.
        limit_px_per_s: f64,
    },
    /// Too much like a view that is kept already.
    #[error("too much like view {view}")]
    TooSimilar {
        /// The kept view that it resembles most.
        view: u32,
    },
    /// The picture's size is not that of the session's first one.
    #[error("the picture is {got}, the session's others are {expected}")]
    OtherImageSize {
        /// This picture's size.
        got: ImageSize,
        /// The session's size.
        expected: ImageSize,
    },
    /// The session holds as many views as it may.
    #[error("the session holds its {limit} views already; stop it to solve")]
    Full {
        /// The most views a session keeps.
        limit: u32,
    },
}

impl Rejection {
    /// The stable names, as counted in [`Rejections`], in the order of documents.
    pub const KINDS: [&'static str; 8] =
        ["no_board", "partial", "blurred", "moving", "too_similar", "unreadable", "other_image_size", "full"];

    /// A short stable name for counters, documents and events.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::NoBoard(NoBoard::Blurred { .. }) | Self::Blurred { .. } => "blurred",
            Self::NoBoard(NoBoard::Incomplete { .. }) | Self::Partial { .. } => "partial",
            Self::NoBoard(_) => "no_board",
            Self::Moving { .. } => "moving",
            Self::TooSimilar { .. } => "too_similar",
            Self::Unreadable { .. } => "unreadable",
            Self::OtherImageSize { .. } => "other_image_size",
            Self::Full { .. } => "full",
        }
    }
}

/// How often each reason turned a frame away.
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

    /// Each kind with its count, in a fixed order.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        Rejection::KINDS.into_iter().map(|kind| (kind, self.of(kind)))
    }

    /// How often `kind` turned a frame away.
    pub fn of(&self, kind: &str) -> u64 {
        self.counts.get(kind).copied().unwrap_or(0)
    }

    /// How many frames were turned away.
    pub fn total(&self) -> u64 {
        self.counts.values().sum()
    }

    /// From stored counts; a kind that is not known any more is left out.
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
