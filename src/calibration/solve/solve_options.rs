//! How to solve an instrument, and why that may fail.

use crate::calibration::solve::solve_rgbd::RgbdError;
use crate::calibration::solve::solve_rig::RigError;
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;

/// How to solve.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SolveOptions {
    /// The lens model and what else is estimated for each image sensor. Default: the solve chooses.
    pub camera: CameraOptions,
    /// What to do with a camera whose depth cannot be calibrated. Default: an error.
    pub unsolved_depth: UnsolvedDepth,
    /// The method for the views of a single sensor. Default: bundle adjustment.
    pub method: SolveMethod,
}

/// How the views of a single sensor are solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SolveMethod {
    /// Lens and poses by bundle adjustment, with uncertainty and checks.
    #[default]
    BundleAdjustment,
    /// The projection matrix from one view of points that are not in a plane, in closed form.
    LinearTransform,
}

/// What to do with a camera whose depth cannot be calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UnsolvedDepth {
    /// An error, for callers that asked for depth.
    #[default]
    Refused,
    /// It is calibrated without depth, and the verdict says why.
    LeftOut,
}

/// Why an instrument could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InstrumentError {
    /// There is no camera at all.
    #[error("no camera was observed: give the views of one at least")]
    NoCamera,
    /// Several cameras or depth, but no board.
    #[error("several sensors are solved by the board that they all see: give its size")]
    NoBoard,
    /// The only camera's views do not determine its lens.
    #[error("{0}")]
    Views(#[from] EstimationError),
    /// The only camera's sensors are inconsistent.
    #[error("{0}")]
    Sensors(#[from] RgbdError),
    /// The poses of several cameras could not be determined.
    #[error("{0}")]
    Rig(#[from] RigError),
    /// The sensors of one of several cameras are inconsistent.
    #[error("camera `{camera}`: {source}")]
    Camera {
        /// Its name.
        camera: String,
        /// Why not.
        source: RgbdError,
    },
}

/// Why a camera is calibrated without its depth.
pub(super) fn without_depth(reason: &RgbdError) -> String {
    format!("depth is not calibrated: {reason}")
}
