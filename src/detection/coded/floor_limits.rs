//! Limits for lattices that are larger than the board: floors of tiles, walls, woven cloth.
//!
//! A lattice with twice as many crossings as the board is not grown further, or only a little to
//! report its size: no placement of the board in it is accepted (`least_on_board`). The places
//! measured for floors are limited, and floors do not count as starts: a board that stands on a
//! floor is searched for as often as on a table.

use crate::detection::coded::sheet::Sheets;

/// A lattice with more than this many times the board's crossings is a floor. Chosen.
const FLOOR_BOARDS: usize = 2;
/// Places that are measured for floors on one level: enough for a few small floors. Chosen.
const PLACES_A_LEVEL: usize = 600;
/// Places added for each crossing of the board: four floors of twice its crossings. Chosen.
const PLACES_A_CROSSING: usize = 8;
/// Floors whose cells are read in one image. It only decides which reason is given for no board.
/// Chosen.
const MOST_READ: usize = 6;
/// Crossings up to which a floor that is read is grown, or `FLOOR_BOARDS` times the board's if that
/// is more: reasons state the size of chessboards of up to 20x20 corners. Chosen.
const MOST_NAMED: usize = 400;

/// Limits of the work on floors.
pub(super) struct FloorLimits {
    /// A lattice with more crossings is a floor.
    pub most_crossings: usize,
    /// Places that are measured for floors on one level.
    pub most_places: usize,
    /// Floors whose cells are read in one image.
    pub most_read: usize,
    /// Crossings up to which these are grown.
    pub most_named: usize,
}

impl FloorLimits {
    /// The limits in a search for a board with these sheets.
    pub(super) fn in_search_of(sheets: &Sheets) -> Self {
        let crossings = sheets.crossings();
        Self {
            most_crossings: FLOOR_BOARDS * crossings,
            most_places: PLACES_A_LEVEL + PLACES_A_CROSSING * crossings,
            most_read: MOST_READ,
            most_named: MOST_NAMED.max(FLOOR_BOARDS * crossings),
        }
    }
}
