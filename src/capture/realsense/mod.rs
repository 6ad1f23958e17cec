//! RealSense cameras and their recordings: `kind = "realsense"`, through Intel's own library.
//!
//! The library is needed to build and to run, so that this is the cargo feature `realsense`, off
//! unless asked for. A build without it has the same names, and says what is missing.

mod bag_file;
#[cfg(feature = "realsense")]
mod camera;
#[cfg(feature = "realsense")]
mod factory;
#[cfg(feature = "realsense")]
mod listing;
mod options;
#[cfg(feature = "realsense")]
mod pixels;
mod settings;
#[cfg(feature = "realsense")]
mod source;
#[cfg(feature = "realsense")]
mod stated;
#[cfg(not(feature = "realsense"))]
mod without;

#[cfg(feature = "realsense")]
pub use camera::RealsenseCamera;
#[cfg(feature = "realsense")]
pub use listing::list_devices;
#[cfg(not(feature = "realsense"))]
pub use without::{RealsenseCamera, list_devices};

pub use options::{Origin, RealsenseOptions};
pub use settings::{Preset, Settings};
