//! Seeds of a grid: four candidates that close a square of a chessboard.
//!
//! From a candidate its two edges lead to its neighbors, which have the opposite polarity; if both
//! paths to the fourth corner end at the same candidate, the four are very likely one square.

use crate::detection::search::candidates::Candidate;
use crate::detection::thresholds::chessboard::SeedThresholds;
use crate::detection::vec2::Vec2;

/// Side of a bin, in pixels.
const BIN: f32 = 16.0;

/// Four corners of one square, in the grid's own axes: at (0, 0), (1, 0), (0, 1) and (1, 1).
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct Seed {
    /// Indices of the candidates.
    pub corners: [usize; 4],
    /// Whether the square itself is bright.
    pub bright: bool,
}

/// Three corners of one square, at (0, 0), (1, 0) and (0, 1) of the grid's axes, and the
/// intersection of the edges from the last two.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct OpenSeed {
    /// Indices of the candidates.
    pub corners: [usize; 3],
    /// The fourth corner: the intersection of the edges from the second and the third.
    pub fourth: Vec2,
    /// Whether the square itself is bright.
    pub bright: bool,
}

/// Candidates sorted into bins, to find the nearest in a direction.
#[derive(Debug)]
pub(in crate::detection) struct Neighborhood {
    thresholds: SeedThresholds,
    across: usize,
    down: usize,
    starts: Vec<u32>,
    members: Vec<u32>,
    known: Vec<Option<[Option<usize>; 4]>>,
}

impl Default for Neighborhood {
    fn default() -> Self {
        Self::new(SeedThresholds::DEFAULT)
    }
}

impl Neighborhood {
    /// An empty one with these thresholds for links.
    pub(in crate::detection) fn new(thresholds: SeedThresholds) -> Self {
        Self {
            thresholds,
            across: 0,
            down: 0,
            starts: Vec::new(),
            members: Vec::new(),
            known: Vec::new(),
        }
    }

    /// Sets the thresholds for the next links.
    pub(in crate::detection) fn set_thresholds(&mut self, thresholds: SeedThresholds) {
        self.thresholds = thresholds;
    }

    /// Sorts `candidates` of an image of `width` × `height` pixels.
    pub(in crate::detection) fn fill(
        &mut self,
        candidates: &[Candidate],
        width: usize,
        height: usize,
    ) {
        self.across = width / BIN as usize + 1;
        self.down = height / BIN as usize + 1;
        self.starts.clear();
        self.starts.resize(self.across * self.down + 1, 0);
        for candidate in candidates {
            let (x, y) = self.bin_of(candidate.pixel);
            self.starts[y * self.across + x + 1] += 1;
        }
        for i in 1..self.starts.len() {
            self.starts[i] += self.starts[i - 1];
        }
        self.known.clear();
        self.known.resize(candidates.len(), None);
        self.members.clear();
        self.members.resize(candidates.len(), 0);
        for (index, candidate) in candidates.iter().enumerate().rev() {
            let (x, y) = self.bin_of(candidate.pixel);
            let end = &mut self.starts[y * self.across + x + 1];
            *end -= 1;
            self.members[*end as usize] = index as u32;
        }
        // Each start has moved to its own bin's first member; the first bin starts at 0 as before.
        self.starts.remove(0);
        self.starts.push(candidates.len() as u32);
    }

    fn bin_of(&self, p: Vec2) -> (usize, usize) {
        let at = |v: f32, n: usize| ((v.max(0.0) / BIN) as usize).min(n - 1);
        (at(p.x, self.across), at(p.y, self.down))
    }

    /// The square that starts at candidate `first`, if its neighbors close one with sides of at
    /// most `reach` pixels.
    pub(in crate::detection) fn seed(
        &mut self,
        candidates: &[Candidate],
        first: usize,
        reach: f32,
    ) -> Option<Seed> {
        let links = self.links(candidates, first, reach);
        for quarter in 0..4 {
            let (Some(a), Some(b)) = (links[quarter], links[(quarter + 1) % 4]) else { continue };
            let along_i = direction(&candidates[first], quarter);
            let along_j = direction(&candidates[first], (quarter + 1) % 4);
            let fourth =
                self.links(candidates, a, reach)[nearest_direction(&candidates[a], along_j)];
            let again =
                self.links(candidates, b, reach)[nearest_direction(&candidates[b], along_i)];
            if fourth.is_some() && fourth == again {
                return fourth
                    .map(|d| Seed { corners: [first, a, b, d], bright: quarter % 2 == 0 });
            }
        }
        None
    }

    /// The same where the fourth corner is no candidate, in one of the four quarters around
    /// `first`.
    pub(in crate::detection) fn open_seed(
        &mut self,
        candidates: &[Candidate],
        first: usize,
        quarter: usize,
        reach: f32,
    ) -> Option<OpenSeed> {
        let links = self.links(candidates, first, reach);
        let (a, b) = (links[quarter]?, links[(quarter + 1) % 4]?);
        let along_i = direction(&candidates[first], quarter);
        let along_j = direction(&candidates[first], (quarter + 1) % 4);
        let from_a = direction(&candidates[a], nearest_direction(&candidates[a], along_j));
        let from_b = direction(&candidates[b], nearest_direction(&candidates[b], along_i));
        let between = candidates[b].pixel - candidates[a].pixel;
        let cross = |p: Vec2, q: Vec2| p.x * q.y - p.y * q.x;
        let sine = cross(from_a, from_b);
        let distance = cross(between, from_b) / sine;
        (sine.abs() > self.thresholds.edge_angle && distance > self.thresholds.least_step_px).then(
            || OpenSeed {
                corners: [first, a, b],
                fourth: candidates[a].pixel + from_a * distance,
                bright: quarter.is_multiple_of(2),
            },
        )
    }

    /// The nearest neighbors of `from` along its edges: +first, +second, −first, −second.
    fn links(&mut self, candidates: &[Candidate], from: usize, reach: f32) -> [Option<usize>; 4] {
        if let Some(links) = self.known[from] {
            return links;
        }
        let (origin, thresholds) = (&candidates[from], self.thresholds);
        let (bx, by) = self.bin_of(origin.pixel);
        let (mut best, mut farthest) = ([(reach, None); 4], reach);
        for ring in 0..=(reach / BIN) as usize + 1 {
            if best.iter().all(|&(distance, _)| distance < (ring as f32 - 1.0) * BIN) {
                break;
            }
            self.visit_ring(bx, by, ring, |index| {
                let other = &candidates[index];
                let step = other.pixel - origin.pixel;
                // The sum of the distances along and across an edge is at least the straight
                // distance.
                if step.norm_squared() >= farthest * farthest {
                    return;
                }
                let quarter = nearest_direction(origin, step);
                let way = common_direction(origin, other, quarter);
                let along = step.dot(&way);
                let off = (step.x * way.y - step.y * way.x).abs();
                // A lateral offset counts as extra distance.
                let distance = along + off;
                let nearer = along >= thresholds.least_step_px
                    && off <= thresholds.off_edge * along
                    && distance < best[quarter].0;
                if nearer && opposite_colors(origin, other, thresholds.edge_angle) {
                    best[quarter] = (distance, Some(index));
                    farthest = best.iter().fold(0.0, |most, &(distance, _)| distance.max(most));
                }
            });
        }
        let links = best.map(|(_, index)| index);
        self.known[from] = Some(links);
        links
    }

    /// The candidate nearest to `place` among those that `fits` accepts, within `reach` pixels.
    pub(in crate::detection) fn nearest(
        &self,
        candidates: &[Candidate],
        place: Vec2,
        reach: f32,
        fits: impl Fn(&Candidate) -> bool,
    ) -> Option<usize> {
        let (mut best, mut nearest) = (f32::MAX, None);
        self.visit_near(candidates, place, reach, |index| {
            let away = (candidates[index].pixel - place).norm_squared();
            if away < best && fits(&candidates[index]) {
                (best, nearest) = (away, Some(index));
            }
        });
        nearest
    }

    /// Visits the candidates within `reach` pixels of `place`.
    pub(in crate::detection) fn visit_near(
        &self,
        candidates: &[Candidate],
        place: Vec2,
        reach: f32,
        mut visit: impl FnMut(usize),
    ) {
        let (left, top) = self.bin_of(place - Vec2::repeat(reach));
        let (right, bottom) = self.bin_of(place + Vec2::repeat(reach));
        for y in top..=bottom {
            let (first, last) =
                (self.starts[y * self.across + left], self.starts[y * self.across + right + 1]);
            for &member in &self.members[first as usize..last as usize] {
                if (candidates[member as usize].pixel - place).norm_squared() < reach * reach {
                    visit(member as usize);
                }
            }
        }
    }

    fn visit_ring(&self, bx: usize, by: usize, ring: usize, mut visit: impl FnMut(usize)) {
        let (left, right) = (bx as isize - ring as isize, bx + ring);
        let (top, bottom) = (by as isize - ring as isize, by + ring);
        for y in top.max(0) as usize..=bottom.min(self.down - 1) {
            let whole = y as isize == top || y == bottom;
            let mut bin = |x: usize| {
                let at = y * self.across + x;
                for &member in &self.members[self.starts[at] as usize..self.starts[at + 1] as usize]
                {
                    visit(member as usize);
                }
            };
            if whole {
                (left.max(0) as usize..=right.min(self.across - 1)).for_each(&mut bin);
            } else {
                if left >= 0 {
                    bin(left as usize);
                }
                if right < self.across {
                    bin(right);
                }
            }
        }
    }
}

/// One of the four directions along the edges of `candidate`.
fn direction(candidate: &Candidate, quarter: usize) -> Vec2 {
    let edge = candidate.edges[quarter % 2];
    if quarter < 2 { edge } else { -edge }
}

/// The direction of the edge that two neighbors share: the mean of both corners' estimates. Motion
/// blur rotates the edges of a corner by some degrees, and those of its neighbors, whose colors are
/// exchanged, by as much the other way.
fn common_direction(origin: &Candidate, other: &Candidate, quarter: usize) -> Vec2 {
    let own = direction(origin, quarter);
    let its = other.edges[1 - quarter % 2];
    let sum = if its.dot(&own) < 0.0 { own - its } else { own + its };
    sum / sum.norm()
}

/// Which of the four directions is closest to `step`.
fn nearest_direction(candidate: &Candidate, step: Vec2) -> usize {
    let along = candidate.edges.map(|edge| edge.dot(&step));
    let edge = usize::from(along[1].abs() > along[0].abs());
    if along[edge] > 0.0 { edge } else { edge + 2 }
}

/// Whether two candidates can be neighbors: their edges have the same directions, and one has the
/// bright wedges where the other has the dark ones.
fn opposite_colors(p: &Candidate, q: &Candidate, edge_angle: f32) -> bool {
    let sine = |a: Vec2, b: Vec2| (a.x * b.y - a.y * b.x).abs();
    sine(p.edges[0], q.edges[1]) < edge_angle && sine(p.edges[1], q.edges[0]) < edge_angle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker(cols: i32, rows: i32) -> Vec<Candidate> {
        let (x, y) = (Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0));
        (0..cols * rows)
            .map(|k| (k % cols, k / cols))
            .map(|(i, j)| Candidate {
                pixel: Vec2::new(20.0 + 21.0 * i as f32, 25.0 + 19.0 * j as f32),
                edges: if (i + j) % 2 == 0 { [x, y] } else { [y, -x] },
                contrast: 100.0,
            })
            .collect()
    }

    #[test]
    fn a_square_closes_wherever_it_starts() {
        let candidates = checker(4, 3);
        let mut neighborhood = Neighborhood::default();
        neighborhood.fill(&candidates, 120, 90);
        for first in 0..candidates.len() {
            let seed = neighborhood.seed(&candidates, first, 40.0).expect("a square");
            let [p, i, j, both] = seed.corners.map(|k| candidates[k].pixel);
            assert!((i + j - p - both).norm() < 1e-4);
            let (u, v) = (i - p, j - p);
            assert!(u.x * v.y - u.y * v.x > 0.0, "axes run from +x to +y");
            assert!(u.norm() < 22.0 && v.norm() < 22.0);
        }
    }

    #[test]
    fn the_edges_of_two_corners_meet_in_the_fourth() {
        let mut candidates = checker(2, 2);
        let missing = candidates.pop().expect("four").pixel;
        let mut neighborhood = Neighborhood::default();
        neighborhood.fill(&candidates, 120, 90);
        assert!(neighborhood.seed(&candidates, 0, 40.0).is_none());
        let open: Vec<OpenSeed> = (0..4)
            .filter_map(|quarter| neighborhood.open_seed(&candidates, 0, quarter, 40.0))
            .collect();
        assert_eq!(open.len(), 1);
        assert!((open[0].fourth - missing).norm() < 1e-4, "{:?}", open[0]);
    }

    #[test]
    fn equal_colors_close_no_square() {
        let mut candidates = checker(2, 2);
        candidates[3].edges.swap(0, 1);
        let mut neighborhood = Neighborhood::default();
        neighborhood.fill(&candidates, 120, 90);
        assert!((0..4).all(|first| neighborhood.seed(&candidates, first, 40.0).is_none()));
    }
}
