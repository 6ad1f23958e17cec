//! The host's clock, as a number.

use crate::capture::host_clock;

/// Nanoseconds since the Unix epoch, now.
pub(crate) fn utc_now_ns() -> i64 {
    host_clock::now().utc_ns
}
