//! The whole search: from the coarsest level of the image to the finest, until a board is found.

use super::board_detection::{DetectOptions, DetectedCorner, Detection, NoBoard};
use super::board_edges::Followed;
use super::candidates::CandidateSearch;
use super::cross::Vec2;
use super::ends::seen_ends;
use super::grid::{Bounds, Grid};
use super::growth::{Growth, WINDOWS, sharpen_all};
use super::last_board::LastBoard;
use super::placement::{BoardPlacement, place};
use super::pyramid::{Pyramid, coarsest_level};
use super::refine::{GridCorner, RefinedCorner, Refiner};
use super::response::Response;
use super::seeds::{Neighborhood, Seed};
use super::verification::verify;
use crate::geometry::board::BoardSize;
use crate::imaging::gray::GrayView;

/// Minimum corners of a partial board, in at least [`LEAST_LINE`] lines each way: fewer occur by
/// chance.
const LEAST_PART: usize = 12;
const LEAST_LINE: u32 = 3;
/// Grids verified per pyramid level.
const MOST_GRIDS: usize = 2;
/// Seed squares tried per pyramid level.
const MOST_STARTS: usize = 16;
/// Smaller grids are clutter.
const LEAST_GROWN: usize = 7;
/// A grid is bridged across occluders again only if it has this many corners more than one that was
/// rejected.
const WORTH_BRIDGING: usize = 4;
/// A candidate this near to a corner is that corner, in pixels of the level.
const SAME_PX: f32 = 2.5;
/// A grid this small that grows beyond the whole board on a finer level is a stripe pattern.
const SMALL: usize = LEAST_PART;
/// On all but the coarsest level one row in this many is searched: a response is wider than that,
/// and a board without a single visible square would have been found on the level above.
const ROW_STEP: usize = 2;
/// Longest side of a square searched for on any but the coarsest level, in pixels.
const MOST_STEP: f32 = 36.0;

/// Windows in which the corners of a grid are measured on their way to the image, as parts of the
/// distance to the neighbors.
const EXACT: [f32; 2] = [0.2, 0.1];

/// Finds one kind of board in images. Buffers are reused from image to image.
#[derive(Debug)]
pub struct Detector {
    pub(super) board: BoardSize,
    pub(super) pyramid: Pyramid,
    pub(super) response: Response,
    pub(super) candidates: CandidateSearch,
    pub(super) neighborhood: Neighborhood,
    pub(super) used: Vec<bool>,
    pub(super) growth: Growth,
    pub(super) grid: Grid,
    pub(super) part: Grid,
    pub(super) guesses: Vec<GridCorner>,
    pub(super) refined: Vec<Option<RefinedCorner>>,
    pub(super) blurs: Vec<f64>,
    pub(super) stds: Vec<f64>,
    pub(super) refiner: Refiner,
    /// Where the last board lies in `part`, if the whole of it was seen.
    pub(super) whole: Option<BoardPlacement>,
    pub(super) last: LastBoard,
    pub(super) followed: Followed,
    /// Memory for the corners of the next detection.
    pub(super) spare: Vec<DetectedCorner>,
}

/// The result of verifying a grid.
enum GridOutcome {
    Whole(BoardPlacement),
    Part(BoardPlacement),
    Other { cols: u32, rows: u32 },
    Nothing,
}

/// What the search found that was no board: evidence for the reason.
#[derive(Default)]
pub(super) struct SearchEvidence {
    pub(super) candidates: usize,
    pub(super) largest: usize,
    pub(super) size: (u32, u32),
    pub(super) other: Option<(u32, u32)>,
    pub(super) too_large: bool,
    /// Corners of the largest grid that was bridged across occluders.
    bridged: usize,
}

impl Detector {
    /// A detector of `board`.
    pub fn new(board: BoardSize) -> Self {
        Self {
            board,
            pyramid: Pyramid::default(),
            response: Response::default(),
            candidates: CandidateSearch::default(),
            neighborhood: Neighborhood::default(),
            used: Vec::new(),
            growth: Growth::default(),
            grid: Grid::default(),
            part: Grid::default(),
            guesses: Vec::new(),
            refined: Vec::new(),
            blurs: Vec::new(),
            stds: Vec::new(),
            refiner: Refiner::new(),
            whole: None,
            last: LastBoard::default(),
            followed: Followed::default(),
            spare: Vec::new(),
        }
    }

    /// Takes back a detection, whose memory the next one reuses.
    pub fn reuse(&mut self, detection: Detection) {
        self.spare = detection.corners;
    }

    /// The board searched for.
    pub fn board(&self) -> BoardSize {
        self.board
    }

    /// Finds the board in `image`.
    ///
    /// # Errors
    /// [`NoBoard`] says why there is none.
    pub fn find_board(
        &mut self,
        image: GrayView<'_>,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        self.whole = None;
        let longer = self.board.cols.max(self.board.rows) as usize;
        let shorter = self.board.cols.min(self.board.rows) as usize;
        let (width, height) = (image.width(), image.height());
        if width.max(height) < 4 * (longer + 1) || width.min(height) < 4 * (shorter + 1) {
            return Err(NoBoard::ImageTooSmall { width, height, board: self.board });
        }
        let coarsest = coarsest_level(image.size(), longer);
        self.pyramid.build(image, coarsest);
        let mut seen = SearchEvidence::default();
        let mut best: Option<(usize, BoardPlacement)> = None;
        for level in (0..=coarsest).rev() {
            let view = self.pyramid.level(image, level);
            self.response.compute(view, if level == coarsest { 1 } else { ROW_STEP });
            self.candidates.search(view, &self.response, self.board.corner_count());
            seen.candidates = seen.candidates.max(self.candidates.found.len());
            // Larger squares were searched for on the level above.
            let widest = view.width().max(view.height()) as f32 / (shorter - 1) as f32;
            let reach = if level == coarsest { widest } else { widest.min(MOST_STEP) };
            match self.search_level(image, level, reach, &mut best, &mut seen) {
                Some(placement) => return self.report(image, placement, options),
                None if seen.too_large
                    || best.is_some_and(|(count, _)| 3 * count > self.board.corner_count()) =>
                {
                    break;
                }
                None => {}
            }
        }
        match best {
            Some((_, placement)) if options.allow_partial => self.report(image, placement, options),
            Some((seen, _)) => Err(self.part_reason(image, seen)),
            None => Err(self.reason(image, coarsest, &seen)),
        }
    }

    /// Grows grids from the candidates of `level`; a whole board is left in `part`, else the best
    /// part so far.
    fn search_level(
        &mut self,
        image: GrayView<'_>,
        level: usize,
        reach: f32,
        best: &mut Option<(usize, BoardPlacement)>,
        seen: &mut SearchEvidence,
    ) -> Option<BoardPlacement> {
        let view = self.pyramid.level(image, level);
        self.neighborhood.fill(&self.candidates.found, view.width(), view.height());
        self.used.clear();
        self.used.resize(self.candidates.found.len(), false);
        if best.is_some() {
            self.spend(level, true);
        }
        let (mut grids, mut starts) = (0, 0);
        for first in 0..self.candidates.found.len() {
            if grids == MOST_GRIDS || starts == MOST_STARTS || seen.too_large {
                break;
            }
            let seed = if self.used[first] {
                None
            } else {
                self.neighborhood.seed(&self.candidates.found, first, reach)
            };
            let Some(seed) = seed else { continue };
            starts += 1;
            let worth = self.grow_from(image, level, &seed);
            self.spend(level, false);
            if !worth {
                continue;
            }
            grids += 1;
            match self.judge(image, level, seen) {
                GridOutcome::Whole(placement) => {
                    std::mem::swap(&mut self.grid, &mut self.part);
                    return Some(placement);
                }
                GridOutcome::Part(placement) => {
                    let count = self.grid.members.len();
                    if best.is_none_or(|(most, _)| count > most) {
                        *best = Some((count, placement));
                        std::mem::swap(&mut self.grid, &mut self.part);
                    }
                }
                GridOutcome::Other { cols, rows } => seen.other = seen.other.or(Some((cols, rows))),
                GridOutcome::Nothing => {}
            }
        }
        None
    }

    /// Grows a grid from `seed`; true if it is large enough to verify.
    fn grow_from(&mut self, image: GrayView<'_>, level: usize, seed: &Seed) -> bool {
        let view = self.pyramid.level(image, level);
        let radius = self.board.cols.max(self.board.rows) as i32 + 2;
        self.growth.start(view, &self.candidates.found, seed, radius, &mut self.grid);
        if !self.is_whole() && self.grid.bounds().is_some_and(|bounds| !self.exceeds_board(bounds))
        {
            self.growth.reach(view, &self.candidates.found, &self.neighborhood, &mut self.grid);
        }
        self.grid.members.len() >= LEAST_GROWN
    }

    /// Candidates of `level` that are corners of the grid (even a rejected one), or of the best
    /// part (kept at level 0), start no other grid.
    fn spend(&mut self, level: usize, of_part: bool) {
        let (grid, scale) =
            if of_part { (&self.part, (1 << level) as f32) } else { (&self.grid, 1.0) };
        let (offset, used) = (Vec2::repeat(0.5), &mut self.used);
        for &(i, j) in &grid.members {
            let Some(p) = grid.pixel(i, j) else { continue };
            let p = (p + offset) / scale - offset;
            self.neighborhood
                .visit_near(&self.candidates.found, p, SAME_PX, |index| used[index] = true);
        }
    }

    /// Verifies the grid found on `level`, and tracks it down to the image itself.
    fn judge(
        &mut self,
        image: GrayView<'_>,
        level: usize,
        seen: &mut SearchEvidence,
    ) -> GridOutcome {
        if let Some(bounds) = self.grid.bounds()
            && self.exceeds_board(bounds)
        {
            seen.too_large = true;
            return GridOutcome::Other { cols: larger(bounds), rows: smaller(bounds) };
        }
        let small = self.grid.members.len() < SMALL;
        self.follow(image, level);
        if small && self.grid.members.len() >= self.most_corners() {
            return GridOutcome::Nothing;
        }
        if !verify(image, &mut self.grid) {
            return GridOutcome::Nothing;
        }
        // A grid that was rejected on a coarser level is not bridged again.
        let verified = self.grid.members.len();
        if verified >= seen.bridged + WORTH_BRIDGING {
            seen.bridged = verified;
            if self.bridge(image) && !verify(image, &mut self.grid) {
                return GridOutcome::Nothing;
            }
        }
        let Some(bounds) = self.grid.bounds() else { return GridOutcome::Nothing };
        let count = self.grid.members.len();
        if count > seen.largest {
            seen.largest = count;
            seen.size = (larger(bounds), smaller(bounds));
        }
        match self.placement(image) {
            Some(placement) if self.is_whole() => GridOutcome::Whole(placement),
            Some(placement) if count >= self.least_part() && smaller(bounds) >= LEAST_LINE => {
                GridOutcome::Part(placement)
            }
            Some(_) => GridOutcome::Nothing,
            None => GridOutcome::Other { cols: larger(bounds), rows: smaller(bounds) },
        }
    }

    /// Where the board can lie in the grid, given all its visible ends.
    fn placement(&self, image: GrayView<'_>) -> Option<BoardPlacement> {
        let bounds = self.grid.bounds()?;
        let (possible, sure) = seen_ends(image, &self.grid, bounds);
        place(&self.grid, bounds, possible, self.board)?;
        place(&self.grid, bounds, sure, self.board)
    }

    /// Takes the grid from `level` to the image itself, and searches for missing corners on the
    /// way.
    fn follow(&mut self, image: GrayView<'_>, level: usize) {
        let most = if self.grid.members.len() < SMALL { self.most_corners() } else { usize::MAX };
        for finer in (0..level).rev() {
            self.grid.descend();
            let view = self.pyramid.level(image, finer);
            sharpen_all(
                view,
                &mut self.grid,
                &WINDOWS[..1],
                if finer == 0 { &EXACT } else { &EXACT[..1] },
            );
            if self.is_whole() {
                continue;
            }
            self.grid.forget_attempts();
            let sizes = if finer == 0 { &WINDOWS[..] } else { &WINDOWS[..1] };
            self.growth.grow_to(view, &mut self.grid, sizes, most);
            if self.grid.members.len() >= most {
                return;
            }
        }
        if level == 0 && !self.is_whole() {
            self.grid.forget_attempts();
            self.growth.grow_to(image, &mut self.grid, &WINDOWS, most);
        }
        if level == 0 || !self.is_whole() {
            sharpen_all(image, &mut self.grid, &WINDOWS, &EXACT);
        }
    }

    /// Searches across occluders for the rest of a board of which a good part is found. True if
    /// there is more of it.
    fn bridge(&mut self, image: GrayView<'_>) -> bool {
        let before = self.grid.members.len();
        for _ in 0..2 {
            let Some(bounds) = self.grid.bounds() else { break };
            let count = self.grid.members.len();
            if count < LEAST_PART || self.is_whole() || self.exceeds_board(bounds) {
                break;
            }
            let (longer, shorter) = (
                self.board.cols.max(self.board.rows) as i32,
                self.board.cols.min(self.board.rows) as i32,
            );
            let lying = bounds.width() >= bounds.height();
            let room = |length: i32, has: i32| (length - has).clamp(0, 3);
            let (room_i, room_j) =
                if bounds.width() > shorter || (lying && bounds.height() <= shorter) {
                    (room(longer, bounds.width()), room(shorter, bounds.height()))
                } else {
                    (room(shorter, bounds.width()), room(longer, bounds.height()))
                };
            let wider = Bounds {
                i: (bounds.i.0 - room_i, bounds.i.1 + room_i),
                j: (bounds.j.0 - room_j, bounds.j.1 + room_j),
            };
            self.growth.bridge(image, &mut self.grid, wider);
            if self.grid.members.len() == count {
                break;
            }
        }
        self.grid.members.len() > before
    }

    /// Whether the grid exceeds the target size, allowing one spurious row per side.
    fn most_corners(&self) -> usize {
        (self.board.cols as usize + 2) * (self.board.rows as usize + 2) + 1
    }

    /// Minimum corners of a reported part: a small board that the image border crops gives the same
    /// grid.
    pub(super) fn least_part(&self) -> usize {
        LEAST_PART.max((self.board.corner_count() * 2 / 5).min(2 * LEAST_PART))
    }

    pub(super) fn is_whole(&self) -> bool {
        self.grid.members.len() == self.board.corner_count()
            && self.grid.bounds().is_some_and(|bounds| whole_shape(bounds, self.board))
    }

    /// Whether the grid exceeds the target size, allowing one spurious row per side.
    fn exceeds_board(&self, bounds: Bounds) -> bool {
        let (cols, rows) = (self.board.cols, self.board.rows);
        larger(bounds) > cols.max(rows) + 2 || smaller(bounds) > cols.min(rows) + 2
    }
}

fn whole_shape(bounds: Bounds, board: BoardSize) -> bool {
    let shape = (bounds.width(), bounds.height());
    let (cols, rows) = (board.cols as i32, board.rows as i32);
    shape == (cols, rows) || shape == (rows, cols)
}

fn larger(bounds: Bounds) -> u32 {
    bounds.width().max(bounds.height()) as u32
}

fn smaller(bounds: Bounds) -> u32 {
    bounds.width().min(bounds.height()) as u32
}
