//! Calibration without a target. The input is photographs of a static scene; the result is a lens
//! with its uncertainty, or the reason why the photographs do not determine it.
//!
//! ```text
//! images --correspondence--> pairs and tracks --estimation::scene--> lens, poses, points
//!        --lens_fit--> the lens model that the images call for
//!        --conditions, verdict--> how far to trust it
//!        --depth_scale--> lengths in meters, where depth was measured too
//! ```

mod altered_images;
pub mod conditions;
pub mod correspondence;
pub mod depth_scale;
mod fitted_lens;
pub mod key_frames;
mod lens_differences;
mod lens_fit;
mod localization;
mod one_camera;
mod pair_geometry;
pub mod refusal;
pub mod result;
mod scene_frame;
#[cfg(test)]
mod scene_tests;
pub mod so_far;
mod solve;
mod verdict;

pub use depth_scale::{NoScale, SceneDepth};
pub use refusal::SceneRefusal;
pub use result::{SceneCalibration, ScenePoint, SceneSensor, SceneView};
pub use solve::{SceneOptions, calibrate_scene};
