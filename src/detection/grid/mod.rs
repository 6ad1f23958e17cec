//! Corners by their index in a regular grid, and the prediction of further corners.
//!
//! The grid's axes i and j run from +x to +y like the image's. Square (i, j) lies between the
//! corners (i, j) and (i + 1, j + 1); squares with i + j even are all bright or all dark.

pub(in crate::detection) mod curved_board;
pub(in crate::detection) mod extent;
pub(in crate::detection) mod perspective;

use crate::detection::vec2::Vec2;

/// The greatest distance of a grid's corners from its first one, in indices.
pub(in crate::detection) const LARGEST_RADIUS: i32 = 104;
/// How many searches at one position may fail. Chosen, not swept.
const MOST_ATTEMPTS: u8 = 4;

/// Weights of a corner's predictions relative to those across a square or along three corners of a
/// line: from the corners on both sides of it, and by repeating a single step. Chosen, not swept.
const BETWEEN_WEIGHT: f32 = 2.0;
const LINEAR_WEIGHT: f32 = 0.2;
/// Largest ratio of neighboring steps along a line that is continued in perspective. Chosen, not
/// swept.
const MOST_STEP_RATIO: f32 = 2.0;
/// Least sine of the angle between a corner's two steps, and least area between them, in square
/// pixels: what is measured in units of nearly parallel or tiny steps is unbounded. Chosen, not
/// swept.
const LEAST_STEP_SINE: f32 = 0.1;
const LEAST_STEP_AREA_PX2: f32 = 1.0;

/// Steps along a line from which the step at a position is predicted: the distance, which parallel
/// line, and the start; nearest first.
const STEPS_NEARBY: [(i32, i32, i32); 22] = [
    (0, 0, 0),
    (0, 0, -1),
    (1, 1, 0),
    (1, 1, -1),
    (1, -1, 0),
    (1, -1, -1),
    (1, 0, 1),
    (1, 0, -2),
    (2, 2, 0),
    (2, 2, -1),
    (2, -2, 0),
    (2, -2, -1),
    (2, 1, 1),
    (2, 1, -2),
    (2, -1, 1),
    (2, -1, -2),
    (2, 0, 2),
    (2, 0, -3),
    (3, 2, 1),
    (3, 2, -2),
    (3, -2, 1),
    (3, -2, -2),
];

/// A corner of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detection) struct Node {
    /// Its position, in pixels of the level.
    pub pixel: Vec2,
    /// Bright minus dark around it, in gray levels.
    pub contrast: f32,
    /// The same in its immediate vicinity: the more blur, the smaller.
    pub near_contrast: f32,
    /// Correlation with a chessboard corner, at most 1.
    pub score: f32,
    /// Only its immediate vicinity shows a corner: something occludes part of the rest.
    pub tight: bool,
}

#[derive(Debug, Clone, Copy, Default)]
struct GridSlot {
    node: Option<Node>,
    attempts: u8,
}

/// The smallest rectangle of indices that holds all corners, ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::detection) struct Bounds {
    /// Least and most i.
    pub i: (i32, i32),
    /// Least and most j.
    pub j: (i32, i32),
}

impl Bounds {
    /// How many corners fit along i.
    pub(in crate::detection) fn width(&self) -> i32 {
        self.i.1 - self.i.0 + 1
    }

    /// How many corners fit along j.
    pub(in crate::detection) fn height(&self) -> i32 {
        self.j.1 - self.j.0 + 1
    }

    /// Whether (i, j) lies within.
    pub(in crate::detection) fn contains(&self, i: i32, j: i32) -> bool {
        (self.i.0..=self.i.1).contains(&i) && (self.j.0..=self.j.1).contains(&j)
    }
}

/// Corners by index. Buffers are reused from grid to grid.
#[derive(Debug, Clone, Default)]
pub(in crate::detection) struct Grid {
    radius: i32,
    places: Vec<GridSlot>,
    /// Corners whose positions may have changed.
    touched: Vec<usize>,
    /// Indices of the corners, in the order they were found.
    pub members: Vec<(i32, i32)>,
    /// Corners that a finer level does not confirm.
    pub suspect: Vec<(i32, i32)>,
    /// Whether square (0, 0) is bright.
    pub bright: bool,
}

impl Grid {
    /// Empties the grid; it will hold indices up to `radius` from (0, 0).
    pub(in crate::detection) fn clear(&mut self, radius: i32, bright: bool) {
        for slot in self.touched.drain(..) {
            self.places[slot] = GridSlot::default();
        }
        if self.radius != radius.min(LARGEST_RADIUS) || self.places.is_empty() {
            self.radius = radius.min(LARGEST_RADIUS);
            let side = (2 * self.radius + 1) as usize;
            self.places.clear();
            self.places.resize(side * side, GridSlot::default());
        }
        self.members.clear();
        self.bright = bright;
    }

    #[inline]
    fn slot(&self, i: i32, j: i32) -> Option<usize> {
        // An index below −radius wraps around to a large number.
        let (x, y, side) =
            ((i + self.radius) as u32, (j + self.radius) as u32, (2 * self.radius + 1) as u32);
        (x < side && y < side)
            .then(|| (y * side + x) as usize)
            .filter(|&slot| slot < self.places.len())
    }

    /// Whether the grid has room for (i, j).
    pub(in crate::detection) fn holds(&self, i: i32, j: i32) -> bool {
        self.slot(i, j).is_some()
    }

    /// The corner at (i, j).
    #[inline]
    pub(in crate::detection) fn get(&self, i: i32, j: i32) -> Option<Node> {
        self.slot(i, j).and_then(|slot| self.places[slot].node)
    }

    /// Where the corner (i, j) is.
    #[inline]
    pub(in crate::detection) fn pixel(&self, i: i32, j: i32) -> Option<Vec2> {
        self.slot(i, j).and_then(|slot| self.places[slot].node.as_ref()).map(|node| node.pixel)
    }

    /// The corners on line `j` from `first` to `last`: for each its i, and where it is.
    #[inline]
    pub(in crate::detection) fn pixels_on_line(
        &self,
        j: i32,
        (first, last): (i32, i32),
    ) -> impl Iterator<Item = (i32, Vec2)> {
        let (first, last) = (first.max(-self.radius), last.min(self.radius));
        let length = usize::try_from(last - first + 1).unwrap_or(0);
        let start = self.slot(first, j).filter(|_| length > 0);
        let line = start.and_then(|start| self.places.get(start..start + length));
        let corners = line.unwrap_or_default().iter().zip(first..);
        corners.filter_map(|(slot, i)| Some((i, slot.node.as_ref()?.pixel)))
    }

    /// Sets the corner (i, j).
    pub(in crate::detection) fn set(&mut self, i: i32, j: i32, node: Node) {
        if let Some(slot) = self.slot(i, j)
            && self.places[slot].node.replace(node).is_none()
        {
            self.members.push((i, j));
            self.touched.push(slot);
        }
    }

    /// Removes the corner (i, j).
    pub(in crate::detection) fn remove(&mut self, i: i32, j: i32) {
        if let Some(slot) = self.slot(i, j)
            && self.places[slot].node.take().is_some()
        {
            self.members.retain(|&member| member != (i, j));
        }
    }

    /// Whether to search at (i, j): within the grid, not a corner yet, not searched too often.
    /// Counts the search.
    pub(in crate::detection) fn attempt(&mut self, i: i32, j: i32) -> bool {
        let Some(slot) = self.slot(i, j) else { return false };
        let place = &mut self.places[slot];
        if place.node.is_some() || place.attempts >= MOST_ATTEMPTS {
            return false;
        }
        if place.attempts == 0 {
            self.touched.push(slot);
        }
        place.attempts += 1;
        true
    }

    /// Sets `into` to the mirror image of this grid: i and j exchanged.
    pub(in crate::detection) fn mirror(&self, into: &mut Self) {
        into.clear(self.radius, self.bright);
        for &(i, j) in &self.members {
            if let Some(node) = self.get(i, j) {
                into.set(j, i, node);
            }
        }
    }

    /// Forgets the failed searches: another level may show more.
    pub(in crate::detection) fn forget_attempts(&mut self) {
        for &slot in &self.touched {
            self.places[slot].attempts = 0;
        }
    }

    /// The sign of the contrast at corner (i, j) in a window with its axes along i and j.
    pub(in crate::detection) fn polarity(&self, i: i32, j: i32) -> f32 {
        if ((i + j) & 1 == 0) == self.bright { 1.0 } else { -1.0 }
    }

    /// The rectangle of all corners; `None` if there are none.
    pub(in crate::detection) fn bounds(&self) -> Option<Bounds> {
        let &(i, j) = self.members.first()?;
        let start = Bounds { i: (i, i), j: (j, j) };
        Some(self.members.iter().fold(start, |b, &(i, j)| Bounds {
            i: (b.i.0.min(i), b.i.1.max(i)),
            j: (b.j.0.min(j), b.j.1.max(j)),
        }))
    }

    /// The same rectangle without lines at its sides that hold a single corner.
    pub(in crate::detection) fn anchored_bounds(&self) -> Option<Bounds> {
        self.bounds_of_lines(|corners, _| corners > 1)
    }

    /// The same rectangle without lines at its sides of which less than half is known: these are
    /// corners of something next to the board.
    pub(in crate::detection) fn filled_bounds(&self) -> Option<Bounds> {
        self.bounds_of_lines(|corners, length| 2 * corners >= length)
    }

    /// The same rectangle without lines at its sides that `is_part` rejects, given how many corners
    /// a line has and how many it could have.
    fn bounds_of_lines(&self, is_part: fn(usize, usize) -> bool) -> Option<Bounds> {
        let mut bounds = self.bounds()?;
        let (rows, cols) = (bounds.height() as usize, bounds.width() as usize);
        let trim = |of: fn(&(i32, i32)) -> i32, length: usize, (least, most): (i32, i32)| {
            let is_part = |line: i32| {
                is_part(self.members.iter().filter(|at| of(at) == line).count(), length)
            };
            let (mut least, mut most) = (least, most);
            while least < most && !is_part(least) {
                least += 1;
            }
            while least < most && !is_part(most) {
                most -= 1;
            }
            (least, most)
        };
        bounds.i = trim(|at| at.0, rows, bounds.i);
        bounds.j = trim(|at| at.1, cols, bounds.j);
        Some(bounds)
    }

    /// Whether the four corners of some square at (i, j) are known and unoccluded.
    pub(in crate::detection) fn is_anchored(&self, i: i32, j: i32) -> bool {
        let clear = |i: i32, j: i32| self.get(i, j).is_some_and(|node| !node.tight);
        let squares = [(1, 1), (-1, 1), (-1, -1), (1, -1)];
        clear(i, j)
            && squares
                .into_iter()
                .any(|(di, dj)| clear(i + di, j) && clear(i, j + dj) && clear(i + di, j + dj))
    }

    /// The steps from (i, j) to the next corner along i and along j, from the nearest known
    /// corners.
    pub(in crate::detection) fn steps(&self, i: i32, j: i32) -> Option<[Vec2; 2]> {
        Some([self.step(i, j, 1, 0)?, self.step(i, j, 0, 1)?])
    }

    fn step(&self, i: i32, j: i32, di: i32, dj: i32) -> Option<Vec2> {
        if let (Some(p), Some(q)) = (self.pixel(i - di, j - dj), self.pixel(i + di, j + dj)) {
            return Some((q - p) * 0.5);
        }
        let (mut sum, mut count, mut within) = (Vec2::zeros(), 0.0, 9);
        for (off, side, start) in STEPS_NEARBY {
            if off > within {
                break;
            }
            let (pi, pj) = (i + start * di + side * dj, j + start * dj + side * di);
            if let (Some(p), Some(q)) = (self.pixel(pi, pj), self.pixel(pi + di, pj + dj)) {
                sum += q - p;
                count += 1.0;
                within = off;
            }
        }
        (count > 0.0).then(|| sum / count)
    }

    /// Prediction of the corner (i, j) from its known neighbors: along lines and across squares.
    pub(in crate::detection) fn predict(&self, i: i32, j: i32) -> Option<Vec2> {
        let (mut sum, mut weight) = (Vec2::zeros(), 0.0);
        let mut add = |p: Vec2, w: f32| {
            sum += p * w;
            weight += w;
        };
        for (di, dj) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
            let Some(p1) = self.pixel(i - di, j - dj) else { continue };
            if let Some(next) = self.pixel(i + di, j + dj) {
                add((p1 + next) * 0.5, BETWEEN_WEIGHT);
            }
            for (ei, ej) in [(dj, di), (-dj, -di)] {
                if let (Some(a), Some(b)) =
                    (self.pixel(i - di + ei, j - dj + ej), self.pixel(i + ei, j + ej))
                {
                    add(p1 + (b - a), 1.0);
                }
            }
            let Some(p2) = self.pixel(i - 2 * di, j - 2 * dj) else { continue };
            match self.pixel(i - 3 * di, j - 3 * dj) {
                Some(p3) => add(p1 + projective_step(p1 - p2, p2 - p3), 1.0),
                None => add(p1 * 2.0 - p2, LINEAR_WEIGHT),
            }
        }
        (weight > 0.0).then(|| sum / weight)
    }

    /// Scales the positions to the level below, which is twice as fine.
    pub(in crate::detection) fn descend(&mut self) {
        for place in &mut self.places {
            if let Some(node) = &mut place.node {
                node.pixel = node.pixel * 2.0 + Vec2::repeat(0.5);
            }
        }
    }
}

/// The step that follows `second` (older) and `first` (newer) on a line seen in perspective, where
/// positions are α + β/(n + γ): if r is the ratio of two steps, the next ratio is (1 + r)/(3 − r).
fn projective_step(first: Vec2, second: Vec2) -> Vec2 {
    let ratio = first.norm() / second.norm().max(1e-3);
    let ratio = ratio.clamp(1.0 / MOST_STEP_RATIO, MOST_STEP_RATIO);
    first * ((1.0 + ratio) / (3.0 - ratio))
}

/// `vector` in units of the steps `u` and `v`.
pub(in crate::detection) fn in_steps(vector: Vec2, [u, v]: [Vec2; 2]) -> Option<Vec2> {
    let area = u.x * v.y - u.y * v.x;
    let least = LEAST_STEP_SINE * u.norm() * v.norm();
    (area.abs() > least && area.abs() > LEAST_STEP_AREA_PX2).then(|| {
        Vec2::new(
            (vector.x * v.y - vector.y * v.x) / area,
            (u.x * vector.y - u.y * vector.x) / area,
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(x: f32, y: f32) -> Node {
        Node {
            pixel: Vec2::new(x, y),
            contrast: 100.0,
            near_contrast: 90.0,
            score: 1.0,
            tight: false,
        }
    }

    #[test]
    fn a_slanted_grid_is_continued() {
        let at = |i: i32, j: i32| {
            let (x, y, w) = (
                10.0 * i as f32 + j as f32,
                9.0 * j as f32,
                1.0 + 0.02 * i as f32 + 0.01 * j as f32,
            );
            node(100.0 + x / w, 80.0 + y / w)
        };
        let mut grid = Grid::default();
        grid.clear(8, true);
        for (i, j) in (0..3).flat_map(|j| (0..4).map(move |i| (i, j))) {
            grid.set(i, j, at(i, j));
        }
        for (i, j) in [(4, 1), (1, 3), (-1, 2), (4, 0)] {
            let off = grid.predict(i, j).expect("neighbors") - at(i, j).pixel;
            assert!(off.norm() < 0.4, "({i}, {j}) is off by {off}");
        }
        assert_eq!(grid.predict(7, 7), None);
        assert_eq!(grid.bounds().map(|b| (b.width(), b.height())), Some((4, 3)));
        assert!(grid.polarity(1, 0) < 0.0 && grid.polarity(1, 1) > 0.0);
    }

    #[test]
    fn a_line_has_the_corners_within_its_ends_in_order() {
        let mut grid = Grid::default();
        grid.clear(3, true);
        for i in [-3, 0, 1, 3] {
            grid.set(i, -1, node(i as f32, 2.0));
        }
        let on_line = |j: i32, ends: (i32, i32)| -> Vec<(i32, f32)> {
            grid.pixels_on_line(j, ends).map(|(i, pixel)| (i, pixel.x)).collect()
        };
        assert_eq!(on_line(-1, (-9, 9)), [(-3, -3.0), (0, 0.0), (1, 1.0), (3, 3.0)]);
        assert_eq!(on_line(-1, (-2, 0)), [(0, 0.0)]);
        for (j, ends) in [(0, (-3, 3)), (4, (-3, 3)), (-1, (4, 9)), (-1, (-9, -4))] {
            assert_eq!(on_line(j, ends), []);
        }
    }

    #[test]
    fn a_position_is_searched_a_few_times_only() {
        let mut grid = Grid::default();
        grid.clear(2, false);
        assert_eq!((0..9).filter(|_| grid.attempt(1, 1)).count(), usize::from(MOST_ATTEMPTS));
        assert!(!grid.attempt(3, 0));
        grid.set(0, 0, node(1.0, 1.0));
        assert!(!grid.attempt(0, 0));
        grid.remove(0, 0);
        assert!(grid.members.is_empty() && grid.get(0, 0).is_none());
    }
}
