//! Why there is no board.

use super::board_detection::NoBoard;
use super::cross::Vec2;
use super::detector::{Detector, SearchEvidence};
use crate::imaging::gray::GrayView;

/// Range of brightness below which an image is taken for empty, in gray levels.
const LEAST_RANGE: u8 = 8;

/// Minimum corners of a grid that is reported.
const LEAST_GRID: usize = 6;
/// Blur wider than this part of a square hides its corners.
const MOST_BLUR: f32 = 0.25;
/// Blur is read from the 99.9th percentile of the gradient magnitude.
const STEEPEST: usize = 1000;

impl Detector {
    /// The reason, from what was detected on the levels up to `coarsest`.
    pub(super) fn reason(
        &self,
        image: GrayView<'_>,
        coarsest: usize,
        seen: &SearchEvidence,
    ) -> NoBoard {
        let view = self.pyramid.level(image, coarsest);
        let range = brightness_range(view);
        if range < LEAST_RANGE {
            return NoBoard::LowContrast { range };
        }
        if let Some((cols, rows)) = seen.other {
            return NoBoard::OtherSize { cols, rows, board: self.board };
        }
        // A board across half of the image has squares of this size.
        let squares = 2 * (self.board.cols.max(self.board.rows) + 1);
        let square_px = view.width().max(view.height()) as f32 / squares as f32;
        let blur = sharpest_blur(view, range);
        if seen.largest < LEAST_GRID && blur > MOST_BLUR * square_px {
            return NoBoard::Blurred { blur_px: f64::from(blur) * f64::from(1 << coarsest) };
        }
        if seen.candidates == 0 {
            return NoBoard::NoCorners;
        }
        NoBoard::NoGrid { corners: seen.candidates, cols: seen.size.0, rows: seen.size.1 }
    }

    /// Why the board in `part` is not whole.
    pub(super) fn part_reason(&self, image: GrayView<'_>, seen: usize) -> NoBoard {
        let (part, board) = (&self.part, self.board);
        let (longer, shorter) =
            (board.cols.max(board.rows) as i32, board.cols.min(board.rows) as i32);
        let (width, height) =
            part.bounds().map_or((0, 0), |bounds| (bounds.width(), bounds.height()));
        let inside = |p: Vec2| {
            p.x > 1.0
                && p.y > 1.0
                && p.x < image.width() as f32 - 2.0
                && p.y < image.height() as f32 - 2.0
        };
        let beyond = |&(i, j): &(i32, i32), (di, dj): (i32, i32)| {
            let grown = (width.max(height) < longer) || (width.min(height) < shorter);
            let next = (i + di, j + dj);
            grown
                && part.get(next.0, next.1).is_none()
                && part.predict(next.0, next.1).is_some_and(|p| !inside(p))
        };
        let ways = [(1, 0), (0, 1), (-1, 0), (0, -1)];
        if part.members.iter().any(|member| ways.into_iter().any(|way| beyond(member, way))) {
            NoBoard::CutOff { seen, board }
        } else {
            NoBoard::Incomplete { seen, board }
        }
    }
}

/// Width of the sharpest edges of `image`, as a Gaussian's standard deviation: the slope of an edge
/// of height h blurred by σ is h/(σ√2π), and the edges are taken to be as high as the image's
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
    let share = image.width() * image.height() / STEEPEST;
    let steepest = 255 - first_beyond(share, counts.iter().rev().copied());
    f32::from(range) / (0.5 * steepest.max(1) as f32 * 2.5066)
}

/// Brightness between the 1st and the 99th percentile.
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

/// How many of `counts` it takes to have more than `share` in all, less one.
fn first_beyond(share: usize, counts: impl Iterator<Item = usize>) -> usize {
    let mut sum = 0;
    let short = counts.take_while(|&count| {
        sum += count;
        sum <= share
    });
    short.count().min(255)
}
