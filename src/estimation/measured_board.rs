//! A board and a shutter as a solve measured them, in meters.

use nalgebra::{Point3, Vector3};

/// A board's shape as a solve measured it, relative to the one that was stated. A rigid motion is
/// no shape, and the mean scale is the stated one.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredBoard {
    /// The stated points, in the board frame, in meters.
    pub points: Vec<Point3<f64>>,
    /// How far each is from where it was stated, in meters.
    pub offsets_m: Vec<Vector3<f64>>,
    /// Standard deviation of each offset per axis, in meters.
    pub std_m: Vec<Vector3<f64>>,
    /// Root mean square length of the offsets, in meters.
    pub unevenness_m: f64,
    /// Its standard deviation, in meters.
    pub unevenness_std_m: f64,
    /// How far the board is bowed at its middle along x and y, in meters: the parabolas that fit
    /// its heights best.
    pub bow_m: [f64; 2],
}

/// Motion while the rows of an image were read, over the views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RollingShutter {
    /// Root mean square translation of the board from the first row to the last, in meters.
    pub translation_m: f64,
    /// Root mean square rotation likewise, in radians.
    pub rotation_rad: f64,
    /// 1 where views agree that it is there; else the part of it, 0 to 1, that is beyond chance, as
    /// which it counts.
    pub agreement: f64,
}

/// A corner nearer than this part of the board's extent to a measured one is it.
const SAME_CORNER: f64 = 1e-3;

impl MeasuredBoard {
    /// By how much the board is longer along its x than along its y, as a part of its length.
    pub fn aspect(&self) -> f64 {
        let mean = self.points.iter().map(|p| p.coords).sum::<Vector3<f64>>()
            / self.points.len().max(1) as f64;
        let [along_x, along_y] = [0, 1].map(|axis| {
            let (mut product, mut square) = (0.0, 0.0);
            for (point, offset) in self.points.iter().zip(&self.offsets_m) {
                let place = point[axis] - mean[axis];
                product += place * offset[axis];
                square += place * place;
            }
            product / square.max(f64::MIN_POSITIVE)
        });
        along_x - along_y
    }

    /// How far the corner stated at `point` (in the board frame) was measured to be from there, in
    /// meters; `None` where none was measured.
    pub fn offset_at(&self, point: &Point3<f64>) -> Option<Vector3<f64>> {
        let distance = |measured: &Point3<f64>| (measured - point).norm();
        let (first, farthest) = (self.points.first()?, |from: &Point3<f64>| {
            self.points.iter().map(|p| (p - from).norm()).fold(0.0, f64::max)
        });
        let near = SAME_CORNER * farthest(first);
        let (nearest, offset) = self
            .points
            .iter()
            .zip(&self.offsets_m)
            .min_by(|a, b| distance(a.0).total_cmp(&distance(b.0)))?;
        (distance(nearest) <= near).then_some(*offset)
    }
}
