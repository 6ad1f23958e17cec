//! What a corner's neighbours on the board tell about it: where the edges run, how they bend, how the light changes.

use crate::detection::board_detection::GridIndex;
use crate::detection::refine::GridCorner;

/// One corner after the first fit, in image pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    /// Where it is.
    pub at: [f64; 2],
    /// Mean of black and white.
    pub level: f64,
    /// Half the difference of white and black.
    pub contrast: f64,
}

/// Finds corners by their index.
#[derive(Debug, Default)]
pub(super) struct Lattice {
    slots: Vec<(GridIndex, usize)>,
}

/// The steps to the neighbours, in the order of [`GridCorner::neighbours`].
const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];

impl Lattice {
    /// Takes the indices of `corners`.
    pub fn fill(&mut self, corners: &[GridCorner]) {
        self.slots.clear();
        self.slots.extend(corners.iter().enumerate().map(|(slot, corner)| (corner.index, slot)));
        self.slots.sort_unstable();
    }

    /// The slot of the corner `steps` steps from `index` in direction `side`.
    pub fn slot(&self, index: GridIndex, side: usize, steps: i32) -> Option<usize> {
        let col = index.col.checked_add(STEPS[side][0] * steps)?;
        let row = index.row.checked_add(STEPS[side][1] * steps)?;
        let found = self.slots.binary_search_by_key(&GridIndex { col, row }, |(index, _)| *index).ok()?;
        Some(self.slots[found].1)
    }

    /// The vectors from a corner to its neighbours along the columns' and the rows' direction, in image pixels: the mean
    /// of both sides where both are seen. `None` where the neighbours leave an axis open.
    pub fn axes(corner: &GridCorner) -> Option<[[f64; 2]; 2]> {
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
        let spread = axes[0][0].hypot(axes[0][1]) * axes[1][0].hypot(axes[1][1]);
        (spread.is_finite() && area > 0.05 * spread && area > 4.0).then_some(axes)
    }

    /// Curvature (1/px, towards the normal: the direction turned by +90°) of the edge through a corner along axis `k`, from
    /// the two corners beside it, or beside its only neighbour.
    pub fn curvature(&self, index: GridIndex, k: usize, direction: [f64; 2], known: &[Option<Known>]) -> Option<f64> {
        let at = |side: usize, steps: i32| Some(known[self.slot(index, side, steps)?].as_ref()?.at);
        let here = at(0, 0)?;
        let (ahead, behind) = (at(k, 1), at(k + 2, 1));
        let three = match (behind, ahead) {
            (Some(behind), Some(ahead)) => [behind, here, ahead],
            (None, Some(ahead)) => [here, ahead, at(k, 2)?],
            (Some(behind), None) => [at(k + 2, 2)?, behind, here],
            (None, None) => return None,
        };
        let along_across = |from: [f64; 2], to: [f64; 2]| {
            let d = [to[0] - from[0], to[1] - from[1]];
            (d[0] * direction[0] + d[1] * direction[1], d[1] * direction[0] - d[0] * direction[1])
        };
        let (back, back_off) = along_across(three[1], three[0]);
        let (on, on_off) = along_across(three[1], three[2]);
        (on - back > 1.0 && on > 0.0 && back < 0.0).then(|| 2.0 * (on_off / on - back_off / back) / (on - back))
    }

    /// Relative change of white per image pixel at a corner, from its neighbours' whites.
    pub fn light_gradient(&self, index: GridIndex, axes: [[f64; 2]; 2], known: &[Option<Known>]) -> [f64; 2] {
        let white = |side: usize, steps: i32| {
            let corner = known[self.slot(index, side, steps)?].as_ref()?;
            Some((corner.level + corner.contrast).max(1.0).ln())
        };
        let slope = |k: usize| {
            let here = white(0, 0)?;
            Some(match (white(k + 2, 1), white(k, 1)) {
                (Some(behind), Some(ahead)) => (ahead - behind) / 2.0,
                (None, Some(ahead)) => ahead - here,
                (Some(behind), None) => here - behind,
                (None, None) => return None,
            })
        };
        let along = [slope(0).unwrap_or(0.0), slope(1).unwrap_or(0.0)];
        let det = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
        [(along[0] * axes[1][1] - along[1] * axes[0][1]) / det, (along[1] * axes[0][0] - along[0] * axes[1][0]) / det]
    }
}
