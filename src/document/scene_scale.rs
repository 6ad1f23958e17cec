//! How well the lengths of a scene are known.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::calibration::result::SceneScale;

/// The unit of lengths where depth gives it.
pub const METERS: &str = "m";

/// How well measured depth determines a scene's lengths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneScaleDocument {
    /// The relative standard deviation of a length: from the scatter of the readings, the focal
    /// length's uncertainty, and 1 % for the depth camera's own scale, which no scene reveals.
    pub relative_std: f64,
    /// How many measured depths of scene points it rests on.
    pub readings: usize,
    /// In how many images.
    pub views: usize,
}

impl From<SceneScale> for SceneScaleDocument {
    fn from(scale: SceneScale) -> Self {
        let SceneScale { relative_std, readings, views } = scale;
        Self { relative_std, readings, views }
    }
}

impl From<&SceneScaleDocument> for SceneScale {
    fn from(document: &SceneScaleDocument) -> Self {
        let SceneScaleDocument { relative_std, readings, views } = *document;
        Self { relative_std, readings, views }
    }
}
