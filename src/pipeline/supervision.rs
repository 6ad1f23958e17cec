//! How soon a camera counts as lost, and how often a lost one is tried again.

use std::time::Duration;

/// How a camera is supervised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supervision {
    /// The wait before a lost source is reopened; doubles with each failure. Default: 0.25 s.
    pub first_retry: Duration,
    /// The longest such wait. Default: 5 s.
    pub longest_retry: Duration,
    /// How often the device is asked whether focus, zoom and exposure still have the values of the
    /// last session. It is also the shortest time between two comparisons of changed image sizes
    /// with the calibrations. Default: 2 s.
    pub moved_check: Duration,
    /// The wait before a source that needs a person is tried again. Default: 10 s.
    pub failed_retry: Duration,
    /// A device is lost when it has been silent for this long and for five of its frame intervals.
    /// If it states no rate, three times the interval between its last frames counts instead.
    /// Default: 1.5 s.
    pub stall: Duration,
    /// The same for a device that was opened and has delivered no frame yet: many take a second or
    /// two. Default: 4 s.
    pub first_frame: Duration,
    /// How long a source may take to close before its driver is reported as not releasing it.
    /// Default: 3 s; the slowest drivers that do return wait 1 s for a last frame.
    pub closing: Duration,
}

impl Default for Supervision {
    fn default() -> Self {
        Self {
            first_retry: Duration::from_millis(250),
            longest_retry: Duration::from_secs(5),
            failed_retry: Duration::from_secs(10),
            moved_check: Duration::from_secs(2),
            stall: Duration::from_millis(1500),
            first_frame: Duration::from_secs(4),
            closing: Duration::from_secs(3),
        }
    }
}
