//! Cameras that a ROS 2 driver owns: `kind = "ros2"`, by the topics that it publishes.
//!
//! Reliability is the publisher's own. A publisher that comes late, goes, or changes what it sends
//! is a camera that is lost and found again; why is in one line.

mod camera;
mod listing;
mod options;
mod source;

pub use camera::Ros2Camera;
pub use listing::list_devices;
pub use options::Ros2Options;
