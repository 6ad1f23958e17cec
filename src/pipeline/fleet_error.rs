//! Errors of a fleet.

use crate::store::StoreError;

/// Why cameras or rigs were not started.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The sessions of an earlier run could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The system refused another thread.
    #[error("a thread for `{name}` could not be started: {detail}")]
    Thread {
        /// The camera's or rig's name.
        name: String,
        /// What the system said.
        detail: String,
    },
    /// A rig's camera is not running.
    #[error("rig `{rig}`: its camera `{camera}` is not running; see GET /v1/cameras")]
    NoCamera {
        /// The rig's name.
        rig: String,
        /// The camera's.
        camera: String,
    },
    /// The counters could not be set up.
    #[error("the metrics could not be set up: {detail}")]
    Metrics {
        /// What was wrong.
        detail: String,
    },
}

/// Why a calibration did not become current.
#[derive(Debug, thiserror::Error)]
pub enum ApproveError {
    /// No such calibration.
    #[error(
        "there is no calibration `{id}`; see GET /v1/cameras/{{camera}}/calibrations for those there are"
    )]
    UnknownCalibration {
        /// The id that was asked for.
        id: String,
    },
    /// Its camera or rig is not configured any more.
    #[error(
        "calibration {id} is of `{name}`, which is not configured any more: configure it again, then approve it"
    )]
    NotConfigured {
        /// The id that was asked for.
        id: String,
        /// The camera's or the rig's name.
        name: String,
    },
    /// It is of no camera.
    #[error(
        "calibration {id} belongs to no camera, so it cannot be approved: use one made by a session"
    )]
    NoCamera {
        /// The id that was asked for.
        id: String,
    },
    /// It could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}
