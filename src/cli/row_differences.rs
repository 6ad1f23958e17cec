//! The row differences of a board's corners in two rectified images.

use serde::Serialize;

use crate::detection::board_detection::{Detection, GridIndex};
use crate::geometry::rectification::StereoAxis;

/// Differences in row (in column, for cameras one above the other), in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct RowDifferences {
    pub corners: usize,
    /// The second image's row minus the first one's, on average.
    pub mean_px: f64,
    pub rms_px: f64,
    pub worst_px: f64,
}

impl RowDifferences {
    /// The statistics of these differences; `None` if there are none.
    pub fn of(differences: &[f64]) -> Option<Self> {
        let count = differences.len() as f64;
        let mean_of = |value: fn(f64) -> f64| {
            differences.iter().map(|difference| value(*difference)).sum::<f64>() / count
        };
        (!differences.is_empty()).then(|| Self {
            corners: differences.len(),
            mean_px: mean_of(|difference| difference),
            rms_px: mean_of(|difference| difference * difference).sqrt(),
            worst_px: differences.iter().fold(0.0, |worst, difference| worst.max(difference.abs())),
        })
    }
}

/// The row differences of the corners that both images show.
///
/// # Errors
/// Why the corners of one image cannot be matched to the other's, in words.
pub(super) fn differences(
    detections: [&Detection; 2],
    axis: StereoAxis,
) -> Result<Vec<f64>, &'static str> {
    let [first, second] = detections;
    if !(first.position_known && second.position_known) {
        return Err("only part of the board is seen, and not which");
    }
    // If no image shows the orientation of a symmetric board, the one with the smaller row
    // differences is taken.
    let found = ways_round(first).into_iter().map(|index_in_second| {
        let pairs = first.corners.iter().filter_map(|corner| {
            let index = index_in_second(first, corner.index);
            let other = second.corners.iter().find(|other| other.index == index)?;
            Some(axis.shared(other.pixel) - axis.shared(corner.pixel))
        });
        pairs.collect::<Vec<f64>>()
    });
    let rms = |pairs: &[f64]| RowDifferences::of(pairs).map_or(f64::INFINITY, |all| all.rms_px);
    let best = found.min_by(|a, b| rms(a).total_cmp(&rms(b))).unwrap_or_default();
    if best.is_empty() { Err("no corner is seen in both images") } else { Ok(best) }
}

type IndexInSecond = fn(&Detection, GridIndex) -> GridIndex;

fn ways_round(detection: &Detection) -> Vec<IndexInSecond> {
    let mut ways: Vec<IndexInSecond> = vec![|_, index| index];
    if detection.orientation_ambiguous {
        ways.push(half);
        if detection.board.cols == detection.board.rows {
            ways.push(quarter);
            ways.push(|detection, index| half(detection, quarter(detection, index)));
        }
    }
    ways
}

fn half(detection: &Detection, GridIndex { col, row }: GridIndex) -> GridIndex {
    let [cols, rows] = [detection.board.cols, detection.board.rows].map(|count| count as i32);
    GridIndex { col: cols - 1 - col, row: rows - 1 - row }
}

fn quarter(detection: &Detection, GridIndex { col, row }: GridIndex) -> GridIndex {
    GridIndex { col: row, row: detection.board.cols as i32 - 1 - col }
}
