//! Which camera, and how it is to be set.

use crate::capture::mode::ModeRequest;

/// Which camera, and how it is to be set.
#[derive(Debug, Clone, PartialEq)]
pub struct UvcOptions {
    /// Which one.
    pub selector: Selector,
    /// Size, format and rate; default: as the device has them.
    pub mode: ModeRequest,
}

/// Which of the system's cameras.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selector {
    /// The n-th, from 0.
    Index(u32),
    /// The one with this name.
    Name(String),
}
