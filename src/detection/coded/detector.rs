//! The whole search: lattices on each level of the image, until the markers of one are the
//! target's.

use crate::detection::coded::answer::TargetDetection;
use crate::detection::coded::chart::ChartPair;
use crate::detection::coded::compared_crossing::ComparedCrossing;
use crate::detection::coded::floor_limits::FloorLimits;
use crate::detection::coded::labels::{BoardLabel, BoardLabels};
use crate::detection::coded::last_target::LastTarget;
use crate::detection::coded::lattice::{LatticeGrowth, LatticeScene};
use crate::detection::coded::meeting_sides::MeetingSides;
use crate::detection::coded::no_target::NoTarget;
use crate::detection::coded::order::by_reach;
use crate::detection::coded::reading::MarkerReading;
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::{Grid, Node};
use crate::detection::measure::Probe;
use crate::detection::refine::{GridCorner, RefinedCorner, Refiner};
use crate::detection::search::between::BetweenLevels;
use crate::detection::search::candidates::CandidateSearch;
use crate::detection::search::pyramid::{Pyramid, coarsest_level};
use crate::detection::search::response::Response;
use crate::detection::search::seeds::Neighborhood;
use crate::detection::thresholds::Thresholds;
use crate::detection::thresholds::chessboard::SeedThresholds;
use crate::detection::thresholds::markers::LatticeThresholds;
use crate::detection::vec2::Vec2;
use crate::geometry::target::{AprilGrid, Target};
use crate::imaging::gray::GrayView;

/// How often missing corners are searched for: each time farther from those that are known. Chosen,
/// not swept.
const COMPLETIONS: usize = 8;

/// A grid of which less than one tag in this many is read may be an inverted one with a highlight:
/// that makes black brighter than white in a few tags, which are then not inverted. Chosen, not
/// swept.
const FEW_MARKERS_ONE_IN: usize = 4;

/// Finds one target with markers in images. Its buffers are kept from image to image.
#[derive(Debug)]
pub struct TargetDetector {
    pub(super) target: Target,
    pub(super) thresholds: Thresholds,
    pub(super) sheets: Sheets,
    pub(super) pyramid: Pyramid,
    pub(super) between: BetweenLevels,
    response: Response,
    pub(super) candidates: CandidateSearch,
    pub(super) neighborhood: Neighborhood,
    pub(super) used: Vec<bool>,
    /// Squares of three candidates that were measured on this level.
    pub(super) open_squares: usize,
    /// Candidates in the order in which they are started from, and how far their squares reach.
    pub(super) order: Vec<(usize, usize)>,
    pub(super) pairs: Vec<ChartPair>,
    pub(super) growth: LatticeGrowth,
    pub(super) grid: Grid,
    pub(super) spare: Grid,
    pub(super) reading: MarkerReading,
    pub(super) compared: Vec<ComparedCrossing>,
    pub(super) guesses: Vec<GridCorner>,
    pub(super) refined: Vec<Option<RefinedCorner>>,
    pub(super) refiner: Refiner,
    pub(super) meeting: MeetingSides,
    pub(super) last: LastTarget,
    /// Whether inverted grids of tags are searched for where no other is found.
    inverted_too: bool,
}

/// A board that was searched for and found.
pub(super) struct FoundTarget {
    pub detection: TargetDetection,
    pub label: BoardLabel,
    /// On which level of the image its markers were read.
    pub level: usize,
    /// Whether it was found at a scale that the pyramid lacks.
    pub between: bool,
}

/// Which lattices are searched for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LatticeSearch {
    /// Of several squares.
    Boards,
    /// Of as little as one square that fills the image.
    FewSquares,
    /// Of squares so small that their corners show in twice the image only.
    SmallSquares,
}

impl LatticeSearch {
    fn least_crossings(self, limits: &LatticeThresholds) -> usize {
        match self {
            Self::Boards | Self::SmallSquares => limits.least_crossings,
            Self::FewSquares => limits.fewest_crossings,
        }
    }
}

/// What was seen that is no answer.
#[derive(Default)]
pub(super) struct Unlabeled {
    candidates: usize,
    lattice: (usize, u32, u32),
    /// This lattice was not grown to its end: it may have more crossings.
    goes_on: bool,
    elsewhere: usize,
    undecided: usize,
    mirrored: usize,
    /// The border of tags whose border is stated to be another, and how many show that.
    other_border: Option<(u32, usize)>,
    /// Floors whose cells were read.
    floors_read: usize,
}

impl TargetDetector {
    /// A detector of `target`; `None` of a target without markers, for which there is
    /// [`Detector`](crate::detection::detector::Detector).
    pub fn new(target: Target) -> Option<Self> {
        Self::with_thresholds(target, Thresholds::DEFAULT)
    }

    /// The same with other thresholds, to measure what they cost.
    pub fn with_thresholds(target: Target, thresholds: Thresholds) -> Option<Self> {
        let sheets = Sheets::of(&target)?;
        let [wide, narrow] = sheets.widths.map(f64::from);
        Some(Self {
            refiner: Refiner::with_room(
                2.0 * narrow.min(wide) / (wide + narrow),
                thresholds.refinement,
            ),
            sheets,
            target,
            pyramid: Pyramid::default(),
            between: BetweenLevels::default(),
            response: Response::default(),
            candidates: CandidateSearch::default(),
            neighborhood: Neighborhood::new(SeedThresholds {
                off_edge: thresholds.lattice.off_edge,
                ..thresholds.seeds
            }),
            used: Vec::new(),
            open_squares: 0,
            order: Vec::new(),
            pairs: Vec::new(),
            growth: LatticeGrowth::default(),
            grid: Grid::default(),
            spare: Grid::default(),
            reading: MarkerReading::new(thresholds.labels),
            compared: Vec::new(),
            guesses: Vec::new(),
            refined: Vec::new(),
            meeting: MeetingSides::default(),
            last: LastTarget::default(),
            inverted_too: false,
            thresholds,
        })
    }

    /// The target that is searched for.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// Finds the target in `image`.
    ///
    /// # Errors
    /// [`NoTarget`] says why there is none.
    pub fn find(&mut self, image: GrayView<'_>) -> Result<TargetDetection, NoTarget> {
        self.search_all(image, true).map(|found| found.detection)
    }

    /// The target anywhere in `image`; where `in_every_way`, at other scales than the pyramid's
    /// and inverted too. It is left in `grid`.
    pub(super) fn search_all(
        &mut self,
        image: GrayView<'_>,
        in_every_way: bool,
    ) -> Result<FoundTarget, NoTarget> {
        self.inverted_too = in_every_way || self.last.inverted;
        let (width, height) = (image.width(), image.height());
        if width.min(height) < self.thresholds.lattice.least_side_px {
            let target = self.target.to_string();
            return Err(NoTarget::ImageTooSmall { width, height, target });
        }
        let coarsest = coarsest_level(image.size(), 1);
        self.pyramid.build(image, 0);
        self.growth.places = 0;
        let mut seen = Unlabeled::default();
        for level in self.levels(image, coarsest) {
            let search = LatticeSearch::Boards;
            if let Some(found) = self.find_on(image, level, search, &mut seen) {
                return Ok(found);
            }
            if seen.other_border.is_some() {
                return Err(self.reason(&seen));
            }
        }
        // Squares of which an image shows no more than a few are large on any level.
        for level in (coarsest.saturating_sub(1)..=coarsest).rev() {
            let search = LatticeSearch::FewSquares;
            if let Some(found) = self.find_on(image, level, search, &mut seen) {
                return Ok(found);
            }
        }
        in_every_way
            .then(|| self.find_between(image, coarsest, &mut seen))
            .flatten()
            .ok_or_else(|| self.reason(&seen))
    }

    /// The levels in the order in which they are searched: large images at half their size first.
    pub(super) fn levels(
        &self,
        image: GrayView<'_>,
        coarsest: usize,
    ) -> impl Iterator<Item = usize> + use<> {
        let limits = self.thresholds.lattice;
        let (shorter, longer) =
            (image.width().min(image.height()), image.width().max(image.height()));
        let half = usize::from(longer > limits.large_side_px).min(coarsest);
        (0..=coarsest)
            .map(move |level| if level <= half { half - level } else { level })
            .filter(move |&level| shorter >> level >= limits.least_side_px)
    }

    fn find_on(
        &mut self,
        image: GrayView<'_>,
        level: usize,
        search: LatticeSearch,
        seen: &mut Unlabeled,
    ) -> Option<FoundTarget> {
        let label = self.search_level(image, level, search, seen)?;
        let detection = self.finish(image, level, label)?;
        Some(FoundTarget { detection, label, level, between: false })
    }

    fn search_level(
        &mut self,
        image: GrayView<'_>,
        level: usize,
        search: LatticeSearch,
        seen: &mut Unlabeled,
    ) -> Option<BoardLabel> {
        self.pyramid.extend(image, level);
        let pyramid = std::mem::take(&mut self.pyramid);
        let view = pyramid.level(image, level);
        self.prepare(view, seen);
        let label = self.search(view, search, seen);
        self.pyramid = pyramid;
        label
    }

    /// Collects the candidates of `view`.
    pub(super) fn prepare(&mut self, view: GrayView<'_>, seen: &mut Unlabeled) {
        self.response.compute(view, 1);
        let probe = Probe { image: view, thresholds: &self.thresholds };
        self.candidates.search(probe, &self.response, usize::from(u16::MAX));
        let candidates = &self.candidates.found;
        seen.candidates = seen.candidates.max(candidates.len());
        self.neighborhood.fill(candidates, view.width(), view.height());
        self.open_squares = 0;
        self.used.clear();
        self.used.resize(candidates.len(), false);
        by_reach(view, candidates, &mut self.order);
    }

    /// Grows lattices from the candidates of `view`, until one is labeled; it is left in `grid`.
    /// Those of inverted grids of tags come last, so that others are found as if there were none.
    pub(super) fn search(
        &mut self,
        view: GrayView<'_>,
        search: LatticeSearch,
        seen: &mut Unlabeled,
    ) -> Option<BoardLabel> {
        let label = self.search_printed(view, search, false, seen);
        let few = |label: BoardLabel| {
            label.markers * FEW_MARKERS_ONE_IN < self.sheets.ways[label.way].count
        };
        let is_enough = label.map_or(!self.inverted_too, |label| !few(label));
        if !self.sheets.alternates() || is_enough {
            return label;
        }
        let own = label.map(|label| (label, self.grid.clone()));
        let inverted = self.search_printed(view, search, true, seen);
        match own {
            Some((label, grid))
                if inverted.is_none_or(|it| it.significance <= label.significance) =>
            {
                self.grid = grid;
                Some(label)
            }
            _ => inverted,
        }
    }

    /// The same with lattices as of a grid of tags that is `inverted` or not; of other boards,
    /// both.
    fn search_printed(
        &mut self,
        view: GrayView<'_>,
        search: LatticeSearch,
        inverted: bool,
        seen: &mut Unlabeled,
    ) -> Option<BoardLabel> {
        self.growth.inverted = inverted;
        self.open_squares = 0;
        self.used.fill(false);
        let limits = self.thresholds.lattice;
        let floor = FloorLimits::in_search_of(&self.sheets);
        let (mut starts, mut read, mut floor_places) = (0, 0, 0);
        for place in 0..self.order.len() {
            let first = self.order[place].1;
            let is_over = starts == limits.most_starts || read == limits.most_read;
            if is_over || floor_places > floor.most_places {
                break;
            }
            let before = self.growth.places;
            if self.used[first] || !self.start(view, search, first, floor.most_crossings) {
                continue;
            }
            let is_floor = self.grid.members.len() > floor.most_crossings;
            if is_floor {
                floor_places += self.growth.places - before;
                let is_read = seen.floors_read < floor.most_read;
                if is_read {
                    seen.floors_read += 1;
                    self.grow_further(view, floor.most_named);
                }
                self.spend();
                self.spend_around();
                if !is_read {
                    continue;
                }
            } else {
                self.spend();
                starts += 1;
                if self.grid.members.len() < search.least_crossings(&limits) {
                    continue;
                }
                read += 1;
            }
            let count = self.grid.members.len();
            if let Some(bounds) = self.grid.bounds().filter(|_| count > seen.lattice.0) {
                let (a, b) = (bounds.width() as u32, bounds.height() as u32);
                seen.lattice = (count, a.max(b), a.min(b));
                seen.goes_on = is_floor && count > floor.most_named;
            }
            match self.label(view, None) {
                BoardLabels::One(label) => {
                    self.complete(view, label);
                    return Some(label);
                }
                BoardLabels::OtherPrint(label) => {
                    let border = self.sheets.ways[label.way].border_bits;
                    seen.other_border = border.map(|border| (border, label.markers));
                }
                BoardLabels::Elsewhere(markers) => seen.elsewhere = seen.elsewhere.max(markers),
                BoardLabels::Two(first, _) => seen.undecided = seen.undecided.max(first.markers),
                // A floor in mirror image is not the target either.
                BoardLabels::None if is_floor => {}
                BoardLabels::None => {
                    seen.mirrored = seen.mirrored.max(self.mirrored_markers(view));
                }
            }
        }
        None
    }

    /// How many markers of the target `grid` shows in mirror image.
    fn mirrored_markers(&mut self, view: GrayView<'_>) -> usize {
        self.grid.mirror(&mut self.spare);
        std::mem::swap(&mut self.grid, &mut self.spare);
        let labels = self.label(view, None);
        std::mem::swap(&mut self.grid, &mut self.spare);
        match labels {
            BoardLabels::One(label) | BoardLabels::Two(label, _) => label.markers,
            _ => 0,
        }
    }

    /// Grows a lattice from the square at candidate `first` into `grid`, until it has more than
    /// `most_crossings`; false if there is none.
    pub(super) fn start(
        &mut self,
        view: GrayView<'_>,
        search: LatticeSearch,
        first: usize,
        most_crossings: usize,
    ) -> bool {
        let candidates = &self.candidates.found;
        let longer = view.width().max(view.height()) as f32;
        let reach = match search {
            LatticeSearch::Boards => longer / 2.0,
            LatticeSearch::FewSquares => longer,
            LatticeSearch::SmallSquares => self.thresholds.lattice.small_square_px,
        };
        let seed = self.neighborhood.seed(candidates, first, reach).or_else(|| {
            (search == LatticeSearch::FewSquares)
                .then(|| (0..4).find_map(|quarter| self.close(view, first, quarter, reach)))
                .flatten()
        });
        let Some(seed) = seed else { return false };
        let scene = LatticeScene {
            image: view,
            candidates: &self.candidates.found,
            neighborhood: &self.neighborhood,
            sheets: &self.sheets,
            thresholds: &self.thresholds.lattice,
        };
        self.growth.start(scene, &seed, most_crossings, &mut self.grid, &mut self.spare);
        true
    }

    /// The candidates that are crossings of the lattice start no other.
    pub(super) fn spend(&mut self) {
        let used = &mut self.used;
        for &(i, j) in &self.grid.members {
            let Some(p) = self.grid.pixel(i, j) else { continue };
            self.neighborhood.visit_near(
                &self.candidates.found,
                p,
                self.thresholds.lattice.same_px,
                |index| {
                    used[index] = true;
                },
            );
        }
    }

    /// Searches for those corners of the labeled board that growing did not reach, and forgets
    /// what lies beyond it.
    pub(super) fn complete(&mut self, view: GrayView<'_>, label: BoardLabel) {
        let [across, down] = self.sheets.ways[label.way].lines;
        let places: Vec<(i32, i32)> = (0..down)
            .flat_map(|row| (0..across).map(move |col| label.placement.in_grid(col, row)))
            .collect();
        for index in (0..self.grid.members.len()).rev() {
            let (i, j) = self.grid.members[index];
            let (col, row) = label.placement.in_board(i, j);
            if !(0..across).contains(&col) || !(0..down).contains(&row) {
                self.grid.remove(i, j);
            }
        }
        let scene = LatticeScene {
            image: view,
            candidates: &self.candidates.found,
            neighborhood: &self.neighborhood,
            sheets: &self.sheets,
            thresholds: &self.thresholds.lattice,
        };
        self.growth.detect_missing(scene, &mut self.grid, &places, COMPLETIONS);
    }

    /// Forgets the candidates of the level that was searched last: they are not the next one's.
    pub(super) fn forget_candidates(&mut self, view: GrayView<'_>) {
        self.candidates.found.clear();
        self.neighborhood.fill(&[], view.width(), view.height());
    }

    fn reason(&self, seen: &Unlabeled) -> NoTarget {
        let target = self.target.to_string();
        let (count, cols, rows) = seen.lattice;
        if let (Some((seen, markers)), Target::AprilGrid(AprilGrid { border_bits, .. })) =
            (seen.other_border, self.target)
        {
            let stated = border_bits.unwrap_or(seen);
            NoTarget::OtherBorder { markers, seen, stated, target }
        } else if seen.undecided > 0 {
            NoTarget::TwoPlaces { markers: seen.undecided, target }
        } else if seen.mirrored > 0 {
            NoTarget::Mirrored { markers: seen.mirrored, target }
        } else if seen.elsewhere > 0 {
            NoTarget::OtherBoard { markers: seen.elsewhere, target }
        } else if count >= 2 * self.thresholds.lattice.least_crossings {
            NoTarget::NoMarkers { cols, rows, goes_on: seen.goes_on, target }
        } else {
            NoTarget::NoLattice { corners: seen.candidates, target }
        }
    }

    /// To a copy of the image that has `scale` times as many pixels each way.
    pub(super) fn scale_grid(&mut self, scale: f32) {
        for index in 0..self.grid.members.len() {
            let (i, j) = self.grid.members[index];
            if let Some(node) = self.grid.get(i, j) {
                let pixel = node.pixel * scale + Vec2::repeat(0.5 * (scale - 1.0));
                self.grid.set(i, j, Node { pixel, ..node });
            }
        }
    }
}
