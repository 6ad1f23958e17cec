//! The edges between the corners of a whole board: bright on one side and dark on the other, by
//! turns.

use super::cross::Vec2;
use super::edges::sample;
use super::grid::{Grid, Node};
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// Where each edge is sampled between its two corners, and how far to its sides, in steps.
const ALONG: [f32; 3] = [0.28, 0.5, 0.72];
const ASIDE: f32 = 0.25;
/// Steps longer than this make large squares, in pixels.
const LARGE: f32 = 16.0;
/// Minimum difference of an edge's two sides, as a share of that of the edges around it; and the
/// minimum share of edges that hold.
const LEAST_DIFFERENCE: f32 = 0.25;
const LEAST_HELD: f32 = 0.75;
/// Minimum contrast, as a share of the last image's: windows of other sizes, and light, change it
/// by less.
pub(super) const LEAST_CONTRAST: f32 = 0.3;

/// An edge between two corners, by their index in the board's order.
#[derive(Debug, Clone, Copy)]
struct Edge {
    ends: [usize; 2],
    /// How much brighter the side is that should be, at three positions.
    differences: [f32; 3],
}

/// Buffers of tracking, reused from image to image.
#[derive(Debug, Default)]
pub(super) struct Followed {
    /// Each corner's offset from its prediction.
    pub(super) off: Vec<Option<Vec2>>,
    edges: Vec<Edge>,
    /// Sum of differences, edges, and edges that hold, corner by corner.
    around: Vec<(f32, u32, u32)>,
}

/// Brightness of the pixel at `p`; `None` outside the image.
fn nearest(image: GrayView<'_>, p: Vec2) -> Option<f32> {
    let (x, y) = (p.x.round(), p.y.round());
    let inside = x >= 0.0 && y >= 0.0 && x < image.width() as f32 && y < image.height() as f32;
    inside.then(|| f32::from(image.row(y as usize)[x as usize]))
}

impl Followed {
    /// Measures the edges of the whole board in `grid`; whether enough of them hold, and at each
    /// corner half of them.
    pub(super) fn edges_hold(
        &mut self,
        image: GrayView<'_>,
        grid: &mut Grid,
        board: BoardSize,
    ) -> bool {
        self.measure_edges(image, grid, board);
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
            let least = LEAST_DIFFERENCE * 0.5 * (reference[0] + reference[1]);
            if least > 0.0 && edge.differences.iter().all(|&difference| difference >= least) {
                held += 1;
                edge.ends.iter().for_each(|&end| around[end].2 += 1);
            }
        }
        let cols = board.cols as usize;
        let mut all_hold = held as f32 >= LEAST_HELD * edges.len() as f32 && !edges.is_empty();
        for (index, &(differences, seen, held)) in around.iter().enumerate() {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            let Some(node) = grid.get(i, j) else { return false };
            let contrast = differences / seen.max(1) as f32;
            all_hold &=
                2 * held >= seen && (seen == 0 || contrast >= LEAST_CONTRAST * node.contrast.abs());
            if seen > 0 {
                grid.set(i, j, Node { contrast: contrast * grid.polarity(i, j), ..node });
            }
        }
        all_hold
    }

    fn measure_edges(&mut self, image: GrayView<'_>, grid: &Grid, board: BoardSize) {
        self.edges.clear();
        let cols = board.cols as usize;
        for index in 0..board.corner_count() {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            let (Some(node), Some([u, v])) = (grid.get(i, j), grid.steps(i, j)) else { continue };
            for (other, at, aside) in [((i + 1, j), index + 1, v), ((i, j + 1), index + cols, u)] {
                let Some(end) = grid.pixel(other.0, other.1) else { continue };
                let along = end - node.pixel;
                // In large squares a single pixel is as good.
                let large = u.norm_squared().min(v.norm_squared()) > LARGE * LARGE;
                let brightness = if large { nearest } else { sample };
                let difference = |part: f32| {
                    let on = node.pixel + along * part;
                    Some(
                        brightness(image, on + aside * ASIDE)?
                            - brightness(image, on - aside * ASIDE)?,
                    )
                };
                if let [Some(a), Some(b), Some(c)] = ALONG.map(difference) {
                    let differences = [a, b, c].map(|difference| difference * grid.polarity(i, j));
                    self.edges.push(Edge { ends: [index, at], differences });
                }
            }
        }
    }
}
