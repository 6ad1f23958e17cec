//! What the product decides: which views to keep, when there are enough, and how far to trust the
//! result. Pure; uses geometry, imaging, estimation, detection and features.

pub mod admission;
pub mod coverage;
pub mod depth_calibration;
pub mod depth_check;
pub mod drift;
mod few_views;
mod given_misfit;
pub mod guidance;
pub mod information;
mod known_image;
pub mod placement;
pub mod plane_error;
pub mod provenance;
pub mod result;
pub mod rounded;
pub mod running_estimate;
pub mod same_view;
pub mod scene;
pub mod sensor;
pub mod session;
pub mod session_record;
pub mod solve;
pub mod stated_calibration;
pub mod stereo_pair;
mod tag_spacing;
pub mod target;
pub(crate) mod verdict;
pub mod view;
pub mod view_residuals;

pub use crate::calibration::solve::instrument::solve;
pub use crate::calibration::solve::observations::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet,
};
pub use crate::calibration::solve::solve_options::{
    InstrumentError, SolveMethod, SolveOptions, UnsolvedDepth,
};
