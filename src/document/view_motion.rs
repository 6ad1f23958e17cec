//! How a board moved while the rows of an image were read.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::error::{DocumentError, physical};
use crate::estimation::view_motion::ViewMotion;
use crate::geometry::physical::TRANSLATION_M;

/// Motion of the board in the camera frame during readout, from the image's first row to its last,
/// at constant velocity. `camera_from_board` is the pose at the middle row; a corner in row y of an
/// image with h rows was read (y + 0.5) / h - 0.5 of this motion from there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ViewMotionDocument {
    /// The rotation about `center_m`, as a rotation vector in the camera's frame, in radians.
    pub rotation_rad: [f64; 3],
    /// The translation of `center_m` in the camera's frame, in meters.
    pub translation_m: [f64; 3],
    /// A point of the board, in the board frame, in meters.
    pub center_m: [f64; 3],
}

impl From<&ViewMotion> for ViewMotionDocument {
    fn from(motion: &ViewMotion) -> Self {
        Self {
            rotation_rad: motion.rotation_rad.into(),
            translation_m: motion.translation_m.into(),
            center_m: motion.center_m.coords.into(),
        }
    }
}

impl TryFrom<&ViewMotionDocument> for ViewMotion {
    type Error = DocumentError;
    fn try_from(document: &ViewMotionDocument) -> Result<Self, DocumentError> {
        let ViewMotionDocument { rotation_rad, translation_m, center_m } = *document;
        if !rotation_rad.iter().all(|v| v.is_finite()) {
            return Err(DocumentError::field("rotation_rad", "has a number that is not finite"));
        }
        for (name, values) in [("translation_m", translation_m), ("center_m", center_m)] {
            for value in values {
                physical(name, value, &TRANSLATION_M)?;
            }
        }
        Ok(Self {
            rotation_rad: Vector3::from(rotation_rad),
            translation_m: Vector3::from(translation_m),
            center_m: Point3::from(center_m),
        })
    }
}
