//! Two clocks that must not be mixed: the host's UTC and the device's own.

/// Nanoseconds since 1970-01-01T00:00:00Z, by the host's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HostTime {
    /// Nanoseconds since the Unix epoch.
    pub utc_ns: i64,
}

/// Nanoseconds since an unknown start, by the device's monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceTime {
    /// Nanoseconds since the device's own start.
    pub monotonic_ns: i64,
}
