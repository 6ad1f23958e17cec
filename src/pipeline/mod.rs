//! The live part of the program: threads, channels, clocks. The list in `src/lib.rs` says which
//! layers it uses.
//!
//! Every frame takes the same path, whatever the instrument. `capture-<camera>` owns the device
//! (which `close-<camera>` closes, however long that takes) and puts each frame set into a slot
//! where the newest wins; in a replay at full speed, the slot waits instead. `detect-<camera>`
//! takes it from there. While a session collects, it searches for the board, or for a scene's
//! features. It shows the frame with its detections (`preview-<camera>` draws it, once for all
//! clients) and passes it to the session's `assembly`. There the frames of several cameras are
//! combined into frame sets, and those that may be kept are searched in full, on every sensor.
//! `session-<instrument>` owns the session, stores what it keeps, announces it, and answers
//! requests. Solves run on `solve-<instrument>`, so that no frame waits for one.
//!
//! Each camera is an instrument. Each rig is one more, and acquires its cameras while its session
//! collects. Every queue is bounded, and every dropped frame is counted in the metrics.
//!
//! [`fleet::Fleet`] is the only object that the layers above use.

mod assembly;
mod auxiliary;
mod board_search;
pub mod camera_status;
mod capture_thread;
mod captured;
pub(crate) mod clock;
mod closing;
mod collecting;
mod current_calibration;
#[cfg(test)]
mod current_calibration_tests;
mod detect_thread;
mod drift;
pub mod event;
#[cfg(test)]
mod exchange_tests;
#[cfg(test)]
mod fault_tests;
pub mod fleet;
pub mod fleet_error;
mod fleet_exchange;
mod fleet_sessions;
#[cfg(test)]
mod fleet_tests;
mod frame_rate;
mod frame_slot;
mod guarded;
mod idle_pace;
mod instrument;
#[cfg(test)]
#[allow(
    clippy::duplicate_mod,
    dead_code,
    unreachable_pub,
    reason = "compiled a second time with other primitives, for their tests alone"
)]
mod interleavings;
mod jobs;
mod live_camera;
pub mod live_frame;
#[cfg(test)]
mod load_tests;
mod message;
mod metrics;
mod observations;
mod pausing;
pub mod preview;
mod preview_thread;
pub mod recording;
mod running;
mod scene_search;
#[cfg(test)]
mod scripted;
mod search;
mod seen;
pub mod session_request;
mod session_thread;
mod silence;
mod solve_job;
mod solve_thread;
mod stop_signal;
mod store_health;
mod supervision;
mod sync;
pub mod unknown;
mod unstored;
mod view_image;

pub use instrument::{RigPlan, RigStatus};
pub use running::{CameraPlan, Exchange, FleetOptions};
pub use supervision::Supervision;
