//! A camera, a board that is moved in front of it, and the resulting images.

use std::sync::Arc;

use rand::RngExt;

use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::{Brown, Distortion, DistortionModel, Lens};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::frame::{Frame, PixelFormat, SensorKind};
use crate::imaging::gray::GrayImage;
use crate::simulation::background::Background;
use crate::simulation::board_pattern::BoardPattern;
use crate::simulation::image_sensor::ImageSensor;
use crate::simulation::noise::{Purpose, stream};
use crate::simulation::renderer::Renderer;
use crate::simulation::seat::Seat;
use crate::simulation::walk::{Walk, WalkOptions};

/// What is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldOptions {
    /// The seed of everything random.
    pub seed: u64,
    /// Frames a second.
    pub fps: f64,
    /// The camera.
    pub sensor: ImageSensor,
    /// The board.
    pub board: Chessboard,
    /// The motion of the board.
    pub walk: WalkOptions,
    /// Rectangles on the wall behind it.
    pub clutter: usize,
    /// Where the camera is, unless it is the one in front of which the board is moved.
    pub seat: Option<Seat>,
}

impl WorldOptions {
    /// An ordinary camera with images of `size`, whose lens depends on the seed, at 15 frames a
    /// second, and a board of 9×6 inner corners with squares of 25 mm.
    pub fn new(seed: u64, size: ImageSize) -> Self {
        let board = Chessboard { size: BoardSize { cols: 9, rows: 6 }, square_m: 0.025 };
        let sensor = ImageSensor::new(size, ordinary_lens(seed, size));
        Self {
            seed,
            fps: 15.0,
            sensor,
            board,
            walk: WalkOptions::default(),
            clutter: 24,
            seat: None,
        }
    }
}

impl WorldOptions {
    /// As [`Self::new`] for the `number`-th camera of the rig of `seed`, which has a lens of its
    /// own. Number 0 is the camera of [`Self::new`].
    pub fn on_rig(seed: u64, size: ImageSize, number: u32) -> Self {
        let first = Self::new(seed, size);
        if number == 0 {
            return first;
        }
        let own =
            ImageSensor::new(size, ordinary_lens(seed.wrapping_add(u64::from(number) << 32), size));
        Self { seat: Some(Seat::on_rig(seed, number, first.sensor.lens)), sensor: own, ..first }
    }
}

/// A lens like those of cheap cameras: some 60° wide, with barrel distortion, and a principal point
/// a few pixels off the image's middle.
fn ordinary_lens(seed: u64, size: ImageSize) -> Lens {
    let mut rng = stream(seed, Purpose::Lens, 0);
    let width = f64::from(size.width);
    let center = size.center();
    let fx = width * rng.random_range(0.8..0.95);
    let matrix = CameraMatrix {
        fx,
        fy: fx * rng.random_range(0.997..1.003),
        cx: center.x + width * rng.random_range(-0.015..0.015),
        cy: center.y + width * rng.random_range(-0.015..0.015),
        skew: 0.0,
    };
    let k1 = rng.random_range(-0.28..-0.12);
    let k2 = 0.4 * k1 * k1 + rng.random_range(0.02..0.06);
    let tangential = [rng.random_range(-8e-4..8e-4), rng.random_range(-8e-4..8e-4)];
    let brown = Brown::from_coefficients([k1, k2, tangential[0], tangential[1], 0.0]);
    Lens { matrix, distortion: Distortion::Brown(brown) }
}

/// An image with its ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedFrame {
    /// The sensor's image.
    pub image: GrayImage,
    /// The ground truth.
    pub truth: FrameTruth,
}

impl SimulatedFrame {
    /// The frames of a camera without compression: mono8.
    pub fn into_frames(self) -> Vec<Frame> {
        let size = self.image.size();
        let (format, stride) = (PixelFormat::Mono8, size.width as usize);
        let bytes = Arc::from(self.image.into_pixels());
        vec![Frame { sensor: SensorKind::Color, size, format, stride, bytes }]
    }
}

/// The ground truth of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameTruth {
    /// The image's number, from 0.
    pub index: u64,
    /// The middle of the exposure, in seconds after that of the first image.
    pub time_s: f64,
    /// The pose of the board in the middle of the exposure.
    pub camera_from_board: Pose,
    /// The largest motion of the board's image during the exposure, in pixels.
    pub motion_px: f64,
}

/// A simulated camera: every image is computed from its number alone.
#[derive(Debug, Clone)]
pub struct World {
    seed: u64,
    fps: f64,
    walk: Walk,
    renderer: Renderer,
    seat: Option<Seat>,
}

impl World {
    /// The world that `options` describe.
    pub fn new(options: &WorldOptions) -> Self {
        let pattern = BoardPattern::new(options.board);
        let sensor = &options.sensor;
        let planned_for = options.seat.map_or(sensor.lens, |seat| seat.first_lens);
        let walk = Walk::new(options.seed, pattern, planned_for, sensor.size, &options.walk);
        let background = Background::new(options.seed, options.clutter);
        let renderer = Renderer::new(sensor.clone(), pattern, &background);
        Self { seed: options.seed, fps: options.fps, walk, renderer, seat: options.seat }
    }

    /// The camera.
    pub fn sensor(&self) -> &ImageSensor {
        self.renderer.sensor()
    }

    /// The board.
    pub fn board(&self) -> Chessboard {
        self.renderer.pattern().board
    }

    /// The ground truth of the `index`-th image.
    pub fn truth(&mut self, index: u64) -> FrameTruth {
        let time_s = index as f64 / self.fps;
        let Self { walk, renderer, seat, .. } = self;
        let pose = |time_s| seen_from(*seat, walk.camera_from_board(time_s));
        let (camera_from_board, motion_px) = motion(renderer, time_s, pose);
        FrameTruth { index, time_s, camera_from_board, motion_px }
    }

    /// The `index`-th image.
    pub fn frame(&mut self, index: u64) -> SimulatedFrame {
        let Self { walk, renderer, seat, .. } = self;
        let time_s = index as f64 / self.fps;
        let pose = |time_s| seen_from(*seat, walk.camera_from_board(time_s));
        let Exposure { light, camera_from_board, motion_px } = exposed(renderer, time_s, pose);
        let truth = FrameTruth { index, time_s, camera_from_board, motion_px };
        SimulatedFrame {
            image: self.sensor().develop(&light, self.seed, self.image_number(index)),
            truth,
        }
    }

    /// The `index`-th image of a board that moves from one pose to the other in the time of a
    /// frame, and goes on in the same way while the shutter is open.
    pub fn frame_carried(&mut self, index: u64, [before, now]: [Pose; 2]) -> SimulatedFrame {
        let time_s = index as f64 / self.fps;
        let (fps, seat) = (self.fps, self.seat);
        let carried = |at_s: f64| {
            let part = 1.0 + (at_s - time_s) * fps;
            let (from, to) = (before.rotation(), now.rotation());
            let rotation = from.try_slerp(&to, part, 1e-9).unwrap_or(to);
            let translation = before.translation().lerp(&now.translation(), part);
            seen_from(seat, Pose::new(rotation, translation))
        };
        let Exposure { light, camera_from_board, motion_px } =
            exposed(&mut self.renderer, time_s, carried);
        let truth = FrameTruth { index, time_s, camera_from_board, motion_px };
        SimulatedFrame {
            image: self.sensor().develop(&light, self.seed, self.image_number(index)),
            truth,
        }
    }

    /// The number of an image for its noise: no two cameras of a rig have the same.
    fn image_number(&self, index: u64) -> u64 {
        index + self.seat.map_or(0, |seat| u64::from(seat.number) << 40)
    }

    /// The pose of the board at a time, in this camera's frame.
    pub(super) fn camera_from_board(&mut self, time_s: f64) -> Pose {
        seen_from(self.seat, self.walk.camera_from_board(time_s))
    }

    /// The pixels of the board's inner corners in an image, row by row; `None` for corners outside
    /// the lens's view.
    pub fn corners(&self, truth: &FrameTruth) -> Vec<Option<Pixel>> {
        let corners = self.board().corners_in_board();
        let lens = &self.sensor().lens;
        corners
            .iter()
            .map(|corner| lens.pixel_from_point(&(truth.camera_from_board * *corner)))
            .collect()
    }
}

/// The pose in a camera in `seat` of a board that is at `first_from_board` in the first camera.
fn seen_from(seat: Option<Seat>, first_from_board: Pose) -> Pose {
    seat.map_or(first_from_board, |seat| seat.camera_from_first * first_from_board)
}

/// An exposed sensor.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Exposure {
    /// Light on each pixel.
    pub light: Vec<f32>,
    /// The pose of the board in the middle of the exposure.
    pub camera_from_board: Pose,
    /// The largest motion of the board's image.
    pub motion_px: f64,
}

/// Exposes from `start_s` on, with the board at `camera_from_board`(time).
pub(super) fn exposed(
    renderer: &mut Renderer,
    start_s: f64,
    mut camera_from_board: impl FnMut(f64) -> Pose,
) -> Exposure {
    // The largest motion from one pose of an exposure to the next, below a pixel, and the most
    // poses, which bound the time. Chosen.
    const STEP_PX: f64 = 0.6;
    const MOST_STEPS: f64 = 40.0;
    let (middle_from_board, motion_px) = motion(renderer, start_s, &mut camera_from_board);
    let steps = (motion_px / STEP_PX).ceil().clamp(1.0, MOST_STEPS) as usize;
    let exposure_s = renderer.sensor().exposure_s;
    let times = (0..steps).map(|step| start_s + exposure_s * (step as f64 + 0.5) / steps as f64);
    let camera_from_board: Vec<Pose> = times.map(camera_from_board).collect();
    Exposure {
        light: renderer.light(&camera_from_board),
        camera_from_board: middle_from_board,
        motion_px,
    }
}

/// The board's pose in the middle of the exposure that begins at `start_s`, and the largest motion
/// of its image during the exposure.
fn motion(
    renderer: &Renderer,
    start_s: f64,
    mut camera_from_board: impl FnMut(f64) -> Pose,
) -> (Pose, f64) {
    let half_s = 0.5 * renderer.sensor().exposure_s;
    let [before, middle_from_board, after] =
        [0.0, half_s, 2.0 * half_s].map(|since_s| camera_from_board(start_s + since_s));
    (middle_from_board, renderer.motion_px([&before, &after]))
}
