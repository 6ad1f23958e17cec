//! Poses as unit quaternion and translation.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::document::error::{DocumentError, physical};
use crate::geometry::physical::TRANSLATION_M;
use crate::geometry::pose::Pose;

/// How far a quaternion's length may be from 1.
const UNIT_TOLERANCE: f64 = 1e-6;

/// A rotation as a unit quaternion with w ≥ 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RotationDocument {
    /// The real part, cos(θ/2).
    pub w: f64,
    /// sin(θ/2) · axis, x.
    pub x: f64,
    /// sin(θ/2) · axis, y.
    pub y: f64,
    /// sin(θ/2) · axis, z.
    pub z: f64,
}

/// A pose `a_from_b`: p_a = rotation · p_b + translation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PoseDocument {
    /// The rotation.
    pub rotation: RotationDocument,
    /// The translation, in meters.
    pub translation: [f64; 3],
}

impl From<&Pose> for PoseDocument {
    fn from(a_from_b: &Pose) -> Self {
        let q = a_from_b.rotation().into_inner();
        Self {
            rotation: RotationDocument { w: q.w, x: q.i, y: q.j, z: q.k },
            translation: a_from_b.translation().into(),
        }
    }
}

impl TryFrom<&PoseDocument> for Pose {
    type Error = DocumentError;
    fn try_from(a_from_b: &PoseDocument) -> Result<Self, DocumentError> {
        let RotationDocument { w, x, y, z } = a_from_b.rotation;
        let quaternion = Quaternion::new(w, x, y, z);
        let length = quaternion.norm();
        if length.is_nan() || (length - 1.0).abs() > UNIT_TOLERANCE {
            return Err(DocumentError::field(
                "rotation",
                format!("has length {length}; a unit quaternion has length 1"),
            ));
        }
        for value in a_from_b.translation {
            physical("translation", value, &TRANSLATION_M)?;
        }
        // Not normalized again: a pose read back is the pose written, to the bit.
        Ok(Self::new(
            UnitQuaternion::new_unchecked(quaternion),
            Vector3::from(a_from_b.translation),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_survives_to_the_bit() {
        let a_from_b =
            Pose::from_axis_angle(Vector3::new(0.1, -2.0, 0.7), Vector3::new(0.1, 0.2, 1.0 / 3.0));
        assert_eq!(Pose::try_from(&PoseDocument::from(&a_from_b)), Ok(a_from_b));
    }

    #[test]
    fn a_quaternion_of_another_length_is_refused() {
        let rotation = RotationDocument { w: 1.0, x: 1.0, y: 0.0, z: 0.0 };
        let error = Pose::try_from(&PoseDocument { rotation, translation: [0.0; 3] }).unwrap_err();
        assert_eq!(error.path(), Some("rotation"));
    }
}
