//! The board of the last image of a stream.

use crate::detection::coded::labels::BoardLabel;
use crate::detection::coded::offset_search::{OffsetSearch, ReferenceCorner};
use crate::detection::tracking::last_corners::LastCorners;
use crate::detection::vec2::Vec2;

/// The board of the last image.
#[derive(Debug, Default)]
pub(super) struct LastTarget {
    /// Its corners, in the board's order.
    pub(super) corners: LastCorners,
    /// For each corner, one unit of the lattice along each axis of the grid.
    pub(super) steps: Vec<[Vec2; 2]>,
    /// Its placement in the grid, and whether the grid's first square is bright.
    pub(super) label: Option<(BoardLabel, bool)>,
    /// Whether it, or the one before it if this image shows none, was inverted.
    pub(super) inverted: bool,
    /// The level of the image on which it was found.
    pub(super) level: usize,
    /// Whether it was found at a scale that the pyramid does not have.
    pub(super) between: bool,
    /// Images since the last one that showed it.
    pub(super) missed: u32,
    /// Width of the blur across its edges, in pixels.
    pub(super) blur_px: f32,
    pub(super) offsets: OffsetSearch,
    pub(super) references: Vec<ReferenceCorner>,
}

impl LastTarget {
    /// Forgets the board: the last image showed none.
    pub(super) fn forget(&mut self) {
        self.corners.forget();
        self.label = None;
        self.between = false;
        self.missed = self.missed.wrapping_add(1);
    }
}
