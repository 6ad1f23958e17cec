//! Rigid transforms, named for what they map: `a_from_b` maps coordinates in b to coordinates in a.

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point3, Quaternion, Rotation3, Translation3, UnitQuaternion,
    Vector3, Vector6,
};

/// A rigid transform between two frames. A value is named `a_from_b`, and `p_a = a_from_b * p_b`.
///
/// Translation in meters; the rotation's quaternion is kept with w ≥ 0, so that equal rotations are
/// equal values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    isometry: Isometry3<f64>,
}

impl Pose {
    /// The transform that changes nothing.
    pub fn identity() -> Self {
        Self { isometry: Isometry3::identity() }
    }

    /// From a rotation and a translation in meters: `p_a = rotation · p_b + translation`.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        let q = rotation.into_inner();
        let q = if q.w < 0.0 { Quaternion::from(-q.coords) } else { q };
        Self {
            isometry: Isometry3::from_parts(
                Translation3::from(translation),
                UnitQuaternion::new_unchecked(q),
            ),
        }
    }

    /// From a rotation matrix (orthonormal, determinant +1) and a translation in meters.
    pub fn from_matrix(rotation: &Matrix3<f64>, translation: Vector3<f64>) -> Self {
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
        Self::new(rotation, translation)
    }

    /// From an axis-angle (Rodrigues) vector in radians and a translation in meters.
    pub fn from_axis_angle(axis_angle: Vector3<f64>, translation: Vector3<f64>) -> Self {
        Self::new(UnitQuaternion::from_scaled_axis(axis_angle), translation)
    }

    /// The rotation, with w ≥ 0.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.isometry.rotation
    }

    /// The rotation as a 3×3 matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.isometry.rotation.to_rotation_matrix().into_inner()
    }

    /// The translation, in meters: the position of b's origin in a.
    pub fn translation(&self) -> Vector3<f64> {
        self.isometry.translation.vector
    }

    /// `b_from_a`, given `a_from_b`.
    pub fn inverse(&self) -> Self {
        let inverse = self.isometry.inverse();
        Self::new(inverse.rotation, inverse.translation.vector)
    }

    /// The derivative of the inverse by a rotation ω about a's axes and a translation τ: (−Rᵀω,
    /// −Rᵀτ + t' × Rᵀω), with t' the inverse's translation.
    pub(crate) fn inverse_jacobian(&self) -> Matrix6<f64> {
        let b_from_a = self.inverse();
        let rotation = b_from_a.rotation_matrix();
        let mut jacobian = Matrix6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rotation);
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rotation);
        let by_rotation = b_from_a.translation().cross_matrix() * rotation;
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&by_rotation);
        jacobian
    }

    /// The rotation angle between this pose and `other`, in radians.
    pub fn angle_to(&self, other: &Self) -> f64 {
        self.isometry.rotation.angle_to(&other.isometry.rotation)
    }
}

impl std::ops::Mul<Pose> for Pose {
    type Output = Pose;
    fn mul(self, b_from_c: Pose) -> Pose {
        let product = self.isometry * b_from_c.isometry;
        Pose::new(product.rotation, product.translation.vector)
    }
}

impl std::ops::Mul<Point3<f64>> for Pose {
    type Output = Point3<f64>;
    fn mul(self, point_in_b: Point3<f64>) -> Point3<f64> {
        self.isometry * point_in_b
    }
}

impl std::ops::Mul<Vector3<f64>> for Pose {
    type Output = Vector3<f64>;
    fn mul(self, direction_in_b: Vector3<f64>) -> Vector3<f64> {
        self.isometry.rotation * direction_in_b
    }
}

/// The six components of a small change of a pose: its rotation vector in radians, then its
/// translation in meters.
pub(crate) fn pose_step(rotation: &Vector3<f64>, translation: &Vector3<f64>) -> Vector6<f64> {
    Vector6::from_fn(|row, _| if row < 3 { rotation[row] } else { translation[row - 3] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn composition_inverse_and_sign() {
        let a_from_b =
            Pose::from_axis_angle(Vector3::new(0.3, -2.9, 0.4), Vector3::new(1.0, 2.0, -0.5));
        let b_from_c =
            Pose::from_axis_angle(Vector3::new(-1.0, 0.2, 2.5), Vector3::new(0.1, 0.0, 3.0));
        let point_in_c = Point3::new(0.2, -0.7, 1.1);
        let twice = a_from_b * (b_from_c * point_in_c);
        assert!((twice - (a_from_b * b_from_c) * point_in_c).norm() < 1e-14);
        assert!((a_from_b.inverse() * (a_from_b * point_in_c) - point_in_c).norm() < 1e-14);
        assert!(a_from_b.rotation().w >= 0.0 && (a_from_b * b_from_c).rotation().w >= 0.0);
    }

    #[test]
    fn the_inverse_moves_as_its_jacobian_says() {
        const STEP: f64 = 1e-6;
        let a_from_b =
            Pose::from_axis_angle(Vector3::new(0.3, -0.9, 0.4), Vector3::new(1.0, 2.0, -0.5));
        let moved = |step: &Vector6<f64>| {
            let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
            let translation = a_from_b.translation() + step.fixed_rows::<3>(3);
            Pose::new(rotation * a_from_b.rotation(), translation).inverse()
        };
        let jacobian = a_from_b.inverse_jacobian();
        for axis in 0..6 {
            let step = Vector6::ith(axis, STEP);
            let [after, before] = [moved(&step), moved(&-step)];
            let rotation = (after.rotation() * before.rotation().inverse()).scaled_axis();
            let numeric = pose_step(&rotation, &(after.translation() - before.translation()));
            let difference = numeric / (2.0 * STEP) - jacobian.column(axis);
            assert!(difference.norm() < 1e-8, "{axis}: {difference}");
        }
    }
}
