//! Why there is no board.

use crate::detection::board_detection::NoBoard;
use crate::detection::grid::Grid;
use crate::detection::measure::Probe;
use crate::detection::vec2::Vec2;
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// Blur is read from the 99.9th percentile of the gradient magnitude: edges are a few thousandths
/// of an image that shows a board.
const STEEPEST_ONE_IN: usize = 1000;
/// A corner closer to the image's border than this cannot be measured, in pixels.
const BORDER_PX: f32 = 1.0;

/// What the search found instead of the board.
#[derive(Debug, Default)]
pub(in crate::detection) struct SearchEvidence {
    /// Most candidates on any level.
    pub candidates: usize,
    /// Corners of the largest verified grid, and its longer and shorter side.
    pub largest: usize,
    /// See `largest`.
    pub size: (u32, u32),
    /// The longer and shorter side of a board of another size.
    pub other: Option<(u32, u32)>,
    /// A grid was larger than the board.
    pub too_large: bool,
    /// Corners of the largest grid that was bridged across occluders.
    pub bridged: usize,
}

/// Why there is no `board`, from the evidence of all levels; `probe` has the image of the level
/// `coarsest`.
pub(in crate::detection) fn no_board(
    probe: &Probe<'_>,
    board: BoardSize,
    coarsest: usize,
    evidence: &SearchEvidence,
) -> NoBoard {
    let (view, thresholds) = (probe.image, &probe.thresholds.reasons);
    if let Some((cols, rows)) = evidence.other {
        return NoBoard::OtherSize { cols, rows, board };
    }
    // A small board hardly changes the distribution of brightness.
    let range = brightness_range(view);
    if range < thresholds.least_range && evidence.largest < thresholds.least_grid {
        return NoBoard::LowContrast { range };
    }
    // The side of a square of a board that spans half of the image.
    let squares = 2 * (board.cols.max(board.rows) + 1);
    let square_px = view.width().max(view.height()) as f32 / squares as f32;
    let blur = sharpest_blur(view, range);
    if evidence.largest < thresholds.least_grid && blur > thresholds.most_blur * square_px {
        return NoBoard::Blurred { blur_px: f64::from(blur) * f64::from(1 << coarsest) };
    }
    if evidence.candidates == 0 {
        return NoBoard::NoCorners;
    }
    let (cols, rows) = evidence.size;
    NoBoard::NoGrid { corners: evidence.candidates, cols, rows }
}

/// Why a board of which `part` was found, with `seen` corners, is not whole.
pub(in crate::detection) fn not_whole(
    image: GrayView<'_>,
    part: &Grid,
    board: BoardSize,
    seen: usize,
) -> NoBoard {
    let (longer, shorter) = (board.cols.max(board.rows) as i32, board.cols.min(board.rows) as i32);
    let (width, height) = part.bounds().map_or((0, 0), |bounds| (bounds.width(), bounds.height()));
    let lacks_a_line = width.max(height) < longer || width.min(height) < shorter;
    let last = Vec2::new(image.width() as f32 - 1.0, image.height() as f32 - 1.0);
    let inside = |p: Vec2| {
        let room = p.inf(&(last - p));
        room.x > BORDER_PX && room.y > BORDER_PX
    };
    let beyond = |&(i, j): &(i32, i32), (di, dj): (i32, i32)| {
        let next = (i + di, j + dj);
        part.get(next.0, next.1).is_none()
            && part.predict(next.0, next.1).is_some_and(|p| !inside(p))
    };
    let ways = [(1, 0), (0, 1), (-1, 0), (0, -1)];
    let cut = |member: &(i32, i32)| ways.into_iter().any(|way| beyond(member, way));
    if lacks_a_line && part.members.iter().any(cut) {
        NoBoard::CutOff { seen, board }
    } else {
        NoBoard::Incomplete { seen, board }
    }
}

/// Width of the sharpest edges of `image`, as a Gaussian's standard deviation: the slope of an edge
/// of height h with a blur of σ is h/(σ√2π), and the height of edges is taken as the image's
/// `range` of brightness.
fn sharpest_blur(image: GrayView<'_>, range: u8) -> f32 {
    let mut counts = [0usize; 256];
    for y in 1..image.height().saturating_sub(1) {
        let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
        for x in 1..row.len().saturating_sub(1) {
            let slope = row[x - 1].abs_diff(row[x + 1]).max(above[x].abs_diff(below[x]));
            counts[slope as usize] += 1;
        }
    }
    let share = image.width() * image.height() / STEEPEST_ONE_IN;
    let steepest = 255 - first_beyond(share, counts.iter().rev().copied());
    f32::from(range) / (0.5 * steepest.max(1) as f32 * 2.5066)
}

/// The range of brightness between the 1st and the 99th percentile.
fn brightness_range(image: GrayView<'_>) -> u8 {
    let mut counts = [0usize; 256];
    for y in 0..image.height() {
        for &value in image.row(y) {
            counts[value as usize] += 1;
        }
    }
    let share = image.width() * image.height() / 100;
    let low = first_beyond(share, counts.iter().copied());
    let high = 255 - first_beyond(share, counts.iter().rev().copied());
    high.saturating_sub(low) as u8
}

/// The index at which the sum of `counts` first exceeds `share`.
fn first_beyond(share: usize, counts: impl Iterator<Item = usize>) -> usize {
    let mut sum = 0;
    let short = counts.take_while(|&count| {
        sum += count;
        sum <= share
    });
    short.count().min(255)
}
