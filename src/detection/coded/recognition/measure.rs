//! The proportions of a board that was found: how large its markers are, or how wide the gaps
//! between its tags.

use crate::detection::coded::answer::TargetDetection;
use crate::detection::coded::chart::{Chart, ChartPair};
use crate::detection::coded::detector::TargetDetector;
use crate::detection::measure::edges::sample;
use crate::geometry::target::{AprilGrid, CharucoBoard, Target};
use crate::imaging::gray::GrayView;

/// Margins at which a marker's edge is searched for, in hundredths of a square's side.
const MARGINS: std::ops::Range<usize> = 2..35;
/// Places along a side, in parts of it, at which it is searched for: all within a marker.
const ALONG_PARTS: [f32; 5] = [0.4, 0.45, 0.5, 0.55, 0.6];

/// Rows of a board of which no corner is seen.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::detection) struct UnseenRows {
    /// Above or below, the board is not seen to end: there may be more.
    pub may_go_on: bool,
    /// One of the board's own rows would lie within the image: it has fewer.
    pub missing_in_view: bool,
}

impl TargetDetector {
    /// The target with what `detection`, just found in `image`, shows of it.
    pub(in crate::detection) fn measured(
        &self,
        image: GrayView<'_>,
        detection: &TargetDetection,
    ) -> Target {
        match self.target {
            Target::Charuco(board) => {
                let ratio = self.marker_ratio(image, detection);
                let marker_m = ratio.map_or(board.marker_m, |ratio| board.square_m * ratio);
                let legacy = detection.markers.legacy;
                Target::Charuco(CharucoBoard { marker_m, legacy, ..board })
            }
            Target::AprilGrid(grid) => {
                let spacing = self.gap_ratio().unwrap_or(grid.spacing);
                let border_bits = detection.markers.border_bits.or(grid.border_bits);
                Target::AprilGrid(AprilGrid { spacing, border_bits, ..grid })
            }
            other => other,
        }
    }

    /// What the rows of the board say, beyond those that `detection` sees.
    pub(in crate::detection) fn unseen_rows(
        &self,
        image: GrayView<'_>,
        detection: &TargetDetection,
    ) -> UnseenRows {
        let pairs: Vec<ChartPair> = detection
            .corners
            .iter()
            .map(|corner| ChartPair {
                place: [corner.index.col, corner.index.row].map(|k| f64::from(self.sheets.line(k))),
                pixel: [corner.pixel.x, corner.pixel.y],
                weight: 1.0,
            })
            .collect();
        let Some(chart) = Chart::fit(&pairs) else { return UnseenRows::default() };
        let lattice = self.target.lattice();
        let (across, down) = (lattice.cols as i32, lattice.rows as i32);
        let (width, height) = (image.width() as f32, image.height() as f32);
        let in_view = |row: i32| {
            let seen = (0..across).filter(|&col| {
                let place = (self.sheets.line(col), self.sheets.line(row));
                chart.at(place.0, place.1).is_some_and(|p| {
                    p.x > 0.0 && p.y > 0.0 && p.x < width - 1.0 && p.y < height - 1.0
                })
            });
            2 * seen.count() >= across as usize
        };
        let is_seen = |row: i32| detection.corners.iter().any(|corner| corner.index.row == row);
        UnseenRows {
            may_go_on: !self.ends_are_seen(image, detection),
            missing_in_view: (0..down).any(|row| !is_seen(row) && in_view(row)),
        }
    }

    /// The side of the markers over that of the squares: where a square's margin ends at its
    /// marker.
    fn marker_ratio(&self, image: GrayView<'_>, detection: &TargetDetection) -> Option<f64> {
        let mut profile = vec![(0.0_f32, 0.0_f32); MARGINS.end];
        let mut pairs = Vec::new();
        let in_bright = !detection.markers.inverted;
        for &(i, j) in &self.grid.members {
            let corners = [(i + 1, j), (i, j + 1), (i + 1, j + 1)];
            let whole = corners.iter().all(|at| self.grid.get(at.0, at.1).is_some());
            if !whole || (self.grid.polarity(i, j) > 0.0) != in_bright {
                continue;
            }
            let chart = Chart::near(&self.grid, &self.sheets, (i, j), None, &mut pairs)?;
            let mut add = |margin: usize, u: f32, v: f32| {
                let place = chart.at(i as f32 + u, j as f32 + v);
                if let Some(value) = place.and_then(|p| sample(image, p)) {
                    profile[margin].0 += value;
                    profile[margin].1 += 1.0;
                }
            };
            for margin in MARGINS {
                let inward = margin as f32 / 100.0;
                for along in ALONG_PARTS {
                    add(margin, inward, along);
                    add(margin, 1.0 - inward, along);
                    add(margin, along, inward);
                    add(margin, along, 1.0 - inward);
                }
            }
        }
        let mean: Vec<f32> =
            profile[MARGINS].iter().map(|(sum, count)| sum / count.max(1.0)).collect();
        // The steepest step from the margin's color to the border's.
        let sign = if in_bright { 1.0 } else { -1.0 };
        let step = |k: &usize| (mean[*k] - mean[*k + 1]) * sign;
        let steepest =
            (0..mean.len() - 1).max_by(|a, b| step(a).total_cmp(&step(b)).then(b.cmp(a)))?;
        let margin = (MARGINS.start + steepest) as f64 + 0.5;
        Some(1.0 - 2.0 * margin / 100.0)
    }

    /// The gap between two tags over a tag's side: of intervals side by side on one line, whose
    /// perspective cancels in a gap between two tags.
    fn gap_ratio(&self) -> Option<f64> {
        let mut ratios = Vec::new();
        for &(i, j) in &self.grid.members {
            for (di, dj, on) in [(1, 0, i), (0, 1, j)] {
                if on & 1 != 0 {
                    continue;
                }
                let pixel = |k: i32| self.grid.pixel(i + k * di, j + k * dj);
                if let (Some(a), Some(b), Some(c), Some(d)) =
                    (pixel(0), pixel(1), pixel(2), pixel(3))
                {
                    // Tag, gap, tag.
                    let tags = ((b - a).norm() * (d - c).norm()).sqrt();
                    ratios.push(f64::from((c - b).norm() / tags));
                }
            }
        }
        ratios.sort_unstable_by(f64::total_cmp);
        ratios.get(ratios.len() / 2).copied()
    }
}
