//! Four candidates that close a square of a chessboard: where a grid starts.
//!
//! From a candidate its two edges lead to its neighbours, whose colours are the other way round; if both ways to the
//! fourth corner end at the same candidate, the four are very likely one square.

use super::candidates::Candidate;
use super::cross::Vec2;

/// Side of a bin, in pixels.
const BIN: f32 = 16.0;
/// Nearer than this is the same corner.
const LEAST_STEP: f32 = 3.5;
/// Tangent of how far a neighbour may lie off the edge that leads to it.
const OFF_EDGE: f32 = 0.4;
/// Sine of how far the edges of neighbours may differ in direction.
const EDGE_TURN: f32 = 0.5;

/// Four corners of one square, in the grid's own axes: at (0, 0), (1, 0), (0, 1) and (1, 1).
#[derive(Debug, Clone, Copy)]
pub(super) struct Seed {
    /// Indices of the candidates.
    pub corners: [usize; 4],
    /// Whether the square itself is bright.
    pub bright: bool,
}

/// Candidates sorted into bins, to find the nearest in a direction.
#[derive(Debug, Default)]
pub(super) struct Neighbourhood {
    across: usize,
    down: usize,
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Neighbourhood {
    /// Sorts `candidates` of an image of `width` × `height` pixels.
    pub(super) fn fill(&mut self, candidates: &[Candidate], width: usize, height: usize) {
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

    /// The square that starts at candidate `first`, if its neighbours close one within `reach` pixels a side.
    pub(super) fn seed(&self, candidates: &[Candidate], first: usize, reach: f32) -> Option<Seed> {
        let [f, s] = candidates[first].edges;
        for (along_i, along_j, bright) in [(f, s, true), (s, -f, false), (-f, -s, true), (-s, f, false)] {
            let Some(a) = self.nearest(candidates, first, along_i, reach) else { continue };
            let Some(b) = self.nearest(candidates, first, along_j, reach) else { continue };
            let fourth = self.nearest(candidates, a, edge_along(&candidates[a], along_j), reach);
            if fourth.is_some() && fourth == self.nearest(candidates, b, edge_along(&candidates[b], along_i), reach) {
                return fourth.map(|d| Seed { corners: [first, a, b, d], bright });
            }
        }
        None
    }

    fn nearest(&self, candidates: &[Candidate], from: usize, direction: Vec2, reach: f32) -> Option<usize> {
        let origin = &candidates[from];
        let (bx, by) = self.bin_of(origin.pixel);
        let mut best: Option<(f32, usize)> = None;
        for ring in 0..=(reach / BIN) as usize + 1 {
            if best.is_some_and(|(distance, _)| distance < (ring as f32 - 1.0) * BIN) {
                break;
            }
            self.visit_ring(bx, by, ring, |index| {
                let other = &candidates[index];
                let step = other.pixel - origin.pixel;
                let along = step.dot(&direction);
                let off = (step.x * direction.y - step.y * direction.x).abs();
                if along < LEAST_STEP || along > reach || off > OFF_EDGE * along || !opposite_colours(origin, other) {
                    return;
                }
                // A little off the edge is worth a little more way.
                let distance = along + off;
                if best.is_none_or(|(least, _)| distance < least) {
                    best = Some((distance, index));
                }
            });
        }
        best.map(|(_, index)| index)
    }

    fn visit_ring(&self, bx: usize, by: usize, ring: usize, mut visit: impl FnMut(usize)) {
        let (left, right) = (bx as isize - ring as isize, bx + ring);
        let (top, bottom) = (by as isize - ring as isize, by + ring);
        for y in top.max(0) as usize..=bottom.min(self.down - 1) {
            let whole = y as isize == top || y == bottom;
            let mut bin = |x: usize| {
                let at = y * self.across + x;
                for &member in &self.members[self.starts[at] as usize..self.starts[at + 1] as usize] {
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

/// The edge of `candidate` that leads most nearly along `direction`.
fn edge_along(candidate: &Candidate, direction: Vec2) -> Vec2 {
    let [f, s] = candidate.edges;
    let (along_f, along_s) = (f.dot(&direction), s.dot(&direction));
    if along_f.abs() > along_s.abs() { f * along_f.signum() } else { s * along_s.signum() }
}

/// Neighbours on a board share their edges' directions, with the bright wedges where the other has the dark ones.
fn opposite_colours(p: &Candidate, q: &Candidate) -> bool {
    let turn = |a: Vec2, b: Vec2| (a.x * b.y - a.y * b.x).abs();
    turn(p.edges[0], q.edges[1]) < EDGE_TURN && turn(p.edges[1], q.edges[0]) < EDGE_TURN
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
        let mut neighbourhood = Neighbourhood::default();
        neighbourhood.fill(&candidates, 120, 90);
        for first in 0..candidates.len() {
            let seed = neighbourhood.seed(&candidates, first, 40.0).expect("a square");
            let [p, i, j, both] = seed.corners.map(|k| candidates[k].pixel);
            assert!((i + j - p - both).norm() < 1e-4);
            let (u, v) = (i - p, j - p);
            assert!(u.x * v.y - u.y * v.x > 0.0, "axes turn from +x to +y");
            assert!(u.norm() < 22.0 && v.norm() < 22.0);
        }
    }

    #[test]
    fn equal_colours_close_no_square() {
        let mut candidates = checker(2, 2);
        candidates[3].edges.swap(0, 1);
        let mut neighbourhood = Neighbourhood::default();
        neighbourhood.fill(&candidates, 120, 90);
        assert!((0..4).all(|first| neighbourhood.seed(&candidates, first, 40.0).is_none()));
    }
}
