//! USB cameras by their place in the list or their name, on any system: `kind = "uvc"`.
//!
//! macOS and Windows: through `nokhwa`. On Linux the same cameras are V4L2 devices, and are read as
//! those: that source never waits without an end, counts losses and holds controls, which the
//! portable one cannot. A Linux build with the feature `nokhwa` takes the portable way all the
//! same.

#[cfg(all(target_os = "linux", not(feature = "nokhwa")))]
mod linux;
mod options;
#[cfg(any(not(target_os = "linux"), feature = "nokhwa"))]
mod portable;

#[cfg(all(target_os = "linux", not(feature = "nokhwa")))]
pub use linux::{UvcCamera, list_devices};
pub use options::{Selector, UvcOptions};
#[cfg(any(not(target_os = "linux"), feature = "nokhwa"))]
pub use portable::{UvcCamera, list_devices};
