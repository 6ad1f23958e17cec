//! The corners of a board after refinement: which of them are reported, and with what standard
//! deviation.

use crate::detection::board_detection::{DetectedCorner, GridIndex};
use crate::detection::grid::perspective::Perspective;
use crate::detection::grid::{Grid, Node};
use crate::detection::measure::Probe;
use crate::detection::measure::edges::{EdgeCount, count_edges};
use crate::detection::refine::{GridCorner, RefinedCorner};
use crate::detection::vec2::Vec2;
use crate::detection::verify::consistency::{off_curve, off_neighbors, outlier};
use crate::detection::verify::placement::BoardPlacement;
use crate::geometry::board::BoardSize;

/// Bounds of the standard deviation of a corner that could not be refined, in pixels: the error of
/// the window that found it, and the size of that window. Chosen, not swept.
const UNREFINED_STD_PX: [f64; 2] = [0.3, 3.0];

/// What one corner is compared with.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct CornerTest<'a> {
    /// The image.
    pub probe: Probe<'a>,
    /// The corners before refinement.
    pub grid: &'a Grid,
    /// The placement of the board in the grid.
    pub placement: BoardPlacement,
    /// The board.
    pub board: BoardSize,
}

impl CornerTest<'_> {
    /// The corner to report for `guess`. `refined` is its refinement, if there is one that
    /// [stays](Self::stays). `None` if the corner is rejected.
    pub(in crate::detection) fn accept(
        &self,
        guess: &GridCorner,
        refined: Option<&RefinedCorner>,
    ) -> Option<DetectedCorner> {
        let thresholds = &self.probe.thresholds.corners;
        let GridCorner { index, pixel, .. } = *guess;
        match refined {
            Some(refined) => {
                let (i, j) = self.placement.in_grid(index.col, index.row);
                let tight = self.grid.get(i, j).is_some_and(|node| node.tight);
                let least = if tight { thresholds.least_tight_std_px } else { 0.0 };
                let std_px = refined.std_px.max(least);
                Some(DetectedCorner { index, pixel: refined.pixel, std_px })
            }
            None => self.stands(guess).then(|| {
                let [least, most] = UNREFINED_STD_PX;
                let std_px = (thresholds.unrefined_std * nearest_px(guess)).clamp(least, most);
                DetectedCorner { index, pixel, std_px }
            }),
        }
    }

    /// Whether a refined corner is still the one in `guess`.
    pub(in crate::detection) fn stays(&self, guess: &GridCorner, refined: &RefinedCorner) -> bool {
        refined.pixel.distance_px(guess.pixel)
            < self.probe.thresholds.corners.most_moved * nearest_px(guess)
    }

    /// Whether a corner that could not be refined is certain nevertheless: all its neighbors are
    /// seen, and all edges to them hold.
    fn stands(&self, guess: &GridCorner) -> bool {
        let thresholds = &self.probe.thresholds.corners;
        let GridIndex { col, row } = guess.index;
        let (cols, rows) = (self.board.cols as i32, self.board.rows as i32);
        let around = [(col + 1, row), (col, row + 1), (col - 1, row), (col, row - 1)];
        let on_board = |&(c, r): &(i32, i32)| (0..cols).contains(&c) && (0..rows).contains(&r);
        let complete =
            around.iter().zip(&guess.neighbors).all(|(at, seen)| seen.is_some() || !on_board(at));
        let (i, j) = self.placement.in_grid(col, row);
        let EdgeCount { held, seen } = count_edges(self.probe, self.grid, i, j);
        let clear = self.grid.get(i, j).is_some_and(|node| node.score >= thresholds.standing_score);
        let in_place = clear
            && off_neighbors(self.grid, i, j).is_some_and(|off| off < thresholds.standing_off);
        complete && seen >= 2 && held == seen && in_place
    }
}

/// Distance of a corner's nearest neighbor, in pixels.
fn nearest_px(guess: &GridCorner) -> f64 {
    let distances = guess.neighbors.iter().flatten().map(|p| p.distance_px(guess.pixel));
    distances.fold(f64::MAX, f64::min)
}

/// Drops those of `corners` that are not where their refined neighbors predict them: the border of
/// an occluder next to a corner may have been taken for one of its edges. `median_std_px` is the
/// median of their standard deviations; `grid` takes over the refined positions.
pub(in crate::detection) fn drop_outliers(
    probe: Probe<'_>,
    grid: &mut Grid,
    placement: BoardPlacement,
    corners: &mut Vec<DetectedCorner>,
    median_std_px: f64,
) {
    let thresholds = &probe.thresholds.corners;
    for corner in corners.iter() {
        let (i, j) = placement.in_grid(corner.index.col, corner.index.row);
        if let Some(node) = grid.get(i, j) {
            let pixel = Vec2::new(corner.pixel.x as f32, corner.pixel.y as f32);
            grid.set(i, j, Node { pixel, ..node });
        }
    }
    let (grid, perspective) = (&*grid, Perspective::fit(grid));
    let anchored = |i: i32, j: i32| grid.is_anchored(i, j);
    let known = grid.members.iter().filter(|&&(i, j)| anchored(i, j)).count();
    let of_anchored =
        Perspective::fit_to(grid, anchored).filter(|_| known >= thresholds.least_anchored);
    corners.retain(|corner| {
        let (i, j) = placement.in_grid(corner.index.col, corner.index.row);
        let suspect = corner.std_px > thresholds.suspect_stds * median_std_px;
        let most = if suspect { thresholds.most_off_near_occluder } else { thresholds.most_off };
        let near = |off: f32| off < most;
        if !anchored(i, j)
            && let Some(off) =
                of_anchored.as_ref().and_then(|board| board.off(grid, i, j, anchored))
        {
            // A line of corners along an occluder's border is no reference for its own corners: all
            // of them may follow that border.
            let tight = grid.get(i, j).is_some_and(|node| node.tight);
            let off_curved = off_curve(grid, i, j).filter(|_| tight).unwrap_or(off);
            let holds = off.min(off_curved) < thresholds.most_off_near_occluder;
            return if tight { holds } else { near(off) };
        }
        // At the end of a line there are few neighbors, and slant or curvature biases their
        // prediction; that of the whole board is better.
        let of_all = || perspective.as_ref().and_then(|board| board.off(grid, i, j, |_, _| true));
        outlier(grid, i, j, most).is_none_or(near) || of_all().is_some_and(near)
    });
}
