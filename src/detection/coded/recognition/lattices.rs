//! The lattices of an image that a board may have, for one kind of board after the other.

use crate::detection::coded::detector::{LatticeSearch, TargetDetector, Unlabeled};
use crate::detection::coded::sheet::Sheets;
use crate::detection::grid::{Grid, LARGEST_RADIUS};
use crate::detection::search::candidates::Candidate;
use crate::detection::search::pyramid::coarsest_level;
use crate::imaging::gray::GrayView;

/// Larger lattices are floors unless they show markers: more than 31 x 31 crossings. Chosen.
const MOST_CROSSINGS: usize = 1000;
/// The most places that are measured for one kind of board on one level: bounds the time. Chosen.
const MOST_PLACES: usize = 1800;
/// The same on all levels together. Chosen.
const MOST_PLACES_OF_KIND: usize = 4500;

/// What one level shows, the same for all kinds of boards.
#[derive(Debug)]
struct LevelCandidates {
    found: Vec<Candidate>,
    order: Vec<(usize, usize)>,
}

/// What the levels of one image show, as far as they were searched.
#[derive(Debug, Default)]
pub(super) struct SeenCandidates {
    levels: Vec<LevelCandidates>,
}

impl TargetDetector {
    /// The first result of `of` for the largest lattice of a level. Lattices of fewer than `least`
    /// crossings are left out, as are floors, except for the first that `shows_markers`.
    pub(super) fn find_map_lattice<T>(
        &mut self,
        image: GrayView<'_>,
        least: usize,
        seen: &mut SeenCandidates,
        shows_markers: impl Fn(GrayView<'_>, &Sheets, &Grid) -> bool,
        mut of: impl FnMut(GrayView<'_>, &Sheets, &Grid) -> Option<T>,
    ) -> Option<T> {
        let coarsest = coarsest_level(image.size(), 1);
        self.pyramid.build(image, coarsest);
        let (mut largest, mut floor) = (Grid::default(), Grid::default());
        let (mut places, mut floor_read) = (0, false);
        for (place, level) in self.levels(image, coarsest).enumerate() {
            let pyramid = std::mem::take(&mut self.pyramid);
            let view = pyramid.level(image, level);
            self.take_candidates(view, place, seen);
            let most_places = MOST_PLACES.min(MOST_PLACES_OF_KIND - places);
            self.largest_lattice(view, most_places, &mut largest, &mut floor);
            places = (places + self.growth.places).min(MOST_PLACES_OF_KIND);
            let mut found = (largest.members.len() >= least)
                .then(|| of(view, &self.sheets, &largest))
                .flatten();
            if found.is_none() && !floor_read && !floor.members.is_empty() {
                floor_read = shows_markers(view, &self.sheets, &floor);
                if floor_read {
                    std::mem::swap(&mut self.grid, &mut floor);
                    self.grow_further(view, usize::MAX);
                    found = of(view, &self.sheets, &self.grid);
                }
            }
            self.pyramid = pyramid;
            if found.is_some() {
                return found;
            }
        }
        None
    }

    /// Collects the candidates of `view`, the level searched as the `place`-th, unless they are
    /// known.
    fn take_candidates(&mut self, view: GrayView<'_>, place: usize, seen: &mut SeenCandidates) {
        let Some(level) = seen.levels.get(place) else {
            self.prepare(view, &mut Unlabeled::default());
            let (found, order) = (self.candidates.found.clone(), self.order.clone());
            seen.levels.push(LevelCandidates { found, order });
            return;
        };
        self.candidates.found.clone_from(&level.found);
        self.order.clone_from(&level.order);
        self.neighborhood.fill(&level.found, view.width(), view.height());
        self.used.clear();
        self.used.resize(level.found.len(), false);
    }

    /// Leaves the largest lattice of up to `MOST_CROSSINGS` in `largest`, and the first lattice
    /// with more in `floor`.
    fn largest_lattice(
        &mut self,
        view: GrayView<'_>,
        most_places: usize,
        largest: &mut Grid,
        floor: &mut Grid,
    ) {
        largest.clear(LARGEST_RADIUS, true);
        floor.clear(LARGEST_RADIUS, true);
        self.growth.places = 0;
        let mut starts = 0;
        for place in 0..self.order.len() {
            let first = self.order[place].1;
            if starts == self.thresholds.lattice.most_starts || self.growth.places > most_places {
                break;
            }
            if self.used[first] || !self.start(view, LatticeSearch::Boards, first, MOST_CROSSINGS) {
                continue;
            }
            self.spend();
            let count = self.grid.members.len();
            if count > MOST_CROSSINGS {
                self.spend_around();
                if floor.members.is_empty() {
                    std::mem::swap(floor, &mut self.grid);
                }
                continue;
            }
            starts += 1;
            if count > largest.members.len() {
                std::mem::swap(largest, &mut self.grid);
            }
        }
    }
}
