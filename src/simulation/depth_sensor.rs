//! A stereo depth camera: its measurement of a scene, with all of its errors.
//!
//! All errors apply to inverse depth q = 1/z, which is what a stereo matcher measures:
//!
//! ```text
//! q' = q · (1 + scale(u, v)) + offset(u, v) + noise,   rounded to steps
//! reading = 1/q' in the device's unit,   rounded
//! ```
//!
//! so that noise and steps in z grow with z². Both fields are known smooth functions, see
//! [`DepthError`].

use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;
use crate::simulation::board_pattern::BoardPattern;
use crate::simulation::noise::{Purpose, stream};

/// The systematic error of inverse depth: two fields over the image. Each has five coefficients, of
/// 1, x, y, x² + y², sin(3x + 1) · cos(2.5y), where x and y are measured from the image's middle in
/// half widths.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthError {
    /// Relative, of q.
    pub scale: [f64; 5],
    /// Added to q, in 1/m.
    pub offset: [f64; 5],
}

impl DepthError {
    /// The measured inverse depth, without noise, where the true one is `inverse_depth`, in 1/m.
    pub fn measured(&self, inverse_depth: f64, pixel: Pixel, size: ImageSize) -> f64 {
        let half = 0.5 * f64::from(size.width);
        let center = size.center();
        let [x, y] = [(pixel.x - center.x) / half, (pixel.y - center.y) / half];
        let basis = [1.0, x, y, x * x + y * y, (3.0 * x + 1.0).sin() * (2.5 * y).cos()];
        let field = |coefficients: &[f64; 5]| {
            coefficients.iter().zip(basis).map(|(c, b)| c * b).sum::<f64>()
        };
        inverse_depth * (1.0 + field(&self.scale)) + field(&self.offset)
    }
}

/// A depth camera.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedDepthSensor {
    /// Its size in pixels.
    pub size: ImageSize,
    /// Its optics.
    pub lens: Lens,
    /// Meters per unit of a reading.
    pub unit_m: f64,
    /// Its systematic error.
    pub error: DepthError,
    /// σ of a reading's noise in inverse depth, in 1/m.
    pub noise_per_m: f64,
    /// Quantization step of inverse depth, in 1/m: that of a matcher's smallest fraction of a
    /// pixel.
    pub step_per_m: f64,
    /// Focal length times baseline, in pixel meters: disparity is this times inverse depth. Nothing
    /// is measured in the band on the left that the second camera does not see, nor in the
    /// occlusion to the left of an object in front.
    pub disparity_px_m: f64,
    /// Patches in each image where matching fails.
    pub holes: usize,
    /// Part of the pixels where it fails independently.
    pub dropout: f64,
}

/// The scene in front of the depth camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DepthScene<'a> {
    pub pattern: &'a BoardPattern,
    pub depth_from_board: Pose,
    /// The wall's distance along the optical axis, and its slopes in x and y.
    pub wall: [f64; 3],
}

/// A depth sensor with the ray of each pixel.
#[derive(Debug, Clone)]
pub(super) struct DepthRenderer {
    pub sensor: SimulatedDepthSensor,
    rays: Vec<Option<[f64; 2]>>,
}

/// The ground truth at each pixel, row by row.
#[derive(Debug, Clone)]
pub(super) struct TrueDepth {
    /// 1/z in 1/m, 0 where nothing is seen.
    pub inverse: Vec<f64>,
    /// The object that the pixel shows: at the edge between two objects, matching fails.
    pub thing: Vec<u64>,
}

/// The number of the board as an object; that of the wall behind it is 0.
const BOARD: u64 = 1;

impl DepthRenderer {
    pub(super) fn new(sensor: SimulatedDepthSensor) -> Self {
        let ImageSize { width, height } = sensor.size;
        let rays = (0..height)
            .flat_map(|y| (0..width).map(move |x| Pixel::new(f64::from(x), f64::from(y))))
            .map(|pixel| sensor.lens.bearing_from_pixel(pixel))
            .map(|ray| ray.filter(|ray| ray.z > 0.05).map(|ray| [ray.x / ray.z, ray.y / ray.z]))
            .collect();
        Self { sensor, rays }
    }

    /// The `index`-th depth image of `seed`.
    pub(super) fn image(&self, scene: &DepthScene<'_>, seed: u64, index: u64) -> DepthImage {
        self.measured(&self.true_depth(scene), seed, index)
    }

    /// The ray of each pixel, row by row, with z = 1; `None` where the lens has no ray.
    pub(super) fn rays(&self) -> impl Iterator<Item = Option<Vector3<f64>>> + '_ {
        self.rays.iter().map(|ray| ray.map(|[x, y]| Vector3::new(x, y, 1.0)))
    }

    /// The sensor's measurement of the ground truth, as the `index`-th depth image of `seed`.
    pub(super) fn measured(&self, truth: &TrueDepth, seed: u64, index: u64) -> DepthImage {
        let mut rng = stream(seed, Purpose::Depth, index);
        let mut blind = self.unmatched(truth);
        self.add_holes(&mut blind, &mut rng);
        let width = self.sensor.size.width as usize;
        let readings = truth.inverse.iter().zip(&blind).enumerate().map(|(k, (inverse, blind))| {
            // Drawn for every pixel, so that a hole changes no other pixel's noise.
            let noise: f64 = rng.sample(StandardNormal);
            let dropped = rng.random_bool(self.sensor.dropout.clamp(0.0, 1.0));
            if *blind || dropped || *inverse <= 0.0 {
                return 0;
            }
            self.reading(*inverse, Pixel::new((k % width) as f64, (k / width) as f64), noise)
        });
        DepthImage::new(self.sensor.size, readings.collect()).unwrap_or_default()
    }

    fn reading(&self, inverse_depth: f64, pixel: Pixel, noise: f64) -> u16 {
        let SimulatedDepthSensor { error, size, noise_per_m, step_per_m, unit_m, .. } =
            &self.sensor;
        let measured = error.measured(inverse_depth, pixel, *size) + noise_per_m * noise;
        let stepped =
            if *step_per_m > 0.0 { (measured / step_per_m).round() * step_per_m } else { measured };
        let units = (1.0 / (stepped * unit_m)).round();
        if units >= 1.0 && units <= f64::from(u16::MAX) { units as u16 } else { 0 }
    }

    fn true_depth(&self, scene: &DepthScene<'_>) -> TrueDepth {
        let side = scene.pattern.board.square_m;
        let [left, right, top, bottom] = scene.pattern.edges_in_squares();
        let board_from_depth = scene.depth_from_board.inverse();
        let normal = scene.depth_from_board * Vector3::z();
        let height = normal.dot(&scene.depth_from_board.translation());
        let [distance, slope_x, slope_y] = scene.wall;
        let one = |ray: &Option<[f64; 2]>| {
            let Some([x, y]) = *ray else { return (0.0, 0) };
            // The plane n · p = h along the ray (x, y, 1) · z: 1/z = n · ray / h.
            let board = normal.dot(&Vector3::new(x, y, 1.0)) / height;
            let wall = (1.0 - slope_x * x - slope_y * y) / distance;
            if board > 0.0 {
                let at =
                    board_from_depth * nalgebra::Point3::new(x / board, y / board, 1.0 / board);
                let [u, v] = [at.x / side, at.y / side];
                if board > wall && u > left && u < right && v > top && v < bottom {
                    return (board, BOARD);
                }
            }
            (wall.max(0.0), 0)
        };
        let (inverse, thing) = self.rays.iter().map(one).unzip();
        TrueDepth { inverse, thing }
    }

    /// Where matching fails: at edges of objects, where the second camera's view is occluded, and
    /// to the left of its view.
    fn unmatched(&self, truth: &TrueDepth) -> Vec<bool> {
        // Half the side of the window that is matched, in pixels: of 5 × 5 pixels.
        const WINDOW: usize = 2;
        let width = self.sensor.size.width as usize;
        let height = self.sensor.size.height as usize;
        let mut blind = vec![false; truth.inverse.len()];
        for (y, row) in truth.inverse.chunks_exact(width).enumerate() {
            let disparity = |x: usize| row[x] * self.sensor.disparity_px_m;
            // Of all points at one pixel of the second camera, it sees only the nearest.
            let mut nearest = vec![0.0_f64; width];
            for x in 0..width {
                let there = x as f64 - disparity(x);
                if there >= 0.0 {
                    let slot = &mut nearest[there.round() as usize];
                    *slot = slot.max(disparity(x));
                }
            }
            for x in 0..width {
                let there = x as f64 - disparity(x);
                blind[y * width + x] =
                    there < 0.0 || nearest[there.round() as usize] > disparity(x) + 1.5;
            }
        }
        for y in 0..height {
            for x in 0..width {
                let here = truth.thing[y * width + x];
                let rows = y.saturating_sub(WINDOW)..(y + WINDOW + 1).min(height);
                let columns = x.saturating_sub(WINDOW)..(x + WINDOW + 1).min(width);
                let edge = rows
                    .clone()
                    .any(|y| columns.clone().any(|x| truth.thing[y * width + x] != here));
                blind[y * width + x] |= edge;
            }
        }
        blind
    }

    fn add_holes(&self, blind: &mut [bool], rng: &mut ChaCha8Rng) {
        let (width, height) = (self.sensor.size.width as usize, self.sensor.size.height as usize);
        for _ in 0..self.sensor.holes {
            let center =
                [rng.random_range(0.0..width as f64), rng.random_range(0.0..height as f64)];
            let radius = [rng.random_range(2.0..10.0), rng.random_range(2.0..10.0)];
            let first = [0, 1].map(|axis| (center[axis] - radius[axis]).max(0.0) as usize);
            for y in first[1]..height.min((center[1] + radius[1]) as usize + 1) {
                for x in first[0]..width.min((center[0] + radius[0]) as usize + 1) {
                    let [dx, dy] =
                        [(x as f64 - center[0]) / radius[0], (y as f64 - center[1]) / radius[1]];
                    blind[y * width + x] |= dx * dx + dy * dy < 1.0;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::camera_matrix::CameraMatrix;

    fn sensor() -> SimulatedDepthSensor {
        let matrix = CameraMatrix { fx: 140.0, fy: 140.0, cx: 79.5, cy: 59.5, skew: 0.0 };
        SimulatedDepthSensor {
            size: ImageSize::new(160, 120),
            lens: Lens::pinhole(matrix),
            unit_m: 0.0001,
            error: DepthError::default(),
            noise_per_m: 0.0,
            step_per_m: 0.0,
            disparity_px_m: 7.0,
            holes: 0,
            dropout: 0.0,
        }
    }

    fn image(sensor: SimulatedDepthSensor, depth_from_board: Pose) -> DepthImage {
        let pattern =
            BoardPattern::new(Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.04).unwrap());
        let scene = DepthScene { pattern: &pattern, depth_from_board, wall: [2.0, 0.0, 0.0] };
        DepthRenderer::new(sensor).image(&scene, 5, 0)
    }

    fn tilted() -> Pose {
        Pose::from_axis_angle(Vector3::new(0.2, -0.4, 0.1), Vector3::new(-0.15, -0.1, 0.8))
    }

    #[test]
    fn without_errors_a_reading_is_the_plane_s_depth() {
        let image = image(sensor(), tilted());
        let normal = tilted() * Vector3::z();
        let matrix = sensor().lens.matrix;
        for (x, y) in [(80, 60), (70, 50), (95, 66)] {
            let ray = matrix.normalized_from_pixel(Pixel::new(f64::from(x), f64::from(y)));
            let z =
                normal.dot(&tilted().translation()) / normal.dot(&Vector3::new(ray.x, ray.y, 1.0));
            let reading = f64::from(image.row(y as usize)[x as usize]) * 0.0001;
            assert!((reading - z).abs() < 0.000_06, "{reading} not {z}");
        }
        assert_eq!(image.row(2)[150], 20_000, "the wall");
    }

    #[test]
    fn shadows_lie_left_of_the_board_and_of_the_image() {
        let image =
            image(sensor(), Pose::from_axis_angle(Vector3::zeros(), Vector3::new(-0.1, -0.1, 0.7)));
        let row = image.row(60);
        // The wall's disparity is 3.5 px, the board's 10: six pixels and a half are hidden, and two
        // more are its edge.
        assert!(row[..3].iter().all(|reading| *reading == 0) && row[5] == 20_000, "{row:?}");
        let first = row.iter().position(|reading| *reading > 0 && *reading < 10_000).unwrap();
        let before = row[..first].iter().rev().take_while(|reading| **reading == 0).count();
        assert!((8..=12).contains(&before), "{before}");
        let last = row.iter().rposition(|reading| *reading > 0 && *reading < 10_000).unwrap();
        let after = row[last + 1..].iter().take_while(|reading| **reading == 0).count();
        assert!((3..=5).contains(&after), "{after}");
    }

    #[test]
    fn noise_grows_with_the_square_of_depth_and_the_error_is_as_stated() {
        for distance in [0.5, 1.0] {
            let error = DepthError {
                scale: [0.01, 0.0, 0.0, 0.0, 0.0],
                offset: [0.005, 0.0, 0.0, 0.0, 0.0],
            };
            let noisy =
                SimulatedDepthSensor { error, noise_per_m: 0.002, unit_m: 0.000_02, ..sensor() };
            let square_on =
                Pose::from_axis_angle(Vector3::zeros(), Vector3::new(-0.16, -0.1, distance));
            let image = image(noisy, square_on);
            let values: Vec<f64> = (50..70)
                .flat_map(|y| image.row(y)[60..100].to_vec())
                .map(|reading| f64::from(reading) * 0.000_02)
                .collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
                / values.len() as f64)
                .sqrt();
            let expected = 1.0 / (1.01 / distance + 0.005);
            assert!(
                (mean - expected).abs() < 4.0 * std / (values.len() as f64).sqrt(),
                "{mean} not {expected}"
            );
            assert!((std / (0.002 * expected * expected) - 1.0).abs() < 0.1, "{std}");
        }
    }
}
