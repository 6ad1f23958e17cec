//! The edges between the corners of a whole board: each is bright on one side and dark on the
//! other, in alternation.

use crate::detection::grid::{Grid, Node};
use crate::detection::measure::Probe;
use crate::detection::measure::edges::{differences, sample};
use crate::detection::vec2::Vec2;
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// An edge between two corners, as their indices in the board's order.
#[derive(Debug, Clone, Copy)]
struct Edge {
    ends: [usize; 2],
    /// How much brighter the side is that should be bright, at three positions.
    differences: [f32; 3],
}

/// Measurements of one image, reused from image to image.
#[derive(Debug, Default)]
pub(super) struct EdgeMeasurements {
    /// Each corner's offset from its prediction.
    pub(super) off: Vec<Option<Vec2>>,
    edges: Vec<Edge>,
    /// For each corner: the sum of differences, the number of edges, and the number of edges that
    /// hold.
    around: Vec<(f32, u32, u32)>,
}

/// Brightness of the pixel at `p`; `None` outside the image.
fn nearest(image: GrayView<'_>, p: Vec2) -> Option<f32> {
    let (x, y) = (p.x.round(), p.y.round());
    let inside = x >= 0.0 && y >= 0.0 && x < image.width() as f32 && y < image.height() as f32;
    inside.then(|| f32::from(image.row(y as usize)[x as usize]))
}

impl EdgeMeasurements {
    /// Measures the edges of the whole board in `grid`. Returns whether enough of them hold, and at
    /// least half of them at each corner.
    pub(super) fn edges_hold(
        &mut self,
        probe: Probe<'_>,
        grid: &mut Grid,
        board: BoardSize,
    ) -> bool {
        let thresholds = &probe.thresholds.tracking;
        self.measure_edges(probe, grid, board);
        let Self { edges, around, .. } = self;
        around.clear();
        around.resize(board.corner_count(), (0.0, 0, 0));
        for edge in edges.iter() {
            for end in edge.ends {
                around[end].0 += edge.differences.iter().sum::<f32>() / 3.0;
                around[end].1 += 1;
            }
        }
        let mut held = 0;
        for edge in edges.iter() {
            let reference = edge.ends.map(|end| around[end].0 / around[end].1 as f32);
            let least = thresholds.least_difference * 0.5 * (reference[0] + reference[1]);
            if least > 0.0 && edge.differences.iter().all(|&difference| difference >= least) {
                held += 1;
                edge.ends.iter().for_each(|&end| around[end].2 += 1);
            }
        }
        let cols = board.cols as usize;
        let mut all_hold =
            held as f32 >= thresholds.least_held * edges.len() as f32 && !edges.is_empty();
        for (index, &(differences, seen, held)) in around.iter().enumerate() {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            let Some(node) = grid.get(i, j) else { return false };
            let contrast = differences / seen.max(1) as f32;
            let least_contrast = thresholds.least_contrast * node.contrast.abs();
            all_hold &= 2 * held >= seen && (seen == 0 || contrast >= least_contrast);
            if seen > 0 {
                grid.set(i, j, Node { contrast: contrast * grid.polarity(i, j), ..node });
            }
        }
        all_hold
    }

    fn measure_edges(&mut self, probe: Probe<'_>, grid: &Grid, board: BoardSize) {
        self.edges.clear();
        let cols = board.cols as usize;
        let large = probe.thresholds.tracking.large_px.powi(2);
        for index in 0..board.corner_count() {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            let (Some(node), Some([u, v])) = (grid.get(i, j), grid.steps(i, j)) else { continue };
            // In large squares the nearest pixel is as good as interpolation.
            let is_large = u.norm_squared().min(v.norm_squared()) > large;
            for (other, at, aside) in [((i + 1, j), index + 1, v), ((i, j + 1), index + cols, u)] {
                let Some(end) = grid.pixel(other.0, other.1) else { continue };
                let ends = [node.pixel, end];
                let seen = if is_large {
                    differences(probe, ends, aside, nearest)
                } else {
                    differences(probe, ends, aside, sample)
                };
                if let Some(seen) = seen {
                    let differences = seen.map(|difference| difference * grid.polarity(i, j));
                    self.edges.push(Edge { ends: [index, at], differences });
                }
            }
        }
    }
}
