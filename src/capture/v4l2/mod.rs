//! Linux video devices: `kind = "v4l2"`.
//!
//! | file | concept |
//! | --- | --- |
//! | `device_node` | the nodes there are, and which device each belongs to, from sysfs |
//! | `identity` | finding one device again after it was unplugged, whatever its node is called by then |
//! | `mode` | pixel format, size and rate: what is offered, what is chosen, what was got |
//! | `gray_mode` | gray images of a camera that `nokhwa` has open |
//! | `controls` | focus, exposure, gain …: set, held still while calibrating, given back |
//! | `source` | the stream of frames |
//! | `failure` | what the system's errors mean, and what to do |
//! | `holder` | which process has a device open |
//! | `kernel` | the system calls that the `v4l` crate lacks or answers with a panic |

mod camera;
mod controls;
mod device_node;
mod failure;
#[cfg(feature = "nokhwa")]
mod gray_mode;
mod holder;
mod identity;
mod kernel;
mod listing;
mod mode;
mod source;

pub use camera::{V4l2Camera, V4l2Options};
#[cfg(feature = "nokhwa")]
pub(in crate::capture) use gray_mode::{gray_modes, set_gray};
pub use listing::list_devices;
#[cfg(feature = "nokhwa")]
pub(in crate::capture) use listing::{may_give_images, set_to_one_of};
