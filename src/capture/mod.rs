//! Sources of frames: one trait, and one file for each kind of source. Uses dds, geometry, imaging,
//! recording and simulation.
//!
//! Its one operation is [`FrameSource::next_frame`]: a blocking call with a timeout, made from one
//! thread that owns the source. Supervision (states, opening again, back-off) is above it, in the
//! pipeline.

pub mod device_list;
mod error;
mod frame_counter;
mod frame_source;
pub(crate) mod host_clock;
pub mod mode;
pub mod realsense;
mod replay;
#[cfg(feature = "ros2")]
pub mod ros2;
mod simulated;
pub mod uvc;
#[cfg(target_os = "linux")]
pub mod v4l2;

pub use error::CaptureError;
pub use frame_source::{FrameSource, Losses, SourceDescription, SourceOpener};
pub use replay::{Pace, Replay, ReplayOptions};
pub use simulated::{Simulated, SimulatedClock};

/// What each backend sees on this machine.
pub fn list_devices() -> Vec<device_list::DeviceListing> {
    vec![
        #[cfg(target_os = "linux")]
        v4l2::list_devices(),
        uvc::list_devices(),
        realsense::list_devices(),
        #[cfg(feature = "ros2")]
        ros2::list_devices(),
    ]
}
