//! What the product decides: which views to keep, when there are enough, and how far to trust the
//! result. Pure; uses geometry, imaging, estimation, detection and features.

pub mod admission;
mod auxiliary_image_sensor;
mod cameras;
mod composed_pose;
pub mod coverage;
pub mod depth_calibration;
pub mod depth_check;
pub mod drift;
pub mod factory_check;
pub mod guidance;
pub mod information;
pub mod instrument;
mod known_image;
mod list_shift;
pub mod observations;
pub mod placement;
pub mod plane_error;
pub mod provenance;
pub mod result;
pub mod rgbd_calibration;
mod rgbd_check;
mod rgbd_error;
mod rgbd_guess;
pub mod rgbd_input;
pub mod rig_input;
mod rig_joint;
mod rig_member;
pub mod rounded;
pub mod running_estimate;
pub mod same_view;
pub mod scene;
pub mod sensor;
pub mod session;
pub mod session_record;
pub mod solve;
mod solve_options;
pub mod solve_rgbd;
pub mod solve_rig;
pub mod stated_calibration;
pub mod stereo_pair;
mod tag_spacing;
pub mod target;
pub(crate) mod verdict;
pub mod view;
pub mod view_residuals;

pub use crate::calibration::instrument::solve;
pub use crate::calibration::observations::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet,
};
pub use crate::calibration::solve_options::{
    InstrumentError, SolveMethod, SolveOptions, UnsolvedDepth,
};
