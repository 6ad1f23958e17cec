//! Priors of a corner from its neighbors on the board: the curvature of the edges and the gradient
//! of the light.

use crate::detection::board_detection::GridIndex;
use crate::detection::refine::corner_model::length;
use crate::detection::refine::edge_curvature::ExcessCurvature;
use crate::detection::refine::field::{BoardField, FieldSample};
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::stepped_field::SteppedFit;

/// One corner by its latest fit or alignment, in image pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct FittedCorner {
    /// Where it is.
    pub at: [f64; 2],
    /// Unit vectors along the two edges, towards +col and +row.
    pub along: [[f64; 2]; 2],
    /// The natural logarithm of the gray value of white.
    pub white: f64,
}

/// The board's prior for one corner.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct CornerPrior {
    /// Curvature of each edge, towards its normal (the edge's direction rotated by +90°), in 1/px.
    pub curvature: [f64; 2],
    /// Relative change of light per pixel.
    pub light_gradient: [f64; 2],
}

/// Highest orders of the polynomials over the board: for the edges' curvature and for the light.
/// Under strong distortion, a lower order biases curvature at the board's border by more than the
/// corners' noise, in the same way in every image.
const CURVATURE_ORDER: usize = 4;
const LIGHT_ORDER: usize = 4;

/// The corners by their indices, with the fields fitted to them.
#[derive(Debug, Default)]
pub(super) struct Lattice {
    first: [i64; 2],
    size: [i64; 2],
    slots: Vec<Option<u32>>,
    samples: Vec<FieldSample>,
    /// The curvature of the edges along each axis from neighbors' positions, with weights for unit
    /// variance of these.
    by_neighbors: [Vec<FieldSample>; 2],
    /// The curvature of the edges along each axis.
    curvatures: [BoardField; 2],
    /// The natural logarithm of white; only its slope is used.
    light: BoardField,
    steps: SteppedFit,
    /// For each corner, its index among the samples of light.
    lit: Vec<Option<usize>>,
}

/// Largest span of a grid, in indices: beyond, no priors are estimated.
const MOST_PLACES: i64 = 1 << 16;

impl Lattice {
    /// Fits the fields to the known quantities (`known`) of `corners`.
    pub fn fill(&mut self, corners: &[GridCorner], known: &[Option<FittedCorner>]) {
        self.place(corners);
        for axis in 0..2 {
            let mut samples = std::mem::take(&mut self.by_neighbors[axis]);
            let step = [i64::from(axis == 0), i64::from(axis == 1)];
            let beside = |corner: &GridCorner, steps: i64| {
                known[self.slot(corner.index, step.map(|v| v * steps))?].as_ref()
            };
            samples.clear();
            samples.extend(corners.iter().filter_map(|corner| {
                let (behind, here, ahead) =
                    (beside(corner, -1)?, beside(corner, 0)?, beside(corner, 1)?);
                let (value, span) = curvature([behind.at, here.at, ahead.at], here.along[axis])?;
                // The weight of a second difference of three positions, half the span from each
                // other.
                let weight = (span / 2.0).powi(4) / 6.0;
                Some(FieldSample { place: place(corner.index), value, weight })
            }));
            self.curvatures[axis] = BoardField::fit(&samples, CURVATURE_ORDER);
            self.by_neighbors[axis] = samples;
        }
        let mut samples = std::mem::take(&mut self.samples);
        samples.clear();
        samples.extend(corners.iter().zip(known).filter_map(|(corner, known)| {
            Some(FieldSample {
                place: place(corner.index),
                value: known.as_ref()?.white,
                weight: 1.0,
            })
        }));
        let smooth = BoardField::fit(&samples, LIGHT_ORDER);
        self.pair_neighbors(corners, known);
        self.light = self.steps.slopes(&samples, &smooth, LIGHT_ORDER).unwrap_or(smooth);
        self.samples = samples;
    }

    /// Pairs of neighbors among the samples of light.
    fn pair_neighbors(&mut self, corners: &[GridCorner], known: &[Option<FittedCorner>]) {
        self.lit.clear();
        let mut count = 0;
        self.lit.extend(known.iter().map(|known| {
            count += usize::from(known.is_some());
            known.is_some().then(|| count - 1)
        }));
        let mut pairs = std::mem::take(&mut self.steps.pairs);
        pairs.clear();
        for (corner, from) in corners.iter().zip(&self.lit) {
            for step in [[1, 0], [0, 1]] {
                let to = self.slot(corner.index, step).and_then(|slot| self.lit[slot]);
                pairs.extend(from.zip(to).map(|(from, to)| [from, to]));
            }
        }
        self.steps.pairs = pairs;
    }

    /// The curvature of the edges along `axis` from both sources: the second differences of
    /// neighbors, whose positions have the variance `variance_px2`, and the excess in each corner's
    /// own window. `None` where no window has an estimate, or no corner has two neighbors: a window
    /// alone cannot distinguish curvature from noise.
    pub fn curvature_with_own(
        &mut self,
        axis: usize,
        variance_px2: f64,
        own: impl Iterator<Item = (GridIndex, ExcessCurvature)>,
    ) -> Option<BoardField> {
        let mut own = own.peekable();
        if self.by_neighbors[axis].is_empty() || own.peek().is_none() {
            return None;
        }
        self.samples.clear();
        let by_neighbors = self.by_neighbors[axis].iter();
        self.samples.extend(
            by_neighbors
                .map(|sample| FieldSample { weight: sample.weight / variance_px2, ..*sample }),
        );
        let field = &self.curvatures[axis];
        self.samples.extend(own.map(|(index, own)| {
            let place = place(index);
            let value = field.at(place) + own.excess;
            FieldSample { place, value, weight: 1.0 / own.variance }
        }));
        Some(BoardField::fit(&self.samples, CURVATURE_ORDER))
    }

    /// How much `field` exceeds the curvature of the edges along `axis` that [`Self::prior_of`]
    /// gives, at the corner at `index`.
    pub fn beyond(&self, axis: usize, field: &BoardField, index: GridIndex) -> f64 {
        field.at(place(index)) - self.curvatures[axis].at(place(index))
    }

    fn place(&mut self, corners: &[GridCorner]) {
        self.slots.clear();
        let places = || {
            corners.iter().map(|corner| [i64::from(corner.index.col), i64::from(corner.index.row)])
        };
        let fold = |k: usize, pick: fn(i64, i64) -> i64| {
            places().map(|place| place[k]).reduce(pick).unwrap_or(0)
        };
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

    /// The lines along `axis`: the position of each, −1 … 1, and the corners on it, in order.
    pub fn lines(
        &self,
        axis: usize,
    ) -> impl Iterator<Item = (f64, impl Iterator<Item = usize> + Clone)> {
        let [along, across] = [self.size[axis], self.size[1 - axis]];
        let strides = [1, self.size[0]];
        (0..across).map(move |line| {
            let place = (2 * line - (across - 1)) as f64 / (across - 1).max(1) as f64;
            let slots = (0..along).filter_map(move |step| {
                self.slots[(line * strides[1 - axis] + step * strides[axis]) as usize]
                    .map(|slot| slot as usize)
            });
            (place, slots)
        })
    }

    fn slot(&self, index: GridIndex, step: [i64; 2]) -> Option<usize> {
        Some(self.slots[self.place_of(index, step)?]? as usize)
    }

    /// The board's prior for the corner at `index`. Curvature and light from one corner are noisy,
    /// and corners at the border lack neighbors, but both vary smoothly over the board.
    pub fn prior_of(&self, index: GridIndex, axes: [[f64; 2]; 2]) -> CornerPrior {
        let place = place(index);
        let light = self.light.slope(place);
        let det = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
        CornerPrior {
            curvature: [0, 1].map(|axis| self.curvatures[axis].at(place)),
            light_gradient: [
                (light[0] * axes[1][1] - light[1] * axes[0][1]) / det,
                (light[1] * axes[0][0] - light[0] * axes[1][0]) / det,
            ],
        }
    }
}

fn place(index: GridIndex) -> [f64; 2] {
    [f64::from(index.col), f64::from(index.row)]
}

/// The vectors from a corner to its neighbors along the columns' and the rows' direction, in image
/// pixels: the mean of both sides where both are known. `None` where the neighbors do not determine
/// two directions.
pub(super) fn axes_of(corner: &GridCorner) -> Option<[[f64; 2]; 2]> {
    let axis = |k: usize| {
        let ahead = corner.neighbors[k].map(|p| [p.x - corner.pixel.x, p.y - corner.pixel.y]);
        let behind = corner.neighbors[k + 2].map(|p| [corner.pixel.x - p.x, corner.pixel.y - p.y]);
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

/// The curvature at the middle of three points, towards the normal of `direction`, and how far
/// along that direction they span.
fn curvature([behind, here, ahead]: [[f64; 2]; 3], direction: [f64; 2]) -> Option<(f64, f64)> {
    let along_across = |to: [f64; 2]| {
        let d = [to[0] - here[0], to[1] - here[1]];
        (d[0] * direction[0] + d[1] * direction[1], d[1] * direction[0] - d[0] * direction[1])
    };
    let ((back, back_off), (on, on_off)) = (along_across(behind), along_across(ahead));
    (on > 0.5 && back < -0.5)
        .then(|| (2.0 * (on_off / on - back_off / back) / (on - back), on - back))
}
