//! A board's motion during the readout of one image.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::geometry::pose::Pose;

/// A board's motion in the camera's frame from the image's first row to its last, at constant
/// velocity. A view's pose is that at the middle row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewMotion {
    /// The rotation about `center_m`, as a rotation vector in the camera's frame, in radians.
    pub rotation_rad: Vector3<f64>,
    /// The translation of `center_m` in the camera's frame, in meters.
    pub translation_m: Vector3<f64>,
    /// A point of the board, in the board frame, in meters.
    pub center_m: Point3<f64>,
}

impl ViewMotion {
    /// The board's pose when a corner was read, given its pose at the middle row and the
    /// [`read_out_time`].
    ///
    /// ```
    /// use nalgebra::{Point3, Vector3};
    /// use plumb::estimation::view_motion::{ViewMotion, read_out_time};
    /// use plumb::geometry::pose::Pose;
    ///
    /// let motion = ViewMotion {
    ///     rotation_rad: Vector3::zeros(),
    ///     translation_m: Vector3::new(0.02, 0.0, 0.0),
    ///     center_m: Point3::origin(),
    /// };
    /// let at_middle = Pose::from_axis_angle(Vector3::zeros(), Vector3::new(0.0, 0.0, 1.0));
    /// // Half a readout of 480 rows before the middle.
    /// let at_top = motion.camera_from_board_at(&at_middle, read_out_time(-0.5, 480.0));
    /// assert!((at_top.translation().x + 0.01).abs() < 1e-12);
    /// ```
    pub fn camera_from_board_at(&self, camera_from_board: &Pose, read_out_time: f64) -> Pose {
        let moved = UnitQuaternion::from_scaled_axis(self.rotation_rad * read_out_time);
        let rotation = moved * camera_from_board.rotation();
        let center = *camera_from_board * self.center_m + self.translation_m * read_out_time;
        Pose::new(rotation, center.coords - rotation * self.center_m.coords)
    }
}

/// When a pixel was read, relative to the middle of the readout and in units of its duration.
/// `along_px` is the pixel's coordinate in the direction of the readout, `length_px` the image's
/// length in this direction.
pub fn read_out_time(along_px: f64, length_px: f64) -> f64 {
    (along_px + 0.5) / length_px - 0.5
}
