//! What the operator should do next, in words and as an outline in the image.

use crate::geometry::pixel::Pixel;

/// One piece of advice: what to do, and where to hold the board.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Guidance {
    /// A sentence for the operator.
    pub message: String,
    /// The board's four outer corners as they should be seen next, in pixels, clockwise from the board's first corner;
    /// empty when no place is better than another.
    pub outline_px: Vec<Pixel>,
}
