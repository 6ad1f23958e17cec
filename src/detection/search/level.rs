//! One level of the image: candidates, seeds, grids, and the verification of each grid.

use crate::detection::grid::extent::{
    exceeds, is_whole, least_part, longer, most_corners, shorter,
};
use crate::detection::grid::{Bounds, Grid};
use crate::detection::measure::Probe;
use crate::detection::reasons::SearchEvidence;
use crate::detection::search::candidates::CandidateSearch;
use crate::detection::search::growth::Growth;
use crate::detection::search::pyramid::Pyramid;
use crate::detection::search::response::Response;
use crate::detection::search::seeds::{Neighborhood, Seed};
use crate::detection::vec2::Vec2;
use crate::detection::verify::consistency::verify;
use crate::detection::verify::ends::{SeenEnds, seen_ends};
use crate::detection::verify::placement::{BoardPlacement, place};
use crate::detection::verify::spurious::drop_spurious;
use crate::geometry::board::BoardSize;

/// The image to search.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct SearchScene<'a> {
    /// The image itself, with the thresholds.
    pub probe: Probe<'a>,
    /// Its pyramid.
    pub pyramid: &'a Pyramid,
    /// The board searched for.
    pub board: BoardSize,
}

impl<'a> SearchScene<'a> {
    /// Level `level` of the image.
    pub(in crate::detection) fn level(&self, level: usize) -> Probe<'a> {
        self.probe.at(self.pyramid.level(self.probe.image, level))
    }
}

/// Searches level by level; its buffers are reused from image to image.
#[derive(Debug, Default)]
pub(in crate::detection) struct LevelSearch {
    pub(in crate::detection) response: Response,
    pub(in crate::detection) candidates: CandidateSearch,
    pub(in crate::detection) neighborhood: Neighborhood,
    /// Candidates that belong to a grid already.
    used: Vec<bool>,
    pub(in crate::detection) growth: Growth,
    /// The grid being grown.
    grid: Grid,
    /// The best grid so far, in pixels of the image.
    pub(in crate::detection) part: Grid,
    /// Its number of corners and its placement.
    pub(in crate::detection) best: Option<(usize, BoardPlacement)>,
    /// The first grid that was the whole board and spurious corners beyond it, without these.
    trimmed: Option<Grid>,
}

/// The result of verifying a grid.
enum GridOutcome {
    Whole(BoardPlacement),
    Part(BoardPlacement),
    Other { cols: u32, rows: u32 },
    Nothing,
}

impl GridOutcome {
    fn other(bounds: Bounds) -> Self {
        Self::Other { cols: longer(bounds), rows: shorter(bounds) }
    }
}

impl LevelSearch {
    /// Starts with another image.
    pub(in crate::detection) fn forget(&mut self) {
        self.best = None;
        self.trimmed = None;
    }

    /// Computes the response of one in `every` rows of `level`, and from it the candidates.
    pub(in crate::detection) fn respond(
        &mut self,
        scene: &SearchScene<'_>,
        level: usize,
        every: usize,
    ) {
        let probe = scene.level(level);
        self.response.compute(probe.image, every);
        self.candidates.search(probe, &self.response, scene.board.corner_count());
    }

    /// Grows grids from the candidates of `level`, for squares with sides up to `reach_px`. Leaves
    /// a whole board, or the best part so far, in `part`.
    pub(in crate::detection) fn search(
        &mut self,
        scene: &SearchScene<'_>,
        level: usize,
        reach_px: f32,
        evidence: &mut SearchEvidence,
    ) -> Option<BoardPlacement> {
        let (view, thresholds) = (scene.level(level).image, &scene.probe.thresholds.search);
        self.neighborhood.set_thresholds(scene.probe.thresholds.seeds);
        self.neighborhood.fill(&self.candidates.found, view.width(), view.height());
        self.used.clear();
        self.used.resize(self.candidates.found.len(), false);
        if self.best.is_some() {
            self.spend_part(level, thresholds.same_px);
        }
        let (mut grids, mut starts) = (0, 0);
        for first in 0..self.candidates.found.len() {
            if grids == thresholds.most_grids
                || starts == thresholds.most_starts
                || evidence.too_large
            {
                break;
            }
            let seed = if self.used[first] {
                None
            } else {
                self.neighborhood.seed(&self.candidates.found, first, reach_px)
            };
            let Some(seed) = seed else { continue };
            starts += 1;
            let worth = self.grow_from(scene, level, &seed);
            self.spend_grid(thresholds.same_px);
            if !worth {
                continue;
            }
            grids += 1;
            match self.judge(scene, level, evidence) {
                GridOutcome::Whole(placement) => {
                    std::mem::swap(&mut self.grid, &mut self.part);
                    return Some(placement);
                }
                GridOutcome::Part(placement) => {
                    let count = self.grid.members.len();
                    if self.best.is_none_or(|(most, _)| count > most) {
                        self.best = Some((count, placement));
                        std::mem::swap(&mut self.grid, &mut self.part);
                    }
                }
                GridOutcome::Other { cols, rows } => {
                    evidence.other = evidence.other.or(Some((cols, rows)));
                }
                GridOutcome::Nothing => {}
            }
        }
        None
    }

    /// Grows a grid from `seed`; true if it is large enough to verify.
    fn grow_from(&mut self, scene: &SearchScene<'_>, level: usize, seed: &Seed) -> bool {
        let (probe, board) = (scene.level(level), scene.board);
        let Self { growth, candidates, neighborhood, grid, .. } = self;
        let radius = board.cols.max(board.rows) as i32 + 2;
        growth.start(probe, &candidates.found, seed, radius, grid);
        if !is_whole(grid, board) && grid.bounds().is_some_and(|bounds| !exceeds(bounds, board)) {
            growth.reach(probe, &candidates.found, neighborhood, grid);
        }
        grid.members.len() >= scene.probe.thresholds.search.least_grown
    }

    /// Candidates that are corners of the grid (even of a rejected one) do not start another grid.
    fn spend_grid(&mut self, same_px: f32) {
        let Self { neighborhood, candidates, grid, used, .. } = self;
        for p in grid.members.iter().filter_map(|&(i, j)| grid.pixel(i, j)) {
            neighborhood.visit_near(&candidates.found, p, same_px, |index| used[index] = true);
        }
    }

    /// Neither do those of the best part, which is in pixels of the image.
    fn spend_part(&mut self, level: usize, same_px: f32) {
        let Self { neighborhood, candidates, part, used, .. } = self;
        let (scale, offset) = ((1 << level) as f32, Vec2::repeat(0.5));
        for p in part.members.iter().filter_map(|&(i, j)| part.pixel(i, j)) {
            let p = (p + offset) / scale - offset;
            neighborhood.visit_near(&candidates.found, p, same_px, |index| used[index] = true);
        }
    }

    /// Takes the grid found on `level` down to the image itself, and verifies it there.
    fn judge(
        &mut self,
        scene: &SearchScene<'_>,
        level: usize,
        evidence: &mut SearchEvidence,
    ) -> GridOutcome {
        let Self { growth, grid, .. } = self;
        let (probe, board) = (scene.probe, scene.board);
        let thresholds = &probe.thresholds.search;
        if let Some(bounds) = grid.bounds()
            && exceeds(bounds, board)
        {
            evidence.too_large = true;
            return GridOutcome::other(bounds);
        }
        // A grid this small that outgrows the whole board on a finer level is a stripe pattern.
        let small = grid.members.len() < thresholds.least_part;
        growth.descend(scene, grid, level);
        if small && grid.members.len() >= most_corners(board) {
            return GridOutcome::Nothing;
        }
        if !verify(probe, grid) {
            return GridOutcome::Nothing;
        }
        // A grid is bridged only if it is enough larger than all that were bridged before.
        let verified = grid.members.len();
        if verified >= evidence.bridged + thresholds.worth_bridging {
            evidence.bridged = verified;
            if growth.bridge_occluders(scene, grid) && !verify(probe, grid) {
                return GridOutcome::Nothing;
            }
        }
        let Some(bounds) = grid.bounds() else { return GridOutcome::Nothing };
        if grid.members.len() > evidence.largest {
            evidence.largest = grid.members.len();
            evidence.size = (longer(bounds), shorter(bounds));
        }
        if self.trimmed.is_none() && grid.members.len() > board.corner_count() {
            let mut trimmed = grid.clone();
            self.trimmed = drop_spurious(probe, &mut trimmed, bounds, board).then_some(trimmed);
        }
        self.placed(scene, bounds)
    }

    /// The board without spurious corners beyond it, for a search that found no whole board. Leaves
    /// it in `part`.
    pub(in crate::detection) fn without_spurious(
        &mut self,
        scene: &SearchScene<'_>,
    ) -> Option<BoardPlacement> {
        self.grid = self.trimmed.take()?;
        let bounds = self.grid.bounds()?;
        let GridOutcome::Whole(placement) = self.placed(scene, bounds) else { return None };
        std::mem::swap(&mut self.grid, &mut self.part);
        Some(placement)
    }

    /// What the verified grid, which lies within `bounds`, is of the board.
    fn placed(&mut self, scene: &SearchScene<'_>, bounds: Bounds) -> GridOutcome {
        let Self { growth, grid, .. } = self;
        let (probe, board) = (scene.probe, scene.board);
        let thresholds = &probe.thresholds.search;
        let count = grid.members.len();
        let ends = seen_ends(probe, grid, bounds);
        if is_whole(grid, board)
            && ends.goes_on.contains(&true)
            && let Some(larger) = larger_bounds(scene, growth, grid, bounds)
        {
            return GridOutcome::other(larger);
        }
        match placement(scene, grid, bounds, ends) {
            Some(placement) if is_whole(grid, board) => GridOutcome::Whole(placement),
            Some(placement)
                if count >= least_part(board, thresholds)
                    && shorter(bounds) >= thresholds.least_line =>
            {
                GridOutcome::Part(placement)
            }
            Some(_) => GridOutcome::Nothing,
            None => {
                let filled = grid.filled_bounds().unwrap_or(bounds);
                let (cols, rows) = (board.cols.max(board.rows), board.cols.min(board.rows));
                match (longer(filled), shorter(filled)) == (cols, rows) {
                    true => GridOutcome::Nothing,
                    false => GridOutcome::other(filled),
                }
            }
        }
    }
}

/// The bounds of a larger grid of which `grid`, as large as the whole board, is a part: there are
/// corners beyond it, at least two on a line, that a coarser level could not measure. `None` if
/// there are none.
fn larger_bounds(
    scene: &SearchScene<'_>,
    growth: &mut Growth,
    grid: &mut Grid,
    bounds: Bounds,
) -> Option<Bounds> {
    let (probe, board) = (scene.probe, scene.board);
    grid.forget_attempts();
    growth.grow_to(probe, grid, &probe.thresholds.windows.0, most_corners(board));
    let larger = grid.anchored_bounds().filter(|&larger| larger != bounds);
    if larger.is_some() && verify(probe, grid) && grid.anchored_bounds() == larger {
        return larger;
    }
    for index in (0..grid.members.len()).rev() {
        let (i, j) = grid.members[index];
        if !bounds.contains(i, j) {
            grid.remove(i, j);
        }
    }
    None
}

/// Where the board can lie in the grid, given its sure ends. `None` if it does not fit with all
/// possible ends as its own.
fn placement(
    scene: &SearchScene<'_>,
    grid: &Grid,
    bounds: Bounds,
    ends: SeenEnds,
) -> Option<BoardPlacement> {
    place(grid, bounds, ends.possible, scene.board)?;
    place(grid, bounds, ends.sure, scene.board)
}
