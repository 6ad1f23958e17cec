//! What a corner's neighbours on the board tell about it: how the edges bend, how the light changes.

use crate::detection::board_detection::GridIndex;
use crate::detection::refine::GridCorner;
use crate::detection::refine::corner_model::length;

/// One corner after the first fit, in image pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    /// Where it is.
    pub at: [f64; 2],
    /// Unit vectors along the two edges, towards +col and +row.
    pub along: [[f64; 2]; 2],
    /// The natural logarithm of the grey value of white.
    pub white: f64,
}

/// What the board tells about one corner.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Surroundings {
    /// Curvature of each edge, towards its normal (the edge's direction turned by +90°), in 1/px.
    pub curvature: [f64; 2],
    /// Relative change of light per pixel.
    pub light_gradient: [f64; 2],
}

/// The corners as a table.
#[derive(Debug, Default)]
pub(super) struct Lattice {
    first: [i64; 2],
    size: [i64; 2],
    slots: Vec<Option<u32>>,
    /// For each slot and axis: the curvature, where both neighbours are known.
    bends: Vec<[Option<f64>; 2]>,
    /// For each slot and axis: the change of `white` from one corner to the next.
    lights: Vec<[f64; 2]>,
}

/// Grids that span more than this many places are no board: nothing is told about their corners.
const MOST_PLACES: i64 = 1 << 16;
/// A corner and the eight around it.
const AROUND: [[i64; 2]; 9] = [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]];

impl Lattice {
    /// Takes the indices of `corners` and what is known of each.
    pub fn fill(&mut self, corners: &[GridCorner], known: &[Option<Known>]) {
        self.place(corners);
        let (mut bends, mut lights) = (std::mem::take(&mut self.bends), std::mem::take(&mut self.lights));
        bends.clear();
        lights.clear();
        for corner in corners {
            let along = |axis: usize, steps: i64| {
                let step = [steps * i64::from(axis == 0), steps * i64::from(axis == 1)];
                known[self.slot(corner.index, step)?].as_ref()
            };
            bends.push([0, 1].map(|axis| {
                let (behind, here, ahead) = (along(axis, -1)?, along(axis, 0)?, along(axis, 1)?);
                bend([behind.at, here.at, ahead.at], here.along[axis])
            }));
            lights.push([0, 1].map(|axis| {
                let white = |steps: i64| along(axis, steps).map(|known| known.white);
                slope([white(-2), white(-1), white(0), white(1), white(2)])
            }));
        }
        (self.bends, self.lights) = (bends, lights);
    }

    fn place(&mut self, corners: &[GridCorner]) {
        self.slots.clear();
        let places = || corners.iter().map(|corner| [i64::from(corner.index.col), i64::from(corner.index.row)]);
        let fold = |k: usize, pick: fn(i64, i64) -> i64| places().map(|place| place[k]).reduce(pick).unwrap_or(0);
        self.first = [fold(0, i64::min), fold(1, i64::min)];
        self.size = [fold(0, i64::max) - self.first[0] + 1, fold(1, i64::max) - self.first[1] + 1];
        if self.size[0].saturating_mul(self.size[1]) > MOST_PLACES {
            self.size = [0; 2];
        }
        self.slots.resize((self.size[0] * self.size[1]) as usize, None);
        for (slot, corner) in corners.iter().enumerate() {
            if let Some(place) = self.place_of(corner.index, [0, 0]) {
                self.slots[place] = Some(slot as u32);
            }
        }
    }

    fn place_of(&self, index: GridIndex, step: [i64; 2]) -> Option<usize> {
        let col = i64::from(index.col) - self.first[0] + step[0];
        let row = i64::from(index.row) - self.first[1] + step[1];
        let inside = (0..self.size[0]).contains(&col) && (0..self.size[1]).contains(&row);
        inside.then_some((row * self.size[0] + col) as usize)
    }

    fn slot(&self, index: GridIndex, step: [i64; 2]) -> Option<usize> {
        Some(self.slots[self.place_of(index, step)?]? as usize)
    }

    /// What the board tells about the corner at `index`. The bend is the mean of those of the corners around, the smallest and
    /// the largest left out: it changes little over a board, and so has a third of the noise of one corner's, and does not
    /// believe a corner that went astray.
    pub fn surroundings(&self, index: GridIndex, axes: [[f64; 2]; 2]) -> Surroundings {
        let around = || AROUND.iter().filter_map(|step| self.slot(index, *step));
        let curvature = [0, 1].map(|axis| trimmed_mean(around().filter_map(|slot| self.bends[slot][axis])));
        let light = self.slot(index, [0, 0]).map_or([0.0; 2], |slot| self.lights[slot]);
        let det = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
        Surroundings {
            curvature,
            light_gradient: [
                (light[0] * axes[1][1] - light[1] * axes[0][1]) / det,
                (light[1] * axes[0][0] - light[0] * axes[1][0]) / det,
            ],
        }
    }
}

/// From a corner to its neighbours along the columns' and the rows' direction, in image pixels: the mean of both sides where
/// both are seen. `None` where the neighbours leave no two directions.
pub(super) fn axes_of(corner: &GridCorner) -> Option<[[f64; 2]; 2]> {
    let axis = |k: usize| {
        let ahead = corner.neighbours[k].map(|p| [p.x - corner.pixel.x, p.y - corner.pixel.y]);
        let behind = corner.neighbours[k + 2].map(|p| [corner.pixel.x - p.x, corner.pixel.y - p.y]);
        match (ahead, behind) {
            (Some(a), Some(b)) => Some([(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]),
            (one, other) => one.or(other),
        }
    };
    let (along, across) = (axis(0), axis(1));
    let axes = [along.or(across.map(|[x, y]| [y, -x]))?, across.or(along.map(|[x, y]| [-y, x]))?];
    let area = (axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0]).abs();
    let spread = length(axes[0]) * length(axes[1]);
    (spread.is_finite() && area > 0.05 * spread && area > 4.0).then_some(axes)
}

/// Curvature of the curve through three points, at the middle one, towards the normal of `direction`.
fn bend([behind, here, ahead]: [[f64; 2]; 3], direction: [f64; 2]) -> Option<f64> {
    let along_across = |to: [f64; 2]| {
        let d = [to[0] - here[0], to[1] - here[1]];
        (d[0] * direction[0] + d[1] * direction[1], d[1] * direction[0] - d[0] * direction[1])
    };
    let ((back, back_off), (on, on_off)) = (along_across(behind), along_across(ahead));
    (on > 0.5 && back < -0.5).then(|| 2.0 * (on_off / on - back_off / back) / (on - back))
}

/// The slope at the middle of five equidistant values, as far as they are known: central, or one-sided of second order.
fn slope([before, behind, here, ahead, beyond]: [Option<f64>; 5]) -> f64 {
    let one_sided = |near: Option<f64>, far: Option<f64>| {
        let (here, near) = (here?, near?);
        Some(far.map_or(near - here, |far| 2.0 * near - 1.5 * here - 0.5 * far))
    };
    let central = || Some((ahead? - behind?) / 2.0);
    let back = || one_sided(behind, before).map(|slope| -slope);
    central().or_else(|| one_sided(ahead, beyond)).or_else(back).unwrap_or(0.0)
}

/// The mean without the smallest and the largest, where there are more than three; 0 where there is none.
fn trimmed_mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count, mut least, mut most) = (0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
    for value in values {
        sum += value;
        count += 1.0;
        least = value.min(least);
        most = value.max(most);
    }
    if count > 3.0 { (sum - least - most) / (count - 2.0) } else { sum / f64::max(count, 1.0) }
}
