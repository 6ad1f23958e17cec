//! The deviation of depth from the board's plane as color sees it, reading by reading.

use nalgebra::{Point3, Vector3};

use crate::geometry::depth_camera::DepthCamera;
use crate::geometry::median::median;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;

/// Measured − true depth at each pixel of a depth image, in meters, row by row; NaN outside the
/// board, and where nothing was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneError {
    /// The image's size.
    pub size: ImageSize,
    /// With depth as the device reports it.
    pub before_m: Vec<f32>,
    /// With corrected depth.
    pub after_m: Vec<f32>,
}

/// The board's surface extends this many squares beyond its outermost corners.
const MARGIN_SQUARES: f64 = 0.8;

/// A depth image of a board, with the board's pose by color.
#[derive(Debug, Clone, Copy)]
pub struct BoardInDepthImage<'a> {
    /// The depth camera.
    pub camera: &'a DepthCamera,
    /// Its pose in color's frame.
    pub color_from_depth: &'a Pose,
    /// The board.
    pub board: &'a Target,
    /// The board's pose in color's frame.
    pub color_from_board: &'a Pose,
    /// The image.
    pub image: &'a DepthImage,
    /// The value that means no reading, if there is one.
    pub invalid: Option<u16>,
}

/// The error of each reading on the board.
pub fn plane_error(seen: &BoardInDepthImage<'_>) -> PlaneError {
    let BoardInDepthImage { camera, image, invalid, .. } = *seen;
    let plane = SeenPlane::of(seen);
    let of = |(k, reading): (usize, &u16)| {
        let pixel = pixel_at(camera, k);
        let [point_in_depth, _] = plane.seen_at(pixel)?;
        let reading = (Some(*reading) != invalid).then_some(f64::from(*reading))?;
        let error = |inverse_depth: f64| (1.0 / inverse_depth - point_in_depth.z) as f32;
        Some((
            error(camera.reading.inverse_depth(reading)?),
            error(camera.inverse_depth(pixel, reading)?),
        ))
    };
    let errors =
        image.readings().iter().enumerate().map(|one| of(one).unwrap_or((f32::NAN, f32::NAN)));
    let (before_m, after_m) = errors.unzip();
    PlaneError { size: image.size(), before_m, after_m }
}

/// The error of corrected depth in one patch of a board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchError {
    /// The mean of the patch's points on the board's plane, in the depth camera's frame.
    pub point_in_depth: Point3<f64>,
    /// The board's normal in the depth camera's frame.
    pub normal_in_depth: Vector3<f64>,
    /// The median of measured − true depth, in meters.
    pub error_m: f64,
}

/// Patches of the board along x and y.
const PATCHES: [usize; 2] = [4, 3];
/// Patches with fewer readings are left out.
const LEAST_READINGS: usize = 12;

/// The errors of corrected depth in the patches of the board; patches with too few readings are
/// left out.
pub fn patch_errors(seen: &BoardInDepthImage<'_>) -> Vec<PatchError> {
    let BoardInDepthImage { camera, image, invalid, .. } = *seen;
    let plane = SeenPlane::of(seen);
    let mut patches: Vec<Vec<(Point3<f64>, f64)>> = vec![Vec::new(); PATCHES[0] * PATCHES[1]];
    for (k, reading) in image.readings().iter().enumerate().filter(|(_, r)| Some(**r) != invalid) {
        let pixel = pixel_at(camera, k);
        let seen = plane.seen_at(pixel).zip(camera.inverse_depth(pixel, f64::from(*reading)));
        if let Some(([point_in_depth, point_in_board], inverse_depth)) = seen {
            let error_m = 1.0 / inverse_depth - point_in_depth.z;
            patches[plane.patch_of(&point_in_board)].push((point_in_depth, error_m));
        }
    }
    let normal_in_depth = plane.normal_in_depth;
    let patch = |readings: Vec<(Point3<f64>, f64)>| {
        let count = readings.len();
        let error_m = median(readings.iter().map(|(_, error_m)| *error_m).collect())?;
        let sum: Vector3<f64> = readings.iter().map(|(point, _)| point.coords).sum();
        let point_in_depth = Point3::from(sum / count as f64);
        (count >= LEAST_READINGS).then_some(PatchError { point_in_depth, normal_in_depth, error_m })
    };
    patches.into_iter().filter_map(patch).collect()
}

/// The pixel of the reading with index `k`, row by row.
fn pixel_at(camera: &DepthCamera, k: usize) -> Pixel {
    let width = camera.image_size.width.max(1) as usize;
    Pixel::new((k % width) as f64, (k / width) as f64)
}

/// The board's plane as predicted in the depth image.
struct SeenPlane<'a> {
    camera: &'a DepthCamera,
    board_from_depth: Pose,
    normal_in_depth: Vector3<f64>,
    distance_m: f64,
    /// The board's first and last corner on its surface, margins included.
    near: Point3<f64>,
    far: Point3<f64>,
}

impl<'a> SeenPlane<'a> {
    fn of(seen: &BoardInDepthImage<'a>) -> Self {
        let BoardInDepthImage { camera, color_from_depth, board, color_from_board, .. } = *seen;
        let depth_from_board = color_from_depth.inverse() * *color_from_board;
        let normal_in_depth = depth_from_board * Vector3::z();
        let margin_m = MARGIN_SQUARES * board.spanned_chessboard().square_m;
        let [near, far] = board.extent();
        let margin = Vector3::new(margin_m, margin_m, 0.0);
        Self {
            camera,
            board_from_depth: depth_from_board.inverse(),
            normal_in_depth,
            distance_m: normal_in_depth.dot(&depth_from_board.translation()),
            near: near - margin,
            far: far + margin,
        }
    }

    /// The point of the board at `pixel`, in the depth camera's frame and in the board's; `None`
    /// outside the board.
    fn seen_at(&self, pixel: Pixel) -> Option<[Point3<f64>; 2]> {
        let ray = self.camera.lens.bearing_from_pixel(pixel).filter(|bearing| bearing.z > 0.0)?;
        let ray = ray.into_inner() / ray.z;
        let plane_m = self.distance_m / self.normal_in_depth.dot(&ray);
        let point_in_depth = Point3::from(ray * plane_m);
        let point_in_board = self.board_from_depth * point_in_depth;
        let inside = |axis: usize| {
            point_in_board[axis] > self.near[axis] && point_in_board[axis] < self.far[axis]
        };
        (plane_m > 0.0 && inside(0) && inside(1)).then_some([point_in_depth, point_in_board])
    }

    fn patch_of(&self, point_in_board: &Point3<f64>) -> usize {
        let place = |axis: usize| {
            let part = (point_in_board[axis] - self.near[axis]) / (self.far - self.near)[axis];
            ((part * PATCHES[axis] as f64) as usize).min(PATCHES[axis] - 1)
        };
        place(1) * PATCHES[0] + place(0)
    }
}

/// Mean and root mean square of the finite errors, in meters; `None` if there are none.
pub fn mean_and_rms_m(errors_m: &[f32]) -> Option<[f64; 2]> {
    let known = || errors_m.iter().filter(|error| error.is_finite()).map(|error| f64::from(*error));
    let count = known().count();
    let mean = |sum: f64| sum / count as f64;
    (count > 0)
        .then(|| [mean(known().sum()), mean(known().map(|error| error * error).sum()).sqrt()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::depth_camera::DepthReading;
    use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
    use crate::geometry::lens::Lens;

    #[test]
    fn a_wrong_offset_is_the_error_before_and_gone_after() {
        let size = ImageSize::new(160, 120);
        let mut correction = DepthCorrection::none(
            CorrectedQuantity::Depth,
            1,
            SplineGrid::constant(size),
            [0.1, 9.0],
        );
        correction.coefficients = vec![-0.01];
        let camera = DepthCamera {
            image_size: size,
            lens: Lens::pinhole(CameraMatrix {
                fx: 150.0,
                fy: 150.0,
                cx: 79.5,
                cy: 59.5,
                skew: 0.0,
            }),
            reading: DepthReading::Metric { unit_m: 0.000_1 },
            correction: Some(correction),
        };
        let board: Target = Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap().into();
        let color_from_depth =
            Pose::from_axis_angle(Vector3::new(0.01, 0.0, 0.02), Vector3::new(0.03, 0.0, 0.0));
        let depth_from_board =
            Pose::from_axis_angle(Vector3::new(0.3, -0.2, 0.1), Vector3::new(-0.1, -0.1, 0.6));
        let normal = depth_from_board * Vector3::z();
        let readings = (0..160 * 120).map(|k| {
            let pixel = Pixel::new(f64::from(k % 160), f64::from(k / 160));
            let ray = camera.lens.bearing_from_pixel(pixel).unwrap();
            let z = normal.dot(&depth_from_board.translation())
                / normal.dot(&(ray.into_inner() / ray.z));
            if k % 7 == 0 { 0 } else { ((z + 0.01) * 1e4).round() as u16 }
        });
        let image = DepthImage::new(size, readings.collect()).unwrap();
        let color_from_board = color_from_depth * depth_from_board;
        let error = plane_error(&BoardInDepthImage {
            camera: &camera,
            color_from_depth: &color_from_depth,
            board: &board,
            color_from_board: &color_from_board,
            image: &image,
            invalid: None,
        });
        let [[before, _], [after, rms]] =
            [&error.before_m, &error.after_m].map(|all| mean_and_rms_m(all).unwrap());
        assert!(
            (before - 0.01).abs() < 1e-5 && after.abs() < 1e-5 && rms < 1e-4,
            "{before} {after} {rms}"
        );
        // The board, 0.288 by 0.198 m, its middle at 0.646 m, tilted by 0.36 rad.
        let seen = error.before_m.iter().filter(|one| one.is_finite()).count();
        let expected = 0.288 * 0.198 * (150.0_f64 / 0.646).powi(2) * 0.36_f64.cos() * 6.0 / 7.0;
        assert!(
            (0.95..1.05).contains(&(seen as f64 / expected)),
            "{seen}, expected about {expected}"
        );
        assert_eq!(mean_and_rms_m(&[f32::NAN]), None);
    }
}
