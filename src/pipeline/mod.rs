//! Where it becomes live: threads, channels, clocks. Uses every layer below.
//!
//! One camera is three threads and two links. `capture-<camera>` owns the device and puts each
//! frame set into a newest-wins slot (in a replay at full speed, a slot that waits instead);
//! `detect-<camera>` takes it from there, looks for the board while a session collects, shows the
//! frame with what was seen to the previews (which `preview-<camera>` draws, once for all who watch),
//! and passes the outcome to `session-<camera>`, which
//! owns the session, performs its actions and answers requests. Solves run beside them on
//! `solve-<camera>`, so that no frame waits for one.
//!
//! A rig of cameras is one more thread, `rig-<name>`: while its session collects, the detect
//! threads of its cameras hand over to it what they see, and it puts together what was seen at one
//! moment.
//!
//! [`fleet::Fleet`] is the one object that the layers above talk to.

mod board_look;
pub mod camera_status;
mod camera_threads;
mod capture_thread;
mod clock;
mod companions;
mod detect_thread;
mod drift;
pub mod event;
pub mod fleet;
mod fleet_rigs;
mod frame_rate;
mod frame_slot;
mod guarded;
mod live_camera;
pub mod live_frame;
mod live_rig;
mod message;
mod metrics;
pub mod preview;
mod preview_thread;
pub mod recorder;
mod rig_inbox;
mod rig_thread;
mod search;
pub mod session_request;
mod session_thread;
mod solve_thread;
mod stop_signal;
pub mod unknown;
mod view_picture;

pub use camera_threads::{CameraPlan, FleetOptions};
pub use capture_thread::Supervision;
pub use live_rig::{RigPlan, RigStatus};
