//! The motion of the board: it moves from one place to the next, rests there for a moment, and
//! moves on.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::RngExt;

use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::simulation::board_pattern::BoardPattern;
use crate::simulation::noise::{Purpose, stream};
use crate::simulation::tremor::tremor;

/// How the board is moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WalkOptions {
    /// How long it rests at each place, in seconds; 0.4 by default.
    pub still_s: f64,
    /// How long it takes to the next place, in seconds; 0.6 by default.
    pub travel_s: f64,
    /// The largest tilt relative to the image plane, in radians; 50° by default.
    pub tilt: f64,
    /// The largest rotation about the optical axis, in radians; 25° by default.
    pub roll: f64,
    /// The card's width relative to the image's, at the farthest and the nearest place; 0.38 and
    /// 0.8 by default.
    pub width: [f64; 2],
    /// The fraction of places where part of the board is outside the image; 0 by default.
    pub leaving: f64,
    /// The amplitude of the hands' drift, in meters and in radians; 0.1 mm and 0.02° by default.
    pub tremor: [f64; 2],
}

impl Default for WalkOptions {
    fn default() -> Self {
        Self {
            still_s: 0.4,
            travel_s: 0.6,
            tilt: 50_f64.to_radians(),
            roll: 25_f64.to_radians(),
            width: [0.38, 0.8],
            leaving: 0.0,
            tremor: [1e-4, 0.02_f64.to_radians()],
        }
    }
}

/// An endless walk of the board in front of one camera: the pose at any time, from the seed alone.
#[derive(Debug, Clone)]
pub struct Walk {
    seed: u64,
    options: WalkOptions,
    pattern: BoardPattern,
    lens: Lens,
    size: ImageSize,
    /// The places before and after the time requested last.
    near: Option<(u64, [Pose; 2])>,
}

impl Walk {
    /// The walk of `seed` in front of a camera with `lens` and images of `size`.
    pub fn new(
        seed: u64,
        pattern: BoardPattern,
        lens: Lens,
        size: ImageSize,
        options: &WalkOptions,
    ) -> Self {
        Self { seed, options: *options, pattern, lens, size, near: None }
    }

    /// The pose of the board at `time_s` ≥ 0 seconds, in the camera's frame.
    pub fn camera_from_board(&mut self, time_s: f64) -> Pose {
        let WalkOptions { still_s, travel_s, .. } = self.options;
        let stage = (time_s / (still_s + travel_s)).max(0.0);
        let place = stage.floor() as u64;
        let since_s = (stage - stage.floor()) * (still_s + travel_s);
        let part = ((since_s - still_s) / travel_s).clamp(0.0, 1.0);
        // A smooth start and stop: 3 p² − 2 p³.
        let part = part * part * (3.0 - 2.0 * part);
        let [from, to] = self.places_around(place);
        let rotation =
            from.rotation().try_slerp(&to.rotation(), part, 1e-9).unwrap_or_else(|| to.rotation());
        let translation = from.translation().lerp(&to.translation(), part);
        let (shake, wobble) = tremor(time_s, self.options.tremor);
        Pose::new(rotation * wobble, translation + shake)
    }

    fn places_around(&mut self, place: u64) -> [Pose; 2] {
        match self.near {
            Some((near, poses)) if near == place => poses,
            Some((near, [_, to])) if near + 1 == place => {
                self.keep(place, [to, self.place(place + 1)])
            }
            _ => self.keep(place, [self.place(place), self.place(place + 1)]),
        }
    }

    fn keep(&mut self, place: u64, poses: [Pose; 2]) -> [Pose; 2] {
        self.near = Some((place, poses));
        poses
    }

    /// The `index`-th place. Positions in the image and tilts follow low-discrepancy sequences,
    /// so that any run of places covers the image and every tilt evenly.
    fn place(&self, index: u64) -> Pose {
        // Roberts' R2 sequence (powers of the plastic number's inverse) for the position; for tilt
        // and its axis the golden ratio's inverse and √2 − 1, one sequence each.
        let spread = |step: f64, start: f64| (start + step * (index as f64 + 1.0)).fract();
        let mut rng = stream(self.seed, Purpose::Waypoint, index);
        let start = (self.seed % 1000) as f64 / 1000.0;
        let leaving = rng.random_bool(self.options.leaving.clamp(0.0, 1.0));
        // Denser toward the image's edges, where lenses differ most.
        let toward_edges = |part: f64| 0.5 - 0.5 * (PI * part).cos();
        let at = [
            toward_edges(spread(0.754_877_666, start)),
            toward_edges(spread(0.569_840_291, start)),
        ];
        let tilt = self.options.tilt * spread(0.618_033_989, start).sqrt();
        let axis: f64 = TAU * spread(0.414_213_562, start) + rng.random_range(-0.3..0.3);
        let roll = rng.random_range(-1.0..1.0) * self.options.roll;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * roll)
            * UnitQuaternion::from_scaled_axis(Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt);
        let [far, near] = self.options.width;
        let width = far + (near - far) * rng.random_range(0.0..1.0_f64).powf(1.5);
        let [left, right, ..] = self.pattern.edges_in_squares();
        let card_m = (right - left) * self.pattern.board.square_m;
        let distance = self.lens.matrix.fx * card_m / (width * f64::from(self.size.width));
        let jitter_px = if leaving { -0.35 * width * f64::from(self.size.width) } else { 3.0 };
        self.placed(rotation, distance, at, jitter_px)
    }

    /// Places the card so that its bounding box in the image, `jitter_px` inside the edges, is at
    /// the fraction `at` of the remaining room; moves it farther away where there is no room.
    fn placed(
        &self,
        rotation: UnitQuaternion<f64>,
        distance: f64,
        at: [f64; 2],
        jitter_px: f64,
    ) -> Pose {
        let [left, right, top, bottom] = self.pattern.edges_in_squares();
        let side = self.pattern.board.square_m;
        let middle = Vector3::new(0.5 * (left + right), 0.5 * (top + bottom), 0.0) * side;
        let mut distance = distance;
        let mut target = self.size.center();
        let mut camera_from_board =
            Pose::new(rotation, Vector3::z() * distance - rotation * middle);
        for _ in 0..12 {
            let Some(ray) = self.lens.bearing_from_pixel(target) else { break };
            let here = Pose::new(
                rotation,
                ray.into_inner() * (distance / ray.z.max(0.1)) - rotation * middle,
            );
            let Some([low, high]) = self.bounding_box(&here) else {
                distance *= 1.2;
                continue;
            };
            camera_from_board = here;
            let room = |low: f64, high: f64, end: f64| end - 1.0 - 2.0 * jitter_px - (high - low);
            let rooms = [
                room(low.x, high.x, f64::from(self.size.width)),
                room(low.y, high.y, f64::from(self.size.height)),
            ];
            if rooms[0] < 0.0 || rooms[1] < 0.0 {
                distance *= 1.12;
                continue;
            }
            target.x += jitter_px + at[0] * rooms[0] - low.x;
            target.y += jitter_px + at[1] * rooms[1] - low.y;
        }
        camera_from_board
    }

    fn bounding_box(&self, camera_from_board: &Pose) -> Option<[Pixel; 2]> {
        let [left, right, top, bottom] = self.pattern.edges_in_squares();
        let side = self.pattern.board.square_m;
        let (mut low, mut high) = (
            Pixel::new(f64::INFINITY, f64::INFINITY),
            Pixel::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        );
        for step in 0..=8 {
            let part = f64::from(step) / 8.0;
            let [x, y] = [left + part * (right - left), top + part * (bottom - top)];
            for [x, y] in [[x, top], [x, bottom], [left, y], [right, y]] {
                let point_in_camera = *camera_from_board * Point3::new(x * side, y * side, 0.0);
                let pixel = self.lens.pixel_from_point(&point_in_camera)?;
                low = Pixel::new(low.x.min(pixel.x), low.y.min(pixel.y));
                high = Pixel::new(high.x.max(pixel.x), high.y.max(pixel.y));
            }
        }
        Some([low, high])
    }
}
