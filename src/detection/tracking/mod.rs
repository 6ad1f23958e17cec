//! Tracking for live use: finds the board near its last position, at a fraction of the cost of a
//! search.
//!
//! Each corner is measured in the image itself, in a window as wide as its squares, at its last
//! position and at the position that its motion predicts. The result must pass the tests of a
//! search: every corner of the board is there, most edges hold, and there are no corners beyond.
//! Otherwise the whole image is searched.

mod board_edges;
mod last_board;
pub(in crate::detection) mod last_corners;
pub(in crate::detection) mod sampled;

use crate::detection::board_detection::{DetectedCorner, Detection};
use crate::detection::grid::Grid;
use crate::detection::grid::extent::is_whole;
use crate::detection::measure::Probe;
use crate::detection::measure::cross::{CrossWindow, LEAST_INSIDE};
use crate::detection::measure::prediction::Prediction;
use crate::detection::report::{ReportBuffers, detection, take_guesses};
use crate::detection::search::FoundGrid;
use crate::detection::tracking::board_edges::EdgeMeasurements;
use crate::detection::tracking::last_board::LastBoard;
use crate::detection::tracking::sampled::{keep_spread, measured_std_px};
use crate::detection::verify::consistency::off_neighbors;
use crate::detection::verify::placement::{BoardPlacement, place};
use crate::geometry::board::BoardSize;

/// Corners of a tracked board that are refined, to estimate the blur and the error of the others.
/// Chosen, not swept.
const SAMPLED: usize = 4;

/// A board in a live image.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedBoard {
    /// The board.
    pub detection: Detection,
    /// Whether it was tracked instead of searched for: then only the corners that estimate blur and
    /// error are refined, and `std_px` is the same for all.
    pub followed: bool,
}

/// Tracks a board from image to image.
#[derive(Debug, Default)]
pub(in crate::detection) struct Tracker {
    last: LastBoard,
    grid: Grid,
    followed: EdgeMeasurements,
}

impl Tracker {
    /// Forgets the board: the next image is searched.
    pub(in crate::detection) fn forget(&mut self) {
        self.last.corners.forget();
    }

    /// Tracks the whole board `found` from here on.
    pub(in crate::detection) fn begin(
        &mut self,
        found: &FoundGrid<'_>,
        board: BoardSize,
        blur_px: f64,
    ) {
        self.last.remember(found.grid, found.placement, board);
        self.last.blur_px = blur_px as f32;
    }

    /// Tracks the board near its last position; `None` if it must be searched for.
    pub(in crate::detection) fn follow(
        &mut self,
        probe: Probe<'_>,
        board: BoardSize,
        buffers: &mut ReportBuffers,
    ) -> Option<Detection> {
        if !self.last.corners.is_whole(board.corner_count()) {
            return None;
        }
        let moved = self.last.corners.moved() && self.measure_at_predictions(probe, board, true);
        if !moved && !self.measure_at_predictions(probe, board, false) {
            return None;
        }
        if !is_whole(&self.grid, board) {
            self.measure_between_neighbors(probe, board);
        }
        if !is_whole(&self.grid, board)
            || !self.holds_together(probe, board)
            || self.goes_on_beyond(probe, board)
        {
            return None;
        }
        let placement = place(&self.grid, self.grid.bounds()?, [false; 4], board)?;
        self.last.remember(&self.grid, placement, board);
        let detection = report_followed(probe, board, &self.grid, placement, buffers)?;
        self.last.blur_px = detection.blur_px as f32;
        Some(detection)
    }

    /// Starts a grid, in the board's own order, from the corners that are found at their
    /// predictions. Returns false if too many are not.
    fn measure_at_predictions(
        &mut self,
        probe: Probe<'_>,
        board: BoardSize,
        with_motion: bool,
    ) -> bool {
        let Self { last, grid, followed } = self;
        grid.clear(board.cols.max(board.rows) as i32 + 2, last.bright);
        followed.off.clear();
        let (count, cols) = (board.corner_count(), board.cols as usize);
        let mut lost = 0;
        for index in 0..count {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            let beside = (i > 0).then(|| followed.off[index - 1]).flatten();
            let above = (j > 0).then(|| followed.off[index - cols]).flatten();
            let off = beside.zip(above).map(|(a, b)| (a + b) * 0.5).or(beside).or(above);
            let seen = last.predict(index, board, with_motion).and_then(|corner| {
                let node = corner.measure(probe, off, grid.polarity(i, j), last.blur_px)?;
                Some((node, node.pixel - corner.expected))
            });
            followed.off.push(seen.map(|(_, off)| off));
            match seen {
                Some((node, _)) => grid.set(i, j, node),
                None => lost += 1,
            }
            if lost * probe.thresholds.tracking.most_lost > count {
                return false;
            }
        }
        true
    }

    /// Searches for the remaining corners where their neighbors predict them.
    fn measure_between_neighbors(&mut self, probe: Probe<'_>, board: BoardSize) {
        let cols = board.cols as usize;
        for index in 0..board.corner_count() {
            let (i, j) = ((index % cols) as i32, (index / cols) as i32);
            if self.grid.get(i, j).is_none()
                && let Some(node) =
                    Prediction::by_neighbors(&self.grid, (i, j), &probe.thresholds.measure)
                        .and_then(|place| place.measure(probe, &probe.thresholds.windows.0))
            {
                self.grid.set(i, j, node);
            }
        }
    }

    /// Whether the whole board in the grid, in the board's own order, is consistent: every corner
    /// is where its neighbors predict it, and most edges hold.
    fn holds_together(&mut self, probe: Probe<'_>, board: BoardSize) -> bool {
        let Self { grid, followed, .. } = self;
        let most_off = probe.thresholds.consistency.most_off;
        let in_place =
            |&(i, j): &(i32, i32)| off_neighbors(grid, i, j).is_some_and(|off| off <= most_off);
        grid.members.iter().all(in_place) && followed.edges_hold(probe, grid, board)
    }

    /// Whether the pattern continues beyond the board, which is then another board.
    fn goes_on_beyond(&self, probe: Probe<'_>, board: BoardSize) -> bool {
        let (cols, rows) = (board.cols as i32, board.rows as i32);
        let beside = (0..rows).flat_map(|j| [(-1, j), (cols, j)]);
        let above = (0..cols).flat_map(|i| [(i, -1), (i, rows)]);
        let window = probe.thresholds.windows.tracked();
        beside.chain(above).any(|at| {
            Prediction::by_neighbors(&self.grid, at, &probe.thresholds.measure)
                .filter(|place| may_be_corner(probe, place))
                .is_some_and(|place| place.measure(probe, &[window]).is_some())
        })
    }
}

/// Whether the four squares around `place` may be alternately bright and dark.
fn may_be_corner(probe: Probe<'_>, place: &Prediction) -> bool {
    let ([u, v], thresholds) = (place.steps, &probe.thresholds.tracking);
    let (a, b) = (u * thresholds.beyond, v * thresholds.beyond);
    let window = CrossWindow { center: place.expected, a, b }.inside(probe.image, LEAST_INSIDE);
    let depth = window.and_then(|window| window.alternation(probe.image));
    depth.is_some_and(|depth| depth * place.polarity > thresholds.may_alternate * place.contrast[0])
}

/// The tracked corners of `grid`; a few of them refined, to estimate the blur and the error of the
/// others.
fn report_followed(
    probe: Probe<'_>,
    board: BoardSize,
    grid: &Grid,
    placement: BoardPlacement,
    buffers: &mut ReportBuffers,
) -> Option<Detection> {
    take_guesses(grid, placement, &mut buffers.guesses);
    let ReportBuffers { guesses, refined, blurs, refiner, spare, .. } = buffers;
    let mut corners = std::mem::take(spare);
    corners.clear();
    corners.extend(guesses.iter().map(|guess| DetectedCorner {
        index: guess.index,
        pixel: guess.pixel,
        std_px: 0.0,
    }));
    keep_spread(guesses, SAMPLED);
    refiner.refine(probe.image, guesses, refined);
    blurs.clear();
    blurs.extend(refined.iter().flatten().map(|refined| refined.blur_px));
    let least = probe.thresholds.tracking.least_std_px;
    let Some(std_px) = measured_std_px(guesses, refined, least) else {
        *spare = corners;
        return None;
    };
    corners.iter_mut().for_each(|corner| corner.std_px = std_px);
    Some(detection(board, placement, corners, blurs))
}
