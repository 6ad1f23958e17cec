//! How an instrument is to be solved, and why it could not be.

use crate::calibration::solve_rgbd::RgbdError;
use crate::calibration::solve_rig::RigError;
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;

/// How to solve.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SolveOptions {
    /// The lens and what else is estimated of each image sensor. Default: all found out.
    pub camera: CameraOptions,
    /// What becomes of a camera whose depth cannot be calibrated. Default: an error.
    pub unsolved_depth: UnsolvedDepth,
    /// By which method the views of a single sensor are solved. Default: bundle adjustment.
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

/// What becomes of a camera whose depth cannot be calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UnsolvedDepth {
    /// An error: depth is what was asked for.
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
    /// Several cameras or depth, and no board that they saw.
    #[error("several sensors are solved by the board that they all see: give its size")]
    NoBoard,
    /// The views of the only camera leave it open.
    #[error("{0}")]
    Views(#[from] EstimationError),
    /// The only camera's sensors do not go together.
    #[error("{0}")]
    Sensors(#[from] RgbdError),
    /// Several cameras could not be placed.
    #[error("{0}")]
    Rig(#[from] RigError),
    /// The sensors of one of several cameras do not go together.
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
