//! The board of the last image, and where its corners are expected in the next.

use super::cross::Vec2;
use super::grid::{Grid, Node};
use super::placement::BoardPlacement;
use crate::geometry::board::BoardSize;

/// The last positions of a board's corners, in the board's order.
#[derive(Debug, Default)]
pub(super) struct LastBoard {
    pub(super) nodes: Vec<Node>,
    /// Each corner's motion since the board before.
    pub(super) motion: Vec<Vec2>,
    before: Vec<Vec2>,
    /// Whether the square beyond the first corner, towards the board's middle, is bright.
    pub(super) bright: bool,
    /// Width of the blur across its edges, in pixels.
    pub(super) blur_px: f32,
}

impl LastBoard {
    pub(super) fn forget(&mut self) {
        self.nodes.clear();
        self.before.clear();
    }

    /// Remembers a whole board.
    pub(super) fn remember(&mut self, grid: &Grid, placement: BoardPlacement, board: BoardSize) {
        self.before.clear();
        self.before.extend(self.nodes.iter().map(|node| node.pixel));
        self.nodes.clear();
        let corners = (0..board.rows as i32)
            .flat_map(|row| (0..board.cols as i32).map(move |col| (col, row)));
        self.nodes.extend(corners.filter_map(|(col, row)| {
            let (i, j) = placement.in_grid(col, row);
            grid.get(i, j)
        }));
        self.motion.clear();
        self.motion
            .extend(self.nodes.iter().zip(&self.before).map(|(node, before)| node.pixel - before));
        let ((i, j), (k, l)) = (placement.in_grid(0, 0), placement.in_grid(1, 1));
        self.bright = grid.polarity(i.min(k), j.min(l)) > 0.0;
    }

    /// Predicted position of corner `index`.
    pub(super) fn expect(
        &self,
        index: usize,
        board: BoardSize,
        with_motion: bool,
    ) -> Option<ExpectedCorner> {
        let (cols, rows) = (board.cols as usize, board.rows as usize);
        let step = |at: usize, length: usize, stride: usize| {
            let low = index - stride.min(at * stride);
            let high = if at + 1 < length { index + stride } else { index };
            let (p, q) = (self.nodes.get(low)?.pixel, self.nodes.get(high)?.pixel);
            Some((q - p) * (stride as f32 / (high - low) as f32))
        };
        let steps = [step(index % cols, cols, 1)?, step(index / cols, rows, cols)?];
        let moved = if with_motion { *self.motion.get(index)? } else { Vec2::zeros() };
        let last = *self.nodes.get(index)?;
        Some(ExpectedCorner { last, expected: last.pixel + moved, steps })
    }
}

/// A corner of the last board and its prediction.
#[derive(Debug, Clone, Copy)]
pub(super) struct ExpectedCorner {
    /// What was measured of it.
    pub last: Node,
    /// Its predicted position.
    pub expected: Vec2,
    /// From there to the next corner along i and along j.
    pub steps: [Vec2; 2],
}
