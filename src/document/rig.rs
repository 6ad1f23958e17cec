//! The rig document.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A configured rig: cameras that are fixed to each other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RigDocument {
    /// Its name in the configuration.
    pub name: String,
    /// The names of its cameras; the first is the rig's own frame.
    pub cameras: Vec<String>,
    /// The running session, if there is one.
    pub session: Option<String>,
    /// The current approved calibration, if there is one.
    pub calibration: Option<String>,
}

/// Every configured rig.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RigsDocument {
    /// In the order of the configuration.
    pub rigs: Vec<RigDocument>,
}
