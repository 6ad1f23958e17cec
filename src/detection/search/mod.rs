//! The search: one image → the grid of the board, and where the board lies in it.
//!
//! | stage | file | what it gives |
//! | --- | --- | --- |
//! | levels | `pyramid` | the image at a half, a quarter, … of its size |
//! | other levels | `between` | the image at two thirds, a third, … and twice its size |
//! | response | `response` | how much each pixel resembles a corner |
//! | candidates | `candidates` | the strongest, each measured |
//! | seeds | `seeds` | four that close a square |
//! | growth | `growth`, `stretch` | the grid, corner by corner |
//! | descent | `descent` | the same grid in the image itself, across occluders |
//! | level | `level` | the stages of one level, and the verification of each grid |
//!
//! [`find`] goes from the coarsest level to the finest, until a whole board is verified.

pub(in crate::detection) mod between;
pub(in crate::detection) mod candidates;
mod descent;
mod growth;
mod level;
pub(in crate::detection) mod pyramid;
pub(in crate::detection) mod response;
pub(in crate::detection) mod seeds;
mod stretch;

use crate::detection::board_detection::NoBoard;
use crate::detection::grid::Grid;
use crate::detection::measure::Probe;
use crate::detection::reasons::{SearchEvidence, no_board};
use crate::detection::search::level::{LevelSearch, SearchScene};
use crate::detection::search::pyramid::{Pyramid, coarsest_level};
use crate::detection::thresholds::Thresholds;
use crate::detection::verify::placement::BoardPlacement;
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// On all but the coarsest level one row in this many is searched: a response is wider than that,
/// and a board without a single visible square would have been found on the level above.
const ROW_STEP: usize = 2;
/// Least side of a square in the image, in pixels: boards with smaller squares are not searched
/// for. Chosen, not swept.
const LEAST_SQUARE_PX: usize = 4;
/// A part of the board with more than one corner in this many of the board's ends the search: finer
/// levels are not searched for a larger part. Chosen, not swept.
const ENOUGH_ONE_IN: usize = 3;

/// Buffers of the search, reused from image to image.
#[derive(Debug, Default)]
pub(in crate::detection) struct SearchBuffers {
    pub(in crate::detection) pyramid: Pyramid,
    pub(in crate::detection) levels: LevelSearch,
}

/// A board found in an image, before refinement.
#[derive(Debug)]
pub(in crate::detection) struct FoundGrid<'b> {
    /// Its corners, in pixels of the image.
    pub grid: &'b mut Grid,
    /// How the board's columns and rows lie in the grid.
    pub placement: BoardPlacement,
    /// Whether it has every corner.
    pub whole: bool,
}

/// Finds `board` in `image`, or the largest part of it.
///
/// # Errors
/// [`NoBoard`] says why there is none.
pub(in crate::detection) fn find<'b>(
    image: GrayView<'_>,
    board: BoardSize,
    thresholds: &Thresholds,
    buffers: &'b mut SearchBuffers,
) -> Result<FoundGrid<'b>, NoBoard> {
    let longer = board.cols.max(board.rows) as usize;
    let shorter = board.cols.min(board.rows) as usize;
    let (width, height) = (image.width(), image.height());
    if width.max(height) < LEAST_SQUARE_PX * (longer + 1)
        || width.min(height) < LEAST_SQUARE_PX * (shorter + 1)
    {
        return Err(NoBoard::ImageTooSmall { width, height, board });
    }
    let coarsest = coarsest_level(image.size(), longer);
    let SearchBuffers { pyramid, levels } = buffers;
    pyramid.build(image, coarsest);
    let scene = SearchScene { probe: Probe { image, thresholds }, pyramid, board };
    let mut evidence = SearchEvidence::default();
    levels.forget();
    for level in (0..=coarsest).rev() {
        let view = scene.level(level).image;
        // Larger squares were searched for on the level above.
        let widest = view.width().max(view.height()) as f32 / (shorter - 1) as f32;
        let (every, reach_px) = if level == coarsest {
            (1, widest)
        } else {
            (ROW_STEP, widest.min(thresholds.search.most_step_px))
        };
        levels.respond(&scene, level, every);
        evidence.candidates = evidence.candidates.max(levels.candidates.found.len());
        if let Some(placement) = levels.search(&scene, level, reach_px, &mut evidence) {
            return Ok(FoundGrid { grid: &mut levels.part, placement, whole: true });
        }
        let enough =
            levels.best.is_some_and(|(count, _)| ENOUGH_ONE_IN * count > board.corner_count());
        if evidence.too_large || enough {
            break;
        }
    }
    if !evidence.too_large
        && let Some(placement) = levels.without_spurious(&scene)
    {
        return Ok(FoundGrid { grid: &mut levels.part, placement, whole: true });
    }
    match levels.best {
        Some((_, placement)) => Ok(FoundGrid { grid: &mut levels.part, placement, whole: false }),
        None => Err(no_board(&scene.level(coarsest), board, coarsest, &evidence)),
    }
}
