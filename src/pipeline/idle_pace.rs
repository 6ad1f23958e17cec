//! The pace of a replay that no session waits for.

use std::time::Duration;

use crate::imaging::frame::FrameSet;

/// A longer interval between two frames is shortened to this one.
const LONGEST_INTERVAL: Duration = Duration::from_secs(1);

/// Paces an idle replay at its recorded frame interval.
#[derive(Debug, Default)]
pub(super) struct IdlePace {
    last_ns: Option<i64>,
}

impl IdlePace {
    /// How long after the previous frame set this one is due.
    pub(super) fn until_due(&mut self, frame_set: &FrameSet) -> Duration {
        let now_ns = frame_set.host_time.utc_ns;
        let since_ns =
            self.last_ns.replace(now_ns).map_or(0, |last_ns| now_ns.saturating_sub(last_ns));
        Duration::from_nanos(since_ns.max(0).unsigned_abs()).min(LONGEST_INTERVAL)
    }
}
