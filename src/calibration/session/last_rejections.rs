//! Why most frames of a camera were rejected, in the words of the last one of them.

use std::collections::BTreeMap;

use crate::calibration::admission::{Rejection, Rejections};

/// The last rejection of each kind.
#[derive(Debug, Clone, Default)]
pub(super) struct LastRejections {
    by_kind: BTreeMap<&'static str, Rejection>,
}

impl LastRejections {
    /// Takes what became of a frame.
    pub(super) fn note(&mut self, admission: &Result<u32, Rejection>) {
        if let Err(rejection) = admission {
            self.by_kind.insert(rejection.kind(), rejection.clone());
        }
    }

    /// The message of the kind that rejected more than half of `frames`; `None` if there is no such
    /// kind, if it only means that views were not new, or if none came since the session was
    /// resumed.
    pub(super) fn why_most(&self, rejected: &Rejections, frames: u64) -> Option<String> {
        let kind = rejected.most_frequent().filter(|kind| 2 * rejected.of(kind) > frames)?;
        let last = self.by_kind.get(kind).filter(|last| !last.is_known_already())?;
        Some(format!("{} of {frames} frames: {last}", rejected.of(kind)))
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
        let why = last.why_most(&rejected, 3).unwrap();
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
