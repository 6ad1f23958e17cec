//! The whole search: from the coarsest level of the image to the finest, until a board is found.

use super::board_detection::{DetectOptions, DetectedCorner, Detection, GridIndex, NoBoard};
use super::candidates::CandidateSearch;
use super::cross::Vec2;
use super::edges::{EdgeCount, count_edges};
use super::ends::seen_ends;
use super::grid::{Bounds, Grid, Node};
use super::growth::{Growth, WINDOWS, in_steps, sharpen};
use super::placement::{Placement, place};
use super::pyramid::{Pyramid, coarsest_level};
use super::refine::{GridCorner, RefinedCorner, Refiner};
use super::response::Response;
use super::seeds::Neighbourhood;
use super::verification::verify;
use crate::geometry::board::BoardSize;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// A part of a board needs this many corners to be told from chance, in at least [`LEAST_LINE`] lines each way.
const LEAST_PART: usize = 12;
const LEAST_LINE: u32 = 3;
/// Grids that are judged on one level.
const MOST_GRIDS: usize = 8;
/// Least correlation with a chessboard corner of one that is reported without refinement.
const STANDING_SCORE: f32 = 0.7;
/// How far such a one may lie from where its neighbours put it, in steps.
const STANDING_OFF: f32 = 0.05;
/// How far a corner of a part may lie from where its neighbours put it, in steps.
const MOST_ASTRAY: f32 = 0.12;
/// Longest side of a square that is looked for on any but the coarsest level, in pixels.
const MOST_STEP: f32 = 36.0;
/// Range of brightness that is no picture at all, in grey levels.
const LEAST_RANGE: u8 = 8;

/// Finds one kind of board in images. Its buffers are kept from image to image.
#[derive(Debug)]
pub struct Detector {
    board: BoardSize,
    pyramid: Pyramid,
    response: Response,
    candidates: CandidateSearch,
    neighbourhood: Neighbourhood,
    used: Vec<bool>,
    growth: Growth,
    grid: Grid,
    part: Grid,
    guesses: Vec<GridCorner>,
    refined: Vec<Option<RefinedCorner>>,
    blurs: Vec<f64>,
    refiner: Refiner,
}

/// What a grid turned out to be.
enum Found {
    Whole(Placement),
    Part(Placement),
    Other { cols: u32, rows: u32 },
    Nothing,
}

/// What the search saw that was no board, for the reason.
#[derive(Default)]
struct Seen {
    candidates: usize,
    largest: usize,
    size: (u32, u32),
    other: Option<(u32, u32)>,
    too_large: bool,
}

impl Detector {
    /// A detector of `board`.
    pub fn new(board: BoardSize) -> Self {
        Self {
            board,
            pyramid: Pyramid::default(),
            response: Response::default(),
            candidates: CandidateSearch::default(),
            neighbourhood: Neighbourhood::default(),
            used: Vec::new(),
            growth: Growth::default(),
            grid: Grid::default(),
            part: Grid::default(),
            guesses: Vec::new(),
            refined: Vec::new(),
            blurs: Vec::new(),
            refiner: Refiner::new(),
        }
    }

    /// The board that is looked for.
    pub fn board(&self) -> BoardSize {
        self.board
    }

    /// Finds the board in `image`.
    ///
    /// # Errors
    /// [`NoBoard`] says why there is none.
    pub fn find_board(&mut self, image: GrayView<'_>, options: &DetectOptions) -> Result<Detection, NoBoard> {
        let longer = self.board.cols.max(self.board.rows) as usize;
        let shorter = self.board.cols.min(self.board.rows) as usize;
        let (width, height) = (image.width(), image.height());
        if width.max(height) < 4 * (longer + 1) || width.min(height) < 4 * (shorter + 1) {
            return Err(NoBoard::ImageTooSmall { width, height, board: self.board });
        }
        let coarsest = coarsest_level(image.size(), longer);
        self.pyramid.build(image, coarsest);
        let mut seen = Seen::default();
        let mut best: Option<(usize, Placement)> = None;
        for level in (0..=coarsest).rev() {
            let view = self.pyramid.level(image, level);
            self.response.compute(view);
            self.candidates.search(view, &self.response);
            seen.candidates = seen.candidates.max(self.candidates.found.len());
            // Larger squares than these were looked for on the level above.
            let widest = view.width().max(view.height()) as f32 / (shorter - 1) as f32;
            let reach = if level == coarsest { widest } else { widest.min(MOST_STEP) };
            match self.search_level(image, level, reach, &mut best, &mut seen) {
                Some(placement) => return self.report(image, placement, options),
                None if seen.too_large || best.is_some_and(|(count, _)| 3 * count > self.board.corner_count()) => break,
                None => {}
            }
        }
        match best {
            Some((_, placement)) if options.allow_partial => self.report(image, placement, options),
            Some((seen, _)) => Err(NoBoard::Incomplete { seen, board: self.board }),
            None => Err(self.reason(image, coarsest, &seen)),
        }
    }

    /// Grows grids from the candidates of `level`; a whole board is left in `part`, else the best part so far.
    fn search_level(
        &mut self,
        image: GrayView<'_>,
        level: usize,
        reach: f32,
        best: &mut Option<(usize, Placement)>,
        seen: &mut Seen,
    ) -> Option<Placement> {
        let view = self.pyramid.level(image, level);
        self.neighbourhood.fill(&self.candidates.found, view.width(), view.height());
        self.used.clear();
        self.used.resize(self.candidates.found.len(), false);
        if best.is_some() {
            self.spend(level, true);
        }
        let mut grids = 0;
        for first in 0..self.candidates.found.len() {
            if grids == MOST_GRIDS || seen.too_large {
                break;
            }
            if self.used[first] || !self.grow_from(image, level, first, reach) {
                continue;
            }
            grids += 1;
            self.spend(level, false);
            match self.judge(image, level, seen) {
                Found::Whole(placement) => {
                    std::mem::swap(&mut self.grid, &mut self.part);
                    return Some(placement);
                }
                Found::Part(placement) => {
                    let count = self.grid.members.len();
                    if best.is_none_or(|(most, _)| count > most) {
                        *best = Some((count, placement));
                        std::mem::swap(&mut self.grid, &mut self.part);
                    }
                }
                Found::Other { cols, rows } => seen.other = seen.other.or(Some((cols, rows))),
                Found::Nothing => {}
            }
        }
        None
    }

    /// Grows a grid from candidate `first`; true if it is one worth judging.
    fn grow_from(&mut self, image: GrayView<'_>, level: usize, first: usize, reach: f32) -> bool {
        let view = self.pyramid.level(image, level);
        let candidates = &self.candidates.found;
        let Some(seed) = self.neighbourhood.seed(candidates, first, reach) else { return false };
        let radius = self.board.cols.max(self.board.rows) as i32 + 2;
        self.growth.start(view, candidates, &seed, radius, &mut self.grid);
        self.grid.members.len() >= 6
    }

    /// The candidates of `level` that are corners of the grid, or of the best part (kept at level 0), seed no other.
    fn spend(&mut self, level: usize, of_part: bool) {
        let (grid, scale) = if of_part { (&self.part, (1 << level) as f32) } else { (&self.grid, 1.0) };
        let offset = Vec2::repeat(0.5);
        for (used, candidate) in self.used.iter_mut().zip(&self.candidates.found) {
            let p = (candidate.pixel + offset) * scale - offset;
            *used = *used || near(grid, p, 6.0 * scale * scale);
        }
    }

    /// Judges the grid found on `level`, and follows it to the image itself.
    fn judge(&mut self, image: GrayView<'_>, level: usize, seen: &mut Seen) -> Found {
        if let Some(bounds) = self.grid.bounds()
            && self.exceeds_board(bounds)
        {
            seen.too_large = true;
            return Found::Other { cols: larger(bounds), rows: smaller(bounds) };
        }
        self.follow(image, level);
        if !verify(image, &mut self.grid) {
            return Found::Nothing;
        }
        let Some(bounds) = self.grid.bounds() else { return Found::Nothing };
        let count = self.grid.members.len();
        if count > seen.largest {
            seen.largest = count;
            seen.size = (larger(bounds), smaller(bounds));
        }
        let (possible, sure) = seen_ends(image, &self.grid, bounds);
        let fits = place(&self.grid, bounds, possible, self.board).is_some();
        match place(&self.grid, bounds, sure, self.board).filter(|_| fits) {
            Some(placement) if self.is_whole() => Found::Whole(placement),
            Some(placement) if count >= self.least_part() && smaller(bounds) >= LEAST_LINE => Found::Part(placement),
            Some(_) => Found::Nothing,
            None => Found::Other { cols: larger(bounds), rows: smaller(bounds) },
        }
    }

    /// Takes the grid from `level` to the image itself, and looks for more of the board on the way if some is missing.
    fn follow(&mut self, image: GrayView<'_>, level: usize) {
        for finer in (0..level).rev() {
            self.grid.descend();
            let view = self.pyramid.level(image, finer);
            sharpen_all(view, &mut self.grid);
            if self.is_whole() {
                continue;
            }
            self.grid.forget_attempts();
            self.growth.grow(view, &mut self.grid, if finer == 0 { &WINDOWS } else { &WINDOWS[..1] });
        }
        if level == 0 && !self.is_whole() {
            self.grid.forget_attempts();
            self.growth.grow(image, &mut self.grid, &WINDOWS);
        }
        sharpen_all(image, &mut self.grid);
        self.bridge(image);
    }

    /// Looks for the rest of a board of which a good part is found, across what covers it.
    fn bridge(&mut self, image: GrayView<'_>) {
        for _ in 0..2 {
            let Some(bounds) = self.grid.bounds() else { return };
            let count = self.grid.members.len();
            if count < LEAST_PART || self.is_whole() || self.exceeds_board(bounds) {
                return;
            }
            let (longer, shorter) =
                (self.board.cols.max(self.board.rows) as i32, self.board.cols.min(self.board.rows) as i32);
            let lying = bounds.width() >= bounds.height();
            let room = |length: i32, has: i32| (length - has).clamp(0, 3);
            let (room_i, room_j) = if bounds.width() > shorter || (lying && bounds.height() <= shorter) {
                (room(longer, bounds.width()), room(shorter, bounds.height()))
            } else {
                (room(shorter, bounds.width()), room(longer, bounds.height()))
            };
            let wider =
                Bounds { i: (bounds.i.0 - room_i, bounds.i.1 + room_i), j: (bounds.j.0 - room_j, bounds.j.1 + room_j) };
            self.growth.bridge(image, &mut self.grid, wider);
            if self.grid.members.len() == count {
                return;
            }
        }
    }

    /// Fewer corners are not believed to be part of the board.
    fn least_part(&self) -> usize {
        LEAST_PART.max((self.board.corner_count() * 3 / 10).min(2 * LEAST_PART))
    }

    fn is_whole(&self) -> bool {
        self.grid.members.len() == self.board.corner_count()
            && self.grid.bounds().is_some_and(|bounds| whole_shape(bounds, self.board))
    }

    /// Whether no board of the size looked for can have so many corners, even if a line on each side is none of its own.
    fn exceeds_board(&self, bounds: Bounds) -> bool {
        let (cols, rows) = (self.board.cols, self.board.rows);
        larger(bounds) > cols.max(rows) + 2 || smaller(bounds) > cols.min(rows) + 2
    }

    /// The corners of `part`, exactly, in the board's order.
    fn report(
        &mut self,
        image: GrayView<'_>,
        placement: Placement,
        options: &DetectOptions,
    ) -> Result<Detection, NoBoard> {
        let part = &self.part;
        let at = |col: i32, row: i32| {
            let (i, j) = placement.in_grid(col, row);
            part.pixel(i, j).map(|p| Pixel::new(f64::from(p.x), f64::from(p.y)))
        };
        self.guesses.clear();
        self.guesses.extend(part.members.iter().filter_map(|&(i, j)| {
            let (col, row) = placement.in_board(i, j);
            let neighbours = [at(col + 1, row), at(col, row + 1), at(col - 1, row), at(col, row - 1)];
            Some(GridCorner { index: GridIndex { col, row }, pixel: at(col, row)?, neighbours })
        }));
        self.guesses.sort_unstable_by_key(|guess| (guess.index.row, guess.index.col));
        self.refiner.refine(image, &self.guesses, &mut self.refined);
        let mut corners = Vec::with_capacity(self.guesses.len());
        self.blurs.clear();
        for (guess, refined) in self.guesses.iter().zip(&self.refined) {
            let GridCorner { index, pixel, .. } = *guess;
            match refined {
                Some(refined) if stays(guess, refined) => {
                    corners.push(DetectedCorner { index, pixel: refined.pixel, std_px: refined.std_px });
                    self.blurs.push(refined.blur_px);
                }
                _ if self.stands(image, placement, guess) => {
                    corners.push(DetectedCorner { index, pixel, std_px: guess_std_px(guess) });
                }
                _ => {}
            }
        }
        if corners.len() < self.board.corner_count() {
            self.drop_astray(placement, &mut corners);
        }
        let partial = corners.len() < self.board.corner_count();
        if partial && (!options.allow_partial || corners.len() < self.least_part()) {
            return Err(NoBoard::Incomplete { seen: corners.len(), board: self.board });
        }
        self.blurs.sort_unstable_by(f64::total_cmp);
        Ok(Detection {
            board: self.board,
            partial,
            position_known: placement.known,
            orientation_ambiguous: self.board.orientation_ambiguous(),
            blur_px: self.blurs.get(self.blurs.len() / 2).copied().unwrap_or(0.0),
            corners,
        })
    }

    /// Drops refined corners that do not lie where their refined neighbours put them: what covers a board may end beside a
    /// corner, and be taken for one of its edges.
    fn drop_astray(&mut self, placement: Placement, corners: &mut Vec<DetectedCorner>) {
        let part = &mut self.part;
        for corner in corners.iter() {
            let (i, j) = placement.in_grid(corner.index.col, corner.index.row);
            if let Some(node) = part.get(i, j) {
                let pixel = Vec2::new(corner.pixel.x as f32, corner.pixel.y as f32);
                part.set(i, j, Node { pixel, ..node });
            }
        }
        corners.retain(|corner| {
            let (i, j) = placement.in_grid(corner.index.col, corner.index.row);
            let off = part.pixel(i, j).zip(part.predict(i, j)).zip(part.steps(i, j));
            let off = off.and_then(|((p, expected), steps)| in_steps(p - expected, steps));
            off.is_none_or(|off| off.x.abs().max(off.y.abs()) < MOST_ASTRAY)
        });
    }

    /// Whether a corner that could not be refined is beyond doubt all the same: seen among all its neighbours, with all
    /// edges to them.
    fn stands(&self, image: GrayView<'_>, placement: Placement, guess: &GridCorner) -> bool {
        let GridIndex { col, row } = guess.index;
        let (cols, rows) = (self.board.cols as i32, self.board.rows as i32);
        let around = [(col + 1, row), (col, row + 1), (col - 1, row), (col, row - 1)];
        let on_board = |&(c, r): &(i32, i32)| (0..cols).contains(&c) && (0..rows).contains(&r);
        let complete = around.iter().zip(&guess.neighbours).all(|(at, seen)| seen.is_some() || !on_board(at));
        let (i, j) = placement.in_grid(col, row);
        let EdgeCount { held, seen } = count_edges(image, &self.part, i, j);
        let off = self
            .part
            .get(i, j)
            .filter(|node| node.score >= STANDING_SCORE)
            .and_then(|node| in_steps(node.pixel - self.part.predict(i, j)?, self.part.steps(i, j)?));
        let in_place = off.is_some_and(|off| off.x.abs().max(off.y.abs()) < STANDING_OFF);
        complete && seen >= 2 && held == seen && in_place
    }

    fn reason(&self, image: GrayView<'_>, coarsest: usize, seen: &Seen) -> NoBoard {
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

/// Standard deviation of a corner that was found but could not be refined, in pixels: a fiftieth of a square, at least 0.3.
fn guess_std_px(guess: &GridCorner) -> f64 {
    let nearest = guess.neighbours.iter().flatten().map(|p| p.distance_px(guess.pixel)).fold(f64::MAX, f64::min);
    (0.02 * nearest).clamp(0.3, 3.0)
}

/// Whether a refined corner is still the one that was guessed: within a quarter of the way to its nearest neighbour.
fn stays(guess: &GridCorner, refined: &RefinedCorner) -> bool {
    let nearest = guess.neighbours.iter().flatten().map(|p| p.distance_px(guess.pixel)).fold(f64::MAX, f64::min);
    refined.pixel.distance_px(guess.pixel) < 0.25 * nearest
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

/// Whether `p` is one of the corners of `grid`, up to the square of a distance.
fn near(grid: &Grid, p: Vec2, most: f32) -> bool {
    grid.members.iter().any(|&(i, j)| grid.pixel(i, j).is_some_and(|q| (q - p).norm_squared() < most))
}

/// Moves each corner to where `image`, a finer level, shows it.
fn sharpen_all(image: GrayView<'_>, grid: &mut Grid) {
    for index in 0..grid.members.len() {
        let (i, j) = grid.members[index];
        if let (Some(node), Some(steps)) = (grid.get(i, j), grid.steps(i, j)) {
            let moved = sharpen(image, &node, steps);
            grid.set(i, j, moved);
        }
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
    let reach = |mut values: Box<dyn Iterator<Item = usize>>| {
        let mut sum = 0;
        values.find(|&v| {
            sum += counts[v];
            sum > share
        })
    };
    let low = reach(Box::new(0..256)).unwrap_or(0);
    let high = reach(Box::new((0..256).rev())).unwrap_or(0);
    high.saturating_sub(low) as u8
}
