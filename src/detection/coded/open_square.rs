//! A square of which three corners are candidates: the fourth is searched for at the intersection
//! of the edges from its neighbors.

use crate::detection::coded::detector::TargetDetector;
use crate::detection::coded::lattice::{LatticeScene, settle};
use crate::detection::grid::{Node, in_steps};
use crate::detection::search::candidates::Candidate;
use crate::detection::search::seeds::Seed;
use crate::detection::vec2::Vec2;
use crate::imaging::gray::GrayView;

impl TargetDetector {
    /// The square of three candidates, in one of the four quarters around the `first` of them. Its
    /// fourth corner is no candidate, either since it is too blurred, or since a gap separates the
    /// squares that meet there. `None` if no crossing is measured there. The fourth corner becomes
    /// a candidate.
    pub(super) fn close(
        &mut self,
        view: GrayView<'_>,
        first: usize,
        quarter: usize,
        reach: f32,
    ) -> Option<Seed> {
        let Self { candidates, neighborhood, sheets, thresholds, used, open_squares, .. } = self;
        let open = neighborhood.open_seed(&candidates.found, first, quarter, reach)?;
        *open_squares += 1;
        if *open_squares > thresholds.lattice.most_starts {
            return None;
        }
        let [first, a, b] = open.corners.map(|index| candidates.found[index].pixel);
        let interval = 0.5 * (sheets.widths[0] + sheets.widths[1]);
        let steps = [a - first, b - first].map(|side| side / interval);
        let scene = LatticeScene {
            image: view,
            candidates: &candidates.found,
            neighborhood,
            sheets,
            thresholds: &thresholds.lattice,
        };
        let lattice = &thresholds.lattice;
        let is_it = |node: &Node| {
            (node.contrast > 0.0) == open.bright
                && in_steps(node.pixel - open.fourth, [a - first, b - first])
                    .is_some_and(|off| off.amax() <= thresholds.lattice.most_off)
        };
        // The directions of edges are accurate to some degrees, and a window finds a crossing
        // within half its width.
        let spacing_px = 0.5 * thresholds.lattice.most_reach_px;
        let mut places: Vec<(i32, i32)> =
            (-2..=2).flat_map(|y| (-2..=2).map(move |x| (x, y))).collect();
        places.sort_by_key(|(x, y)| x * x + y * y);
        let node = places.into_iter().find_map(|(x, y)| {
            let place = open.fourth + Vec2::new(x as f32, y as f32) * spacing_px;
            settle(scene, place, steps, lattice.least_score, lattice.most_reach_px).filter(is_it)
        })?;
        let ways = steps.map(|step| step.normalize());
        let edges = if open.bright { ways } else { [ways[1], -ways[0]] };
        let fourth = candidates.found.len();
        candidates.found.push(Candidate {
            pixel: node.pixel,
            edges,
            contrast: node.contrast.abs(),
        });
        used.push(false);
        let [first, a, b] = open.corners;
        Some(Seed { corners: [first, a, b, fourth], bright: open.bright })
    }
}
