//! A camera with color, infrared and depth sensors, and a board that is moved in front of it.

use nalgebra::{UnitQuaternion, Vector3};
use rand::RngExt;

use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Brown, Distortion, DistortionModel, Lens};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;
use crate::imaging::gray::GrayImage;
use crate::simulation::background::Background;
use crate::simulation::board_pattern::BoardPattern;
use crate::simulation::depth_sensor::{
    DepthError, DepthRenderer, DepthScene, SimulatedDepthSensor,
};
use crate::simulation::image_sensor::ImageSensor;
use crate::simulation::noise::{Purpose, stream};
use crate::simulation::renderer::Renderer;
use crate::simulation::world::{FrameTruth, World, WorldOptions, exposed};

/// What is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdOptions {
    /// The color camera, the board and its motion.
    pub color: WorldOptions,
    /// The infrared camera: its lens and size are the depth camera's.
    pub infrared: ImageSensor,
    /// The depth camera.
    pub depth: SimulatedDepthSensor,
    /// The pose of the depth and infrared camera.
    pub color_from_depth: Pose,
    /// By how much infrared and depth are taken later than the color image they come with, in
    /// seconds.
    pub time_offset_s: f64,
    /// The wall behind the board in the depth camera's frame: its distance along the optical axis
    /// in meters, and its slopes in x and y.
    pub wall: [f64; 3],
}

impl RgbdOptions {
    /// A stereo depth camera beside the color camera of `color`: 25 mm away and rotated by a
    /// degree, 640 × 480, with an error of some per cent; lens, pose and error follow from the
    /// seed.
    pub fn new(color: WorldOptions) -> Self {
        // Each camera of a rig has a depth device of its own.
        let number = color.seat.map_or(0, |seat| u64::from(seat.number));
        let mut rng = stream(color.seed, Purpose::Rig, number);
        let size = ImageSize::new(640, 480);
        let mut around = |middle: f64, spread: f64| middle + rng.random_range(-spread..spread);
        let lens = depth_lens(&mut around);
        let rotation = Vector3::new(around(0.0, 0.01), around(0.0, 0.015), around(0.0, 0.006));
        let translation =
            Vector3::new(around(0.025, 0.003), around(0.0, 0.001), around(0.001, 0.001));
        let error = depth_error(&mut around);
        let depth = SimulatedDepthSensor {
            size,
            lens,
            unit_m: 0.001,
            error,
            noise_per_m: 0.0018,
            step_per_m: 0.002,
            disparity_px_m: 28.0,
            holes: 20,
            dropout: 0.002,
        };
        let infrared = ImageSensor {
            blur_px: 0.9,
            full_well_e: 3000.0,
            vignetting: 0.4,
            gamma: 1.0,
            exposure_s: color.sensor.exposure_s,
            ..ImageSensor::new(size, lens)
        };
        let color_from_depth = Pose::new(UnitQuaternion::from_scaled_axis(rotation), translation);
        Self {
            color,
            infrared,
            depth,
            color_from_depth,
            time_offset_s: 0.0,
            wall: [1.8, 0.06, -0.03],
        }
    }
}

/// The lens of a depth camera of 640 × 480 pixels; `around` draws a number about a middle, within a
/// spread.
fn depth_lens(around: &mut impl FnMut(f64, f64) -> f64) -> Lens {
    let fx = around(575.0, 15.0);
    let matrix = CameraMatrix {
        fx,
        fy: fx * around(1.0, 0.002),
        cx: around(319.5, 5.0),
        cy: around(239.5, 5.0),
        skew: 0.0,
    };
    let brown =
        Brown::from_coefficients([around(-0.05, 0.02), around(0.02, 0.01), 2e-4, -1e-4, 0.0]);
    Lens { matrix, distortion: Distortion::Brown(brown) }
}

/// The error of its depth, drawn likewise.
fn depth_error(around: &mut impl FnMut(f64, f64) -> f64) -> DepthError {
    DepthError {
        scale: [
            around(0.006, 0.002),
            around(0.0, 0.002),
            around(0.0, 0.002),
            around(0.004, 0.002),
            0.0,
        ],
        offset: [
            around(0.004, 0.002),
            around(0.003, 0.001),
            around(-0.002, 0.001),
            around(0.006, 0.002),
            0.004,
        ],
    }
}

/// The images of one frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdFrame {
    /// The color camera's, gray.
    pub color: GrayImage,
    /// The infrared camera's.
    pub infrared: GrayImage,
    /// The depth camera's.
    pub depth: DepthImage,
    /// The ground truth of the color image.
    pub truth: FrameTruth,
    /// The pose of the board in the middle of the infrared image's exposure.
    pub infrared_from_board: Pose,
}

/// A simulated camera with three sensors: every frame is computed from its number alone.
#[derive(Debug, Clone)]
pub struct RgbdWorld {
    options: RgbdOptions,
    color: World,
    infrared: Renderer,
    depth: DepthRenderer,
}

impl RgbdWorld {
    /// The world that `options` describe.
    pub fn new(options: &RgbdOptions) -> Self {
        let pattern = BoardPattern::new(options.color.board);
        let background = Background::new(options.color.seed, options.color.clutter);
        Self {
            color: World::new(&options.color),
            infrared: Renderer::new(options.infrared.clone(), pattern, &background),
            depth: DepthRenderer::new(options.depth.clone()),
            options: options.clone(),
        }
    }

    /// What is simulated.
    pub fn options(&self) -> &RgbdOptions {
        &self.options
    }

    /// The `index`-th images.
    pub fn frame(&mut self, index: u64) -> RgbdFrame {
        // The infrared image's noise differs from the color image's, and from that of the other
        // cameras: a rig's cameras have numbers below 8, which begin at bit 40.
        const INFRARED: [u64; 2] = [1 << 40, 1 << 50];
        let number = self.options.color.seat.map_or(0, |seat| u64::from(seat.number));
        let infrared_index = INFRARED[usize::from(number > 0)] + (number << 40) + index;
        let color = self.color.frame(index);
        let depth_from_color = self.options.color_from_depth.inverse();
        let start_s = color.truth.time_s + self.options.time_offset_s;
        let color_camera = &mut self.color;
        let exposure = exposed(&mut self.infrared, start_s, |time_s| {
            depth_from_color * color_camera.camera_from_board(time_s)
        });
        let seed = self.options.color.seed;
        let infrared = self.infrared.sensor().develop(&exposure.light, seed, infrared_index);
        let pattern = self.infrared.pattern();
        let scene = DepthScene {
            pattern,
            depth_from_board: exposure.camera_from_board,
            wall: self.options.wall,
        };
        let depth = self.depth.image(&scene, seed, (number << 40) + index);
        let infrared_from_board = exposure.camera_from_board;
        RgbdFrame { color: color.image, infrared, depth, truth: color.truth, infrared_from_board }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_camera_of_a_rig_has_its_sensors_where_it_is() {
        let size = ImageSize::new(320, 240);
        let [left, right] = [0, 1].map(|seat| {
            let options = RgbdOptions::new(WorldOptions::on_rig(4, size, seat));
            (options.clone(), RgbdWorld::new(&options).frame(3))
        });
        let seat = right.0.color.seat.unwrap();
        for (options, frame) in [&left, &right] {
            let color_from_board = options.color_from_depth * frame.infrared_from_board;
            let truth = frame.truth.camera_from_board;
            let off_m = (color_from_board.translation() - truth.translation()).norm();
            assert!(off_m < 1e-12 && color_from_board.angle_to(&truth) < 1e-7, "{off_m}");
        }
        let through = seat.camera_from_first * left.1.truth.camera_from_board;
        let off_m = (through.translation() - right.1.truth.camera_from_board.translation()).norm();
        assert!(off_m < 1e-12, "{off_m}");
        assert_ne!(left.0.color_from_depth, right.0.color_from_depth, "another device");
        assert_ne!(left.1.infrared, right.1.infrared);
        assert_ne!(left.1.depth, right.1.depth);
    }

    #[test]
    fn the_sensors_see_one_board_and_the_offset_is_time() {
        let mut color = WorldOptions::new(4, ImageSize::new(320, 240));
        color.fps = 3.0;
        let options = RgbdOptions { time_offset_s: 0.05, ..RgbdOptions::new(color) };
        let mut world = RgbdWorld::new(&options);
        let mut together = RgbdWorld::new(&RgbdOptions { time_offset_s: 0.0, ..options.clone() });
        let mut moved: f64 = 0.0;
        for index in 0..4 {
            let (late, frame) = (world.frame(index), together.frame(index));
            let through_rig = options.color_from_depth * frame.infrared_from_board;
            let distance_m =
                (through_rig.translation() - frame.truth.camera_from_board.translation()).norm();
            assert!(
                distance_m < 1e-12 && through_rig.angle_to(&frame.truth.camera_from_board) < 1e-7,
                "{distance_m}"
            );
            assert_eq!((&late.color, late.truth), (&frame.color, frame.truth));
            let translation =
                late.infrared_from_board.translation() - frame.infrared_from_board.translation();
            moved = moved.max(translation.norm());
            let seen = frame.depth.readings().iter().filter(|reading| **reading > 0).count();
            assert!(seen * 10 > frame.depth.readings().len() * 7, "{seen} readings");
        }
        assert!(moved > 0.003, "{moved}");
    }
}
