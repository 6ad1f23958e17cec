//! The background behind the board: a wall with a slow gradient and bright and dark rectangles,
//! like windows or shelves, but without a chessboard.

use nalgebra::Vector3;
use rand::RngExt;

use crate::simulation::noise::{Purpose, stream};

/// A wall at a distance of one unit in front of the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Background {
    level: f64,
    slope: [f64; 2],
    patches: Vec<WallPatch>,
}

/// A rotated rectangle on the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
struct WallPatch {
    center: [f64; 2],
    half: [f64; 2],
    direction: [f64; 2],
    reflectance: f64,
}

impl Background {
    /// The wall of `seed`, with `clutter` rectangles.
    pub fn new(seed: u64, clutter: usize) -> Self {
        let mut rng = stream(seed, Purpose::Background, 0);
        let level = rng.random_range(0.25..0.45);
        let slope = [rng.random_range(-0.06..0.06), rng.random_range(-0.06..0.06)];
        let patches = (0..clutter)
            .map(|_| {
                let angle: f64 = rng.random_range(-0.3..0.3);
                WallPatch {
                    center: [rng.random_range(-0.9..0.9), rng.random_range(-0.7..0.7)],
                    half: [rng.random_range(0.02..0.2), rng.random_range(0.02..0.15)],
                    direction: [angle.cos(), angle.sin()],
                    reflectance: rng.random_range(0.06..0.7),
                }
            })
            .collect();
        Self { level, slope, patches }
    }

    /// The light that arrives along `ray` (of any length); for rays that do not meet the wall, the
    /// wall's brightness in its middle, without rectangles.
    pub fn light(&self, ray: &Vector3<f64>) -> f64 {
        if !(ray.z > 0.0) {
            return self.level;
        }
        let [x, y] = [ray.x / ray.z, ray.y / ray.z];
        let front = self.patches.iter().rev().find(|patch| patch.holds(x, y));
        let wall =
            self.level + self.slope[0] * x.clamp(-2.0, 2.0) + self.slope[1] * y.clamp(-2.0, 2.0);
        front.map_or(wall, |patch| patch.reflectance)
    }
}

impl WallPatch {
    fn holds(&self, x: f64, y: f64) -> bool {
        let [dx, dy] = [x - self.center[0], y - self.center[1]];
        let [c, s] = self.direction;
        (c * dx + s * dy).abs() < self.half[0] && (c * dy - s * dx).abs() < self.half[1]
    }
}
