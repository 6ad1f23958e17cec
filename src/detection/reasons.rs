//! Why there is no board.

use super::board_detection::NoBoard;
use super::detector::{Detector, Seen};
use crate::imaging::gray::GrayView;

/// Range of brightness that is no picture at all, in grey levels.
const LEAST_RANGE: u8 = 8;

impl Detector {
    /// The reason for what was seen, on the levels up to `coarsest`, that was no board.
    pub(super) fn reason(&self, image: GrayView<'_>, coarsest: usize, seen: &Seen) -> NoBoard {
        let view = self.pyramid.level(image, coarsest);
        let range = brightness_range(view);
        if range < LEAST_RANGE {
            return NoBoard::LowContrast { range };
        }
        if let Some((cols, rows)) = seen.other {
            return NoBoard::OtherSize { cols, rows, board: self.board };
        }
        if seen.candidates == 0 {
            return NoBoard::NoCorners;
        }
        NoBoard::NoGrid { corners: seen.candidates, cols: seen.size.0, rows: seen.size.1 }
    }
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
    let low = first_beyond(share, (0..256).map(|v| counts[v]));
    let high = 255 - first_beyond(share, (0..256).rev().map(|v| counts[v]));
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
