//! The input of the refinement: a corner's approximate position in the grid.

use crate::detection::board_detection::GridIndex;
use crate::geometry::pixel::Pixel;

/// A corner before refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridCorner {
    /// Its place in the grid. Each index may occur once.
    pub index: GridIndex,
    /// Its initial position, to about 1.5 px (less where cells are small: a fifth of a cell).
    pub pixel: Pixel,
    /// Its neighbors in the directions +col, +row, −col, −row, where they are known.
    pub neighbors: [Option<Pixel>; 4],
}
