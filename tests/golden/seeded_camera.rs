//! Seeded cameras and views with exact truth: where a board was, and what an exact camera sees of
//! it, plus known noise.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use plumb::estimation::camera::CameraEstimate;
use plumb::estimation::problem::{BoardView, CameraProblem, Correspondence};
use plumb::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use plumb::geometry::board::{BoardSize, Chessboard};
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// A camera of known lens in front of a board of known size.
#[derive(Clone)]
pub struct SeededCamera {
    pub lens: Lens,
    pub size: ImageSize,
    pub board: Chessboard,
    /// Standard deviation per axis of each corner, in pixels.
    pub noise_px: f64,
    /// The widest tilt of the board, in radians.
    pub tilt: f64,
}

impl SeededCamera {
    pub fn new(model: LensModel, size: ImageSize, parameters: &[f64]) -> Self {
        Self {
            lens: Lens::from_parameters(model, parameters).unwrap(),
            size,
            board: Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap(),
            noise_px: 0.1,
            tilt: 0.8,
        }
    }

    /// An ordinary lens: 640×480, 60° across.
    pub fn ordinary() -> Self {
        let parameters = [560.0, 555.0, 328.0, 235.0, 0.0, -0.22, 0.11, 0.0008, -0.0005, -0.02];
        Self::new(LensModel::Brown, ImageSize::new(640, 480), &parameters)
    }

    /// A narrow one: 1280×720, 23° across.
    pub fn narrow() -> Self {
        let parameters = [3100.0, 3100.0, 655.0, 350.0, 0.0, -0.1, 0.3, 0.0, 0.0, 0.0];
        Self::new(LensModel::Brown, ImageSize::new(1280, 720), &parameters)
    }

    /// A wide one: 1280×720, 100° across.
    pub fn wide() -> Self {
        let parameters = [540.0, 540.0, 630.0, 365.0, 0.0, -0.28, 0.09, 0.0003, -0.0002, -0.012];
        Self::new(LensModel::Brown, ImageSize::new(1280, 720), &parameters)
    }

    /// A fisheye: 1280×960, 170° across.
    pub fn fisheye() -> Self {
        let parameters = [430.0, 430.0, 645.0, 472.0, 0.0, -0.012, -0.004, 0.002, -0.0006];
        Self::new(LensModel::KannalaBrandt, ImageSize::new(1280, 960), &parameters)
    }

    pub fn rng(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    /// `count` poses in which every corner is inside the image: the board's middle anywhere, near
    /// and far, tilted.
    pub fn poses(&self, count: usize, rng: &mut ChaCha8Rng) -> Vec<Pose> {
        let mut poses = Vec::new();
        while poses.len() < count {
            poses.extend(self.pose(rng).filter(|pose| self.exact(pose).is_some()));
        }
        poses
    }

    fn pose(&self, rng: &mut ChaCha8Rng) -> Option<Pose> {
        let aim = Pixel::new(
            rng.random_range(0.05..0.95) * f64::from(self.size.width),
            rng.random_range(0.05..0.95) * f64::from(self.size.height),
        );
        let share: f64 = rng.random_range(0.3..0.75);
        let board_m = self.board.square_m * f64::from(self.board.size.cols - 1);
        let across_px = share * f64::from(self.size.width);
        let distance_m = board_m * self.lens.matrix.fx / across_px;
        let bearing = self.lens.bearing_from_pixel(aim)?;
        let azimuth: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let tilt =
            Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * rng.random_range(0.0..self.tilt);
        let roll = Vector3::z() * rng.random_range(-0.6..0.6);
        let facing = UnitQuaternion::rotation_between(&Vector3::z(), &bearing)?;
        let rotation = facing
            * UnitQuaternion::from_scaled_axis(tilt)
            * UnitQuaternion::from_scaled_axis(roll);
        let size = self.board.size;
        let middle = Vector3::new(f64::from(size.cols - 1), f64::from(size.rows - 1), 0.0)
            * (self.board.square_m / 2.0);
        Some(Pose::new(rotation, bearing.into_inner() * distance_m - rotation * middle))
    }

    /// Where each corner is seen, exactly; `None` unless all are inside the image.
    pub fn exact(&self, camera_from_board: &Pose) -> Option<Vec<Pixel>> {
        let corners = self.board.corners_in_board();
        corners.iter().map(|p| self.pixel(&(*camera_from_board * *p))).collect()
    }

    fn pixel(&self, point: &Point3<f64>) -> Option<Pixel> {
        self.lens.pixel_from_point(point).filter(|pixel| self.size.contains(*pixel))
    }

    /// The problem of these poses, with noise from `rng`.
    pub fn problem(&self, poses: &[Pose], rng: &mut ChaCha8Rng) -> CameraProblem {
        let noise = Normal::new(0.0, self.noise_px).unwrap();
        let corners = self.board.corners_in_board();
        let views = poses.iter().enumerate().map(|(index, pose)| {
            let pixels = self.exact(pose).unwrap();
            let seen = corners.iter().zip(pixels).map(|(point, pixel)| Correspondence {
                point_in_board: *point,
                pixel: Pixel::new(pixel.x + noise.sample(rng), pixel.y + noise.sample(rng)),
                std_px: 1.0,
            });
            BoardView { name: format!("view {index}"), correspondences: seen.collect() }
        });
        CameraProblem { image_size: self.size, views: views.collect() }
    }
}

/// The largest of some numbers; NaN if one of them is.
pub fn largest(numbers: impl IntoIterator<Item = f64>) -> f64 {
    numbers.into_iter().fold(0.0, |most, number| if number <= most { most } else { number })
}

/// The largest difference of an estimate's projections over the image from the truth, in the
/// standard deviations that are predicted there.
pub fn worst_projection_in_stds(truth: &Lens, estimate: &CameraEstimate) -> f64 {
    let grid = PixelGrid::over(estimate.image_size, 12);
    let predicted =
        projection_uncertainty(&estimate.lens, &estimate.lens_covariance, grid, Distance::Infinity)
            .unwrap();
    let seen = projection_difference(&estimate.lens, truth, grid, &predicted.weights);
    let all = seen.len();
    let in_stds: Vec<f64> = seen
        .iter()
        .zip(&predicted.std_px)
        .filter_map(|(seen, std)| Some(((*seen)?, (*std)?)))
        .map(|([x, y], std)| x.hypot(y) / std)
        .collect();
    // A fisheye sees nothing in the corners of the image.
    assert!(2 * in_stds.len() > all, "{} of {all} pixels are seen", in_stds.len());
    largest(in_stds)
}
