//! Which camera, by which backend, and how it is to be set.

use crate::capture::mode::ModeRequest;

/// Which camera, by which backend, and how it is to be set.
#[derive(Debug, Clone, PartialEq)]
pub struct UvcOptions {
    /// Which one.
    pub selector: Selector,
    /// Size, format and rate; default: as the device has them, or what the backend chooses.
    pub mode: ModeRequest,
    /// What reads it.
    pub backend: Backend,
}

/// Which of the system's cameras.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selector {
    /// The n-th, from 0.
    Index(u32),
    /// The one with this name.
    Name(String),
}

/// What reads a USB camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// The system's own interface: V4L2, on Linux.
    Native,
    /// The library `nokhwa`, on any system.
    Nokhwa,
}

impl Backend {
    /// The one that is taken unless another is asked for.
    pub const DEFAULT: Self = if cfg!(target_os = "linux") { Self::Native } else { Self::Nokhwa };

    /// Its name in the configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Nokhwa => "nokhwa",
        }
    }

    /// The one with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Native, Self::Nokhwa].into_iter().find(|backend| backend.name() == name)
    }

    /// Why this build does not have it, and what to do; `None` where it has.
    pub const fn missing(self) -> Option<&'static str> {
        match self {
            Self::Native if cfg!(not(target_os = "linux")) => {
                Some("only Linux has the backend native; write \"nokhwa\"")
            }
            Self::Nokhwa if cfg!(all(target_os = "linux", not(feature = "nokhwa"))) => {
                Some("this plumb was built without nokhwa; build it with --features nokhwa")
            }
            _ => None,
        }
    }
}
