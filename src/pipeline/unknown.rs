//! Errors for names that are not configured.

/// No such camera is configured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("there is no camera `{camera}`; see GET /v1/cameras for those there are")]
pub struct UnknownCamera {
    /// The name that was asked for.
    pub camera: String,
}

/// No such rig is configured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("there is no rig `{rig}`; see GET /v1/rigs for those there are")]
pub struct UnknownRig {
    /// The name that was asked for.
    pub rig: String,
}
