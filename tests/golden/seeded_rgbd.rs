//! A seeded camera with color, infrared and depth: exact corners and planes, plus known noise and
//! a known error of depth.

use nalgebra::{Point3, Vector3};
use plumb::calibration::solve::rgbd_input::{DepthSensor, RgbdFrameSet, RgbdInput};
use plumb::estimation::camera::CameraOptions;
use plumb::estimation::interrupt::Interrupt;
use plumb::estimation::problem::{Correspondence, LensChoice};
use plumb::estimation::rgbd::{DepthLens, RgbdProblem, RgbdView};
use plumb::geometry::depth_camera::{DepthCamera, DepthReading, DepthTile};
use plumb::geometry::depth_correction::CorrectedQuantity;
use plumb::geometry::lens::{Lens, LensModel};
use plumb::geometry::pixel::{ImageSize, Pixel};
use plumb::geometry::pose::Pose;
use plumb::imaging::depth_image::DepthImage;
use plumb::simulation::DepthError;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use crate::seeded_camera::SeededCamera;

/// Readings in a patch of the board's surface.
const TILE: u32 = 100;

/// A color camera of 640×480 with a depth camera of 320×240 beside it.
pub struct SeededRgbd {
    pub color: SeededCamera,
    pub depth: SeededCamera,
    pub depth_from_color: Pose,
    pub error: DepthError,
    /// σ of a reading's 1/z, in 1/m.
    pub noise_per_m: f64,
    pub unit_m: f64,
    pub with_infrared: bool,
    /// What the board lies on: meters that it reaches past the corners.
    pub plate_m: f64,
    /// How far the wall behind is, in meters.
    pub wall_m: f64,
    /// How far the board is from its plane at (x, y) on it, all lengths in meters.
    pub height_m: fn(f64, f64) -> f64,
}

impl SeededRgbd {
    pub fn new() -> Self {
        let depth = [290.0, 291.0, 158.0, 121.0, 0.0, -0.04, 0.01, 0.0002, -0.0001, 0.0];
        Self {
            color: SeededCamera { tilt: 0.6, ..SeededCamera::ordinary() },
            depth: SeededCamera::new(LensModel::Brown, ImageSize::new(320, 240), &depth),
            depth_from_color: Pose::from_axis_angle(
                Vector3::new(0.004, -0.011, 0.003),
                Vector3::new(-0.025, 0.0012, 0.003),
            ),
            error: DepthError {
                scale: [0.006, 0.001, -0.001, 0.003, 0.0],
                offset: [0.004, 0.002, -0.001, 0.005, 0.003],
            },
            noise_per_m: 0.003,
            unit_m: 0.000_1,
            with_infrared: true,
            plate_m: 0.03,
            wall_m: 2.5,
            height_m: |_, _| 0.0,
        }
    }

    /// The same with a depth camera whose images the device itself has straightened.
    pub fn without_distortion(self) -> Self {
        let lens = Lens::pinhole(self.depth.lens.matrix);
        Self { depth: SeededCamera { lens, ..self.depth }, ..self }
    }

    /// Poses in which both cameras see the whole board.
    pub fn poses(&self, count: usize, rng: &mut ChaCha8Rng) -> Vec<Pose> {
        let mut poses = Vec::new();
        while poses.len() < count {
            let more = self.color.poses(1, rng);
            poses.extend(
                more.into_iter()
                    .filter(|pose| self.depth.exact(&(self.depth_from_color * *pose)).is_some()),
            );
        }
        poses
    }

    pub fn input(&self, poses: &[Pose], rng: &mut ChaCha8Rng) -> RgbdInput {
        let captures = poses.iter().enumerate().map(|(index, pose)| {
            let depth_from_board = self.depth_from_color * *pose;
            RgbdFrameSet {
                name: format!("view {index}"),
                time_s: None,
                is_view: true,
                color: self.corners(&self.color, pose, rng),
                infrared: if self.with_infrared {
                    self.corners(&self.depth, &depth_from_board, rng)
                } else {
                    Vec::new()
                },
                depth: Some(self.image(&depth_from_board, rng)),
            }
        });
        RgbdInput {
            board: self.color.board.into(),
            color_size: self.color.size,
            depth: DepthSensor {
                reading: Some(DepthReading::Metric { unit_m: self.unit_m }),
                invalid: None,
                factory: None,
                with_infrared: true,
            },
            frame_sets: captures.collect(),
        }
    }

    /// The joint problem itself: corners, and the board's surface as patches of `TILE` readings
    /// that are drawn, not rendered.
    pub fn problem(&self, poses: &[Pose], rng: &mut ChaCha8Rng) -> RgbdProblem {
        let view = |(index, pose): (usize, &Pose)| {
            let depth_from_board = self.depth_from_color * *pose;
            RgbdView {
                name: format!("view {index}"),
                color: self.corners(&self.color, pose, rng),
                infrared: if self.with_infrared {
                    self.corners(&self.depth, &depth_from_board, rng)
                } else {
                    Vec::new()
                },
                tiles: self.tiles(&depth_from_board, rng),
                surround: Vec::new(),
                color_from_board: *pose,
                motion: None,
            }
        };
        let views = poses.iter().enumerate().map(view).collect();
        RgbdProblem {
            color: self.color.lens,
            color_options: CameraOptions::default(),
            color_covariance: None,
            color_noise: 1.0,
            depth: DepthCamera {
                image_size: self.depth.size,
                lens: self.depth.lens,
                reading: DepthReading::Metric { unit_m: self.unit_m },
                correction: None,
            },
            depth_lens: if self.with_infrared {
                DepthLens::Infrared
            } else {
                DepthLens::FromPlanes
            },
            infrared_noise: 1.0,
            depth_from_color: self.depth_from_color,
            time_offset: None,
            corrected: vec![CorrectedQuantity::InverseDepth, CorrectedQuantity::Depth],
            views,
            interrupt: Interrupt::default(),
        }
    }

    fn tiles(&self, depth_from_board: &Pose, rng: &mut ChaCha8Rng) -> Vec<DepthTile> {
        let noise = Normal::new(0.0, self.noise_per_m / f64::from(TILE).sqrt()).unwrap();
        let normal = *depth_from_board * Vector3::z();
        let height = normal.dot(&depth_from_board.translation());
        let far = self.color.board.corners_in_board().last().copied().unwrap_or(Point3::origin());
        let part = |k: u32, count: u32, end: f64| {
            (f64::from(k) + 0.5) / f64::from(count) * (end + 2.0 * self.plate_m) - self.plate_m
        };
        let middle = |k: u32| Point3::new(part(k % 12, 12, far.x), part(k / 12, 8, far.y), 0.0);
        let tile = |k: u32| {
            let at = middle(k);
            let up_m = (self.height_m)(at.x, at.y);
            let at = at + Vector3::z() * up_m;
            let pixel = self.depth.lens.pixel_from_point(&(*depth_from_board * at))?;
            let pixel = self.depth.size.contains(pixel).then_some(pixel)?;
            let plane = normal.dot(&ray(&self.depth.lens, pixel)?) / (height + up_m);
            Some(DepthTile {
                pixel,
                inverse_depth: self.error.measured(plane, pixel, self.depth.size)
                    + noise.sample(rng),
                reading_std: self.noise_per_m,
                count: TILE,
            })
        };
        (0..96).filter_map(tile).collect()
    }

    pub fn options() -> CameraOptions {
        CameraOptions { lens: LensChoice::Model(LensModel::Brown), ..CameraOptions::default() }
    }

    /// The board on its plate before the wall.
    fn image(&self, depth_from_board: &Pose, rng: &mut ChaCha8Rng) -> DepthImage {
        let noise = Normal::new(0.0, self.noise_per_m).unwrap();
        let normal = *depth_from_board * Vector3::z();
        let height = normal.dot(&depth_from_board.translation());
        let board_from_depth = depth_from_board.inverse();
        let far = self.color.board.corners_in_board().last().copied().unwrap_or(Point3::origin());
        let size = self.depth.size;
        let readings = (0..size.height * size.width).map(|k| {
            let pixel = Pixel::new(f64::from(k % size.width), f64::from(k / size.width));
            let Some(ray) = ray(&self.depth.lens, pixel) else { return 0 };
            let along = normal.dot(&ray);
            let mut plate = along / height;
            let mut at = board_from_depth * Point3::from(ray / plate);
            // The surface under the ray, to a thousandth of its height.
            for _ in 0..3 {
                plate = along / (height + (self.height_m)(at.x, at.y));
                at = board_from_depth * Point3::from(ray / plate);
            }
            let reach = |along: f64, end: f64| along > -self.plate_m && along < end + self.plate_m;
            let on_plate = plate > 0.0 && reach(at.x, far.x) && reach(at.y, far.y);
            let inverse = if on_plate { plate } else { 1.0 / self.wall_m };
            let measured = self.error.measured(inverse, pixel, size) + noise.sample(rng);
            (1.0 / (measured * self.unit_m)).round().clamp(0.0, 65535.0) as u16
        });
        DepthImage::new(size, readings.collect()).unwrap()
    }

    /// The board's corners as `camera` sees them, with noise.
    fn corners(
        &self,
        camera: &SeededCamera,
        camera_from_board: &Pose,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Correspondence> {
        // A board that reaches out of the image is none.
        if camera.exact(camera_from_board).is_none() {
            return Vec::new();
        }
        let noise = Normal::new(0.0, 0.05).unwrap();
        let seen = |point_in_board: Point3<f64>| {
            let up = Vector3::z() * (self.height_m)(point_in_board.x, point_in_board.y);
            let point = *camera_from_board * (point_in_board + up);
            let exact = camera.lens.pixel_from_point(&point).unwrap();
            let pixel = Pixel::new(exact.x + noise.sample(rng), exact.y + noise.sample(rng));
            Correspondence { point_in_board, pixel, std_px: 0.05 }
        };
        camera.board.corners_in_board().into_iter().map(seen).collect()
    }
}

fn ray(lens: &Lens, pixel: Pixel) -> Option<Vector3<f64>> {
    let bearing = lens.bearing_from_pixel(pixel)?;
    Some(bearing.into_inner() / bearing.z)
}
