//! Stereo rectification: two cameras are rotated in software until they are parallel, so that a
//! point has the same row in both images.
//!
//! The method is J.-Y. Bouguet's, as in OpenCV's `stereoRectify` and `fisheye::stereoRectify` (both
//! with `CALIB_ZERO_DISPARITY`). Each camera is rotated by half of the rotation between them, then
//! both by the shortest rotation that aligns the baseline with an axis of the image. The cameras
//! get one focal length and one principal point.
//!
//! A single camera need not be parallel to another: its rectified images are those that a lens
//! without distortion would have taken, and the only choice is how much of its field of view they
//! show.

mod framing;
#[cfg(test)]
mod rectification_tests;

use nalgebra::{Matrix3, Matrix3x4, Matrix4, Point3, Quaternion, UnitQuaternion, Vector3, Vector4};

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use framing::RotatedCamera;

/// One of two cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoCamera {
    /// Its lens.
    pub lens: Lens,
    /// The size of its images.
    pub image_size: ImageSize,
}

/// The axis of the rectified images along which the cameras lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StereoAxis {
    /// Side by side: rows correspond.
    Horizontal,
    /// One above the other: columns correspond.
    Vertical,
}

/// Cameras that cannot be rectified.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum RectificationError {
    /// They have the same position.
    #[error("the cameras are at the same place: without a baseline there are no epipolar lines")]
    NoBaseline,
    /// One is in front of the other.
    #[error(
        "the baseline is {degrees:.0}° off the image plane: one camera is in front of the other, so the images cannot be rectified to common rows"
    )]
    Forward {
        /// The angle between the baseline and the image plane of the mean orientation.
        degrees: f64,
    },
}

/// A camera after rectification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RectifiedCamera {
    /// R: rotates coordinates in the camera's own frame to its rectified frame.
    pub rectified_from_camera: Matrix3<f64>,
    /// P: from homogeneous coordinates in the *first* rectified frame, in meters, to pixels of this
    /// camera's rectified image.
    pub projection: Matrix3x4<f64>,
}

/// Two cameras and their common rectified images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoRectification {
    /// The axis along which the cameras lie.
    pub axis: StereoAxis,
    /// The size of both rectified images: that of the first camera's images.
    pub image_size: ImageSize,
    /// In the order given.
    pub cameras: [RectifiedCamera; 2],
    /// The position of the first camera in the rectified frame of the second, along the axis, in
    /// meters: negative where the second one is the right one or the lower one.
    pub second_from_first_m: f64,
}

/// The largest angle of a baseline off the image plane. Half of a right angle: beyond it, most of
/// the rectified images would show what neither camera saw.
const MOST_FORWARD_DEGREES: f64 = 45.0;

impl StereoRectification {
    /// From two cameras, the second at `second_from_first`. With `alpha` 0 every pixel of the
    /// rectified images is inside both fields of view, with 1 the rectified images contain all of
    /// both.
    ///
    /// Lenses with a distorted image plane are framed as by OpenCV's `stereoRectify`, others (and
    /// pairs with one of them) as by `fisheye::stereoRectify`, whose `balance` is `alpha`.
    ///
    /// # Errors
    /// [`RectificationError`].
    pub fn new(
        cameras: &[StereoCamera; 2],
        second_from_first: &Pose,
        alpha: f64,
    ) -> Result<Self, RectificationError> {
        let (axis, rotations) = parallel(second_from_first)?;
        let [first, second] = cameras;
        let rotated = [(first, rotations[0]), (second, rotations[1])]
            .map(|(camera, rotation)| RotatedCamera { camera, rectified_from_camera: rotation });
        let alpha = alpha.clamp(0.0, 1.0);
        let matrix = framing::common_matrix(&rotated, axis, first.image_size, alpha);
        let second_from_first_m =
            (rotations[1] * second_from_first.translation())[axis.coordinate()];
        let camera = |rectified_from_camera, along_m: f64| {
            let mut projection = matrix.to_matrix().insert_column(3, 0.0);
            projection[(axis.coordinate(), 3)] = matrix.fx * along_m;
            RectifiedCamera { rectified_from_camera, projection }
        };
        Ok(Self {
            axis,
            image_size: first.image_size,
            cameras: [camera(rotations[0], 0.0), camera(rotations[1], second_from_first_m)],
            second_from_first_m,
        })
    }

    /// Q: from (x, y, disparity, 1) in the first rectified image, the disparity in pixels, to
    /// homogeneous coordinates in the first rectified frame, in meters (OpenCV's
    /// `reprojectImageTo3D`).
    pub fn point_from_disparity(&self) -> Matrix4<f64> {
        let CameraMatrix { fx, cx, cy, .. } = self.cameras[0].matrix();
        let mut q = Matrix4::identity();
        q.set_column(3, &Vector4::new(-cx, -cy, fx, 0.0));
        q[(2, 2)] = 0.0;
        q[(3, 2)] = -1.0 / self.second_from_first_m;
        q
    }
}

impl StereoAxis {
    /// The index of the coordinate along the axis.
    pub fn coordinate(self) -> usize {
        match self {
            Self::Horizontal => 0,
            Self::Vertical => 1,
        }
    }

    /// The coordinate that is equal in both rectified pixels of one point: the row, or the column.
    pub fn shared(self, pixel: Pixel) -> f64 {
        match self {
            Self::Horizontal => pixel.y,
            Self::Vertical => pixel.x,
        }
    }

    /// What corresponds, in words.
    pub fn lines(self) -> &'static str {
        match self {
            Self::Horizontal => "rows",
            Self::Vertical => "columns",
        }
    }

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Horizontal => "horizontal",
            Self::Vertical => "vertical",
        }
    }
}

impl RectifiedCamera {
    /// A single camera that keeps its orientation and its camera matrix.
    pub fn alone(matrix: &CameraMatrix) -> Self {
        Self {
            rectified_from_camera: Matrix3::identity(),
            projection: matrix.to_matrix().insert_column(3, 0.0),
        }
    }

    /// A single camera with `lens` and images of `image_size`, which keeps its orientation. Its
    /// rectified images are of the same size. With `alpha` 0 every pixel of them is inside the
    /// field of view, with 1 they contain all of it.
    ///
    /// The camera matrix is that of OpenCV's `getOptimalNewCameraMatrix`. For a lens that does not
    /// distort an image plane it is that of `fisheye::estimateNewCameraMatrixForUndistortRectify`,
    /// whose `balance` is `alpha`, and which frames by the midpoints of the image's sides alone. A
    /// lens without distortion keeps its own. Points beyond
    /// [`WIDEST`](crate::geometry::flat_image::WIDEST) off the axis count as if they were there.
    pub fn framed(lens: &Lens, image_size: ImageSize, alpha: f64) -> Self {
        if lens.model() == LensModel::Pinhole {
            return Self::alone(&lens.matrix);
        }
        let camera = StereoCamera { lens: *lens, image_size };
        let rotated = RotatedCamera { camera: &camera, rectified_from_camera: Matrix3::identity() };
        Self::alone(&framing::own_matrix(&rotated, alpha.clamp(0.0, 1.0)))
    }

    /// The camera matrix of the rectified image.
    pub fn matrix(&self) -> CameraMatrix {
        let p = &self.projection;
        CameraMatrix { fx: p[(0, 0)], fy: p[(1, 1)], cx: p[(0, 2)], cy: p[(1, 2)], skew: p[(0, 1)] }
    }

    /// The pixel in the camera with `lens` that is shown at `rectified`; `None` outside its field
    /// of view.
    pub fn pixel_from_rectified(&self, lens: &Lens, rectified: Pixel) -> Option<Pixel> {
        let flat = self.matrix().normalized_from_pixel(rectified);
        let ray = self.rectified_from_camera.tr_mul(&Vector3::new(flat.x, flat.y, 1.0));
        lens.pixel_from_point(&Point3::from(ray))
    }

    /// The position in the rectified image of `pixel` of the camera with `lens`; `None` for a
    /// direction that a flat image cannot show.
    pub fn rectified_from_pixel(&self, lens: &Lens, pixel: Pixel) -> Option<Pixel> {
        let ray = self.rectified_from_camera * lens.bearing_from_pixel(pixel)?.into_inner();
        (ray.z > 0.0).then(|| self.matrix().pixel_from_normalized(ray.xy() / ray.z))
    }
}

/// The rotations that make two cameras parallel, and the axis along which they then lie.
fn parallel(
    second_from_first: &Pose,
) -> Result<(StereoAxis, [Matrix3<f64>; 2]), RectificationError> {
    let half_back = second_from_first.rotation().powf(-0.5);
    let baseline = half_back * second_from_first.translation();
    let length = baseline.norm();
    if !(length > 0.0 && length.is_finite()) {
        return Err(RectificationError::NoBaseline);
    }
    let degrees = (baseline.z.abs() / length).asin().to_degrees();
    if degrees > MOST_FORWARD_DEGREES {
        return Err(RectificationError::Forward { degrees });
    }
    let axis = match baseline.x.abs() > baseline.y.abs() {
        true => StereoAxis::Horizontal,
        false => StereoAxis::Vertical,
    };
    let mut along = Vector3::zeros();
    along[axis.coordinate()] = baseline[axis.coordinate()].signum();
    // The shortest rotation between two directions, the cosine of whose angle is over 1/2 here.
    let direction = baseline / length;
    let to_axis = UnitQuaternion::from_quaternion(Quaternion::from_parts(
        1.0 + direction.dot(&along),
        direction.cross(&along),
    ));
    let matrix = |rotation: UnitQuaternion<f64>| rotation.to_rotation_matrix().into_inner();
    Ok((axis, [matrix(to_axis * half_back.inverse()), matrix(to_axis * half_back)]))
}
