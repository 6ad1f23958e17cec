//! USB cameras by their place in the list or their name, on any system: `kind = "uvc"`.
//!
//! macOS and Windows: through `nokhwa`. On Linux the same cameras are V4L2 devices, and are read as
//! those: that source never waits without an end, counts losses and holds controls, which the
//! portable one cannot. A Linux build with the feature `nokhwa` has both, and
//! [`UvcOptions::backend`] says which reads a camera.

#[cfg(target_os = "linux")]
mod native;
mod options;
#[cfg(any(not(target_os = "linux"), feature = "nokhwa"))]
mod portable;
#[cfg(any(not(target_os = "linux"), feature = "nokhwa"))]
mod portable_mode;

#[cfg(all(target_os = "linux", not(feature = "nokhwa")))]
use native as listing;
pub use options::{Backend, Selector, UvcOptions};
#[cfg(any(not(target_os = "linux"), feature = "nokhwa"))]
use portable as listing;

#[cfg(not(all(target_os = "linux", feature = "nokhwa")))]
use crate::capture::CaptureError;
use crate::capture::SourceOpener;
use crate::capture::device_list::DeviceListing;

/// A USB camera that may come and go, not opened yet. One whose backend this build does not have
/// says so when it is opened.
pub fn camera(options: UvcOptions) -> Box<dyn SourceOpener> {
    match options.backend {
        #[cfg(target_os = "linux")]
        Backend::Native => Box::new(native::camera(options)),
        #[cfg(any(not(target_os = "linux"), feature = "nokhwa"))]
        Backend::Nokhwa => Box::new(portable::PortableCamera::new(options)),
        #[cfg(not(all(target_os = "linux", feature = "nokhwa")))]
        absent => Box::new(move || {
            let reason = absent.missing().unwrap_or_default().to_owned();
            Err(CaptureError::Failed { reason })
        }),
    }
}

/// Every camera that the system lists, as the portable backend sees them where this build has it.
pub fn list_devices() -> DeviceListing {
    listing::list_devices()
}
