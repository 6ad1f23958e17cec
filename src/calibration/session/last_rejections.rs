//! Why most frames of a camera were rejected, in the words of the last one of them.

use std::collections::BTreeMap;
use std::fmt;

use crate::calibration::admission::{Rejection, Rejections};

/// The last rejection of each kind.
#[derive(Debug, Clone, Default)]
pub(super) struct LastRejections {
    by_kind: BTreeMap<&'static str, Rejection>,
}

/// The kind of rejection of most frames.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FrequentRejection {
    /// How many frames it rejected.
    rejected: u64,
    /// Of how many.
    frames: u64,
    /// The last such rejection.
    last: Box<Rejection>,
}

impl fmt::Display for FrequentRejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} frames: {}", self.rejected, self.frames, self.last)
    }
}

impl LastRejections {
    /// Takes what became of a frame.
    pub(super) fn note(&mut self, admission: &Result<u32, Rejection>) {
        if let Err(rejection) = admission {
            self.by_kind.insert(rejection.kind(), rejection.clone());
        }
    }

    /// The kind that rejected more than half of `frames`; `None` if there is no such kind, if it
    /// only means that views were not new, or if none came since the session was resumed.
    pub(super) fn why_most(&self, rejected: &Rejections, frames: u64) -> Option<FrequentRejection> {
        let kind = rejected.most_frequent().filter(|kind| 2 * rejected.of(kind) > frames)?;
        let last = self.by_kind.get(kind).filter(|last| !last.is_known_already())?;
        let last = Box::new(last.clone());
        Some(FrequentRejection { rejected: rejected.of(kind), frames, last })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::board_detection::NoBoard;
    use crate::geometry::board::BoardSize;

    #[test]
    fn the_most_frequent_reason_is_said_in_its_own_words() {
        let board = BoardSize::new(9, 7).unwrap();
        let other = Rejection::NoBoard(NoBoard::OtherSize { cols: 9, rows: 6, board });
        let (mut last, mut rejected) = (LastRejections::default(), Rejections::default());
        assert_eq!(last.why_most(&rejected, 0), None);
        for rejection in [other.clone(), Rejection::TooSimilar { view: 0 }, other] {
            rejected.count(&rejection);
            last.note(&Err(rejection));
        }
        assert_eq!(last.why_most(&rejected, 4), None);
        // As after a restart.
        assert_eq!(LastRejections::default().why_most(&rejected, 3), None);
        let why = last.why_most(&rejected, 3).unwrap().to_string();
        assert!(
            why.starts_with("2 of 3 frames: no board: a board of 9x6 is seen, not 9x7"),
            "{why}"
        );
        for _ in 0..3 {
            rejected.count(&Rejection::TooSimilar { view: 0 });
        }
        assert_eq!(last.why_most(&rejected, 6), None);
    }
}
