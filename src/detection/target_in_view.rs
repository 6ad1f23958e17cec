//! Which target an image shows, when none is named.

use std::fmt;

use crate::detection::board_detection::{DetectOptions, Detection, NoBoard};
use crate::detection::coded::recognition::{RecognizedBoard, recognize};
use crate::detection::detector::Detector;
use crate::geometry::board::BoardSize;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Sizes that are searched for one after the other, until the error names the size that is seen. A
/// grid grows up to two squares beyond the board that is searched for, so one search names boards
/// up to about that size.
const SEARCHED: [BoardSize; 4] = [
    BoardSize { cols: 12, rows: 11 },
    BoardSize { cols: 9, rows: 8 },
    BoardSize { cols: 6, rows: 5 },
    BoardSize { cols: 18, rows: 17 },
];

/// How far beyond its outer corners a chessboard must lie in the image, in squares: one, and some
/// of the border, since otherwise the board might continue there.
const SEEN_BEYOND: f64 = 1.1;

/// A target that an image shows.
#[derive(Debug, Clone, PartialEq)]
pub enum TargetInView {
    /// A ChArUco board or an AprilGrid.
    WithMarkers(Box<RecognizedBoard>),
    /// A plain chessboard, all of which is seen.
    Chessboard(Detection),
}

impl fmt::Display for TargetInView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WithMarkers(board) => board.fmt(f),
            Self::Chessboard(Detection { board, .. }) => {
                write!(f, "chessboard of {board} inner corners")
            }
        }
    }
}

/// The target that `image` shows: a board with markers, else a whole chessboard; `None` if it shows
/// neither. The guessed target is searched for as if it had been asked for, so a target is named
/// only if all of detection confirms it. It takes several times as long as the search for one
/// target.
///
/// # Examples
/// ```
/// use plumb::detection::target_in_view::target_in_view;
/// use plumb::imaging::gray::GrayImage;
///
/// let blank = GrayImage::default();
/// assert!(target_in_view(blank.view()).is_none());
/// ```
pub fn target_in_view(image: GrayView<'_>) -> Option<TargetInView> {
    if let Some(board) = recognize(image) {
        return Some(TargetInView::WithMarkers(Box::new(board)));
    }
    SEARCHED.into_iter().find_map(|size| chessboard(image, size)).map(TargetInView::Chessboard)
}

/// The chessboard of this size, or the one that is seen instead.
fn chessboard(image: GrayView<'_>, size: BoardSize) -> Option<Detection> {
    let whole = |size| Detector::new(size).find_board(image, &DetectOptions::default());
    let found = match whole(size) {
        Err(NoBoard::OtherSize { cols, rows, .. }) => whole(BoardSize::new(cols, rows).ok()?),
        found => found,
    };
    found.ok().filter(|found| ends_in_view(image, found))
}

/// Whether the outer squares of a board with all corners seen also lie in the image.
fn ends_in_view(image: GrayView<'_>, found: &Detection) -> bool {
    let [cols, rows] = [found.board.cols as usize, found.board.rows as usize];
    let at = |col: usize, row: usize| found.corners[row * cols + col].pixel;
    let inside = |outer: Pixel, inner: Pixel| {
        let x = outer.x + SEEN_BEYOND * (outer.x - inner.x);
        let y = outer.y + SEEN_BEYOND * (outer.y - inner.y);
        let within = |at: f64, size: usize| at >= 0.0 && at <= size as f64 - 1.0;
        within(x, image.width()) && within(y, image.height())
    };
    let row_ends = (0..rows)
        .all(|row| inside(at(0, row), at(1, row)) && inside(at(cols - 1, row), at(cols - 2, row)));
    row_ends
        && (0..cols).all(|col| {
            inside(at(col, 0), at(col, 1)) && inside(at(col, rows - 1), at(col, rows - 2))
        })
}
