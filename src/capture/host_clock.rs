//! The host's clock.

use std::time::{SystemTime, UNIX_EPOCH};

use crate::imaging::timestamp::HostTime;

/// The present; a clock that is before 1970 reads as 1970.
pub(crate) fn now() -> HostTime {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    HostTime { utc_ns: i64::try_from(since.as_nanos()).unwrap_or(i64::MAX) }
}
