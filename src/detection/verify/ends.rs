//! Where the board ends: one square beyond its outermost corners the pattern stops.
//!
//! That no corner was found beyond a line is no proof of an end: a hand or the image border may
//! hide it. An end is accepted only if the squares outside the line alternate and what is beyond
//! them does not.

use crate::detection::grid::{Bounds, Grid};
use crate::detection::measure::Probe;
use crate::detection::measure::edges::sample;
use crate::detection::thresholds::chessboard::EndThresholds;
use crate::detection::vec2::Vec2;
use crate::detection::verify::placement::Ends;

/// A side may be an end if the votes for it are more than this many times the pairs against it.
/// Chosen, not swept.
const ENDED_OVER_CONTINUED: u32 = 3;

/// Votes for an end from a pair of squares beyond which a margin is seen; beyond others it is 1.
const MARGIN_VOTES: u32 = 2;

/// The ends of the board that a grid shows.
#[derive(Debug, Clone, Copy)]
pub(in crate::detection) struct SeenEnds {
    /// Sides that may be the board's ends.
    pub possible: Ends,
    /// Sides that certainly are: an occluder along a line may pass for an end at one pair of
    /// squares, hardly at two, and not along half of the line.
    pub sure: Ends,
    /// Sides beyond which squares seem to continue alternating.
    pub goes_on: Ends,
    /// Those of the sure ends along half of which a margin is seen: it is as bright as the bright
    /// squares, or as dark as the dark ones, as few occluders are.
    pub margins: Ends,
}

/// Which sides of `grid` are visible ends of the board.
pub(in crate::detection) fn seen_ends(probe: Probe<'_>, grid: &Grid, bounds: Bounds) -> SeenEnds {
    let columns =
        |i: i32, outward: i32| side(probe, grid, bounds.j, outward, |along| (i, along), (1, 0));
    let rows =
        |j: i32, outward: i32| side(probe, grid, bounds.i, outward, |along| (along, j), (0, 1));
    let sides = [
        columns(bounds.i.0, -1),
        columns(bounds.i.1, 1),
        rows(bounds.j.0, -1),
        rows(bounds.j.1, 1),
    ];
    let thresholds = &probe.thresholds.ends;
    SeenEnds {
        possible: sides.map(|side| side.may_end(thresholds)),
        sure: sides.map(|side| side.must_end(thresholds)),
        goes_on: sides.map(|side| side.continued > side.ending),
        margins: sides.map(|side| side.must_end(thresholds) && 2 * side.margins >= side.pairs),
    }
}

/// Whether the two squares outside the corner `at`, in the direction `outward`, vote for an end:
/// what lies beyond them is uniform. `None` if they are not seen.
pub(in crate::detection) fn ends_at(
    probe: Probe<'_>,
    grid: &Grid,
    at: (i32, i32),
    outward: (i32, i32),
) -> Option<bool> {
    let (i, j) = (outward.1.abs(), outward.0.abs());
    let before = Outside::measure(probe, grid, (at.0 - i, at.1 - j), at, outward)?;
    let after = Outside::measure(probe, grid, at, (at.0 + i, at.1 + j), outward)?;
    Some(before.compare(&after, &probe.thresholds.ends).0 > 0)
}

/// Evidence from the pairs of neighboring squares outside a line of corners.
#[derive(Debug, Clone, Copy, Default)]
struct Side {
    /// Votes that the board ends there.
    ended: u32,
    /// Pairs that vote for an end, pairs that vote against it, and all pairs, visible or not.
    ending: u32,
    continued: u32,
    pairs: u32,
    /// Pairs that end at a margin.
    margins: u32,
}

impl Side {
    fn may_end(&self, thresholds: &EndThresholds) -> bool {
        self.ended > ENDED_OVER_CONTINUED * self.continued && self.ended >= thresholds.least_votes
    }

    fn must_end(&self, thresholds: &EndThresholds) -> bool {
        self.continued == 0 && self.ended >= thresholds.sure_votes && 2 * self.ending >= self.pairs
    }
}

/// Evidence that the board ends beyond the line of corners `at(least..=most)`, in the direction
/// `outward` along `axis`.
fn side(
    probe: Probe<'_>,
    grid: &Grid,
    (least, most): (i32, i32),
    outward: i32,
    at: impl Fn(i32) -> (i32, i32),
    axis: (i32, i32),
) -> Side {
    let outward = (axis.0 * outward, axis.1 * outward);
    let mut previous: Option<Outside> = None;
    let mut side = Side { pairs: (most - least + 1) as u32, ..Side::default() };
    // The squares at the corners of the board count too, hence one more on each side.
    for along in least - 1..=most {
        let outside = Outside::measure(probe, grid, at(along), at(along + 1), outward);
        if let (Some(p), Some(q)) = (previous, outside) {
            let (weight, goes_on) = p.compare(&q, &probe.thresholds.ends);
            side.ended += weight;
            side.ending += u32::from(weight > 0);
            side.margins += u32::from(weight == MARGIN_VOTES);
            side.continued += u32::from(goes_on);
        }
        previous = outside;
    }
    side
}

/// One square outside the line of corners, with a sample beyond it.
#[derive(Debug, Clone, Copy)]
struct Outside {
    within: f32,
    /// `None` where that is outside the image.
    beyond: Option<f32>,
    /// 1 if the square must be bright, −1 if dark.
    sign: f32,
    contrast: f32,
}

impl Outside {
    /// Samples the square outside the corners `p` and `q`, of which at least one must be known.
    fn measure(
        probe: Probe<'_>,
        grid: &Grid,
        p: (i32, i32),
        q: (i32, i32),
        outward: (i32, i32),
    ) -> Option<Self> {
        let known = grid.get(p.0, p.1).or_else(|| grid.get(q.0, q.1))?;
        let place = |at: (i32, i32)| grid.pixel(at.0, at.1).or_else(|| grid.predict(at.0, at.1));
        let (a, b) = (place(p)?, place(q)?);
        let out = |at: (i32, i32), from: Vec2| {
            Some(grid.predict(at.0 + outward.0, at.1 + outward.1)? - from)
        };
        let step = match (out(p, a), out(q, b)) {
            (Some(first), Some(second)) => (first + second) * 0.5,
            (first, second) => first.or(second)?,
        };
        let middle = (a + b) * 0.5;
        // The square beyond the line, by its least corner.
        let square = (p.0.min(p.0 + outward.0), p.1.min(p.1 + outward.1));
        Some(Self {
            within: sample(probe.image, middle + step * probe.thresholds.ends.within)?,
            beyond: sample(probe.image, middle + step * probe.thresholds.ends.beyond),
            sign: grid.polarity(square.0, square.1),
            contrast: known.contrast.abs(),
        })
    }

    /// The votes of this square and the next: for an end, and whether the pattern continues.
    fn compare(&self, next: &Self, thresholds: &EndThresholds) -> (u32, bool) {
        // Signs alternate from square to square, so the difference of neighbors times the sign is
        // the contrast.
        let contrast = 0.5 * (self.contrast + next.contrast);
        if (self.within - next.within) * self.sign <= thresholds.alternate * contrast {
            return (0, false);
        }
        let same =
            |square: &Self, value: f32| (value - square.within).abs() < thresholds.alike * contrast;
        match (self.beyond, next.beyond) {
            (Some(p), Some(q)) => {
                let as_margin = same(self, p) || same(next, q);
                let alike = (p - q).abs() < thresholds.alike * contrast;
                let goes_on = (q - p) * self.sign > thresholds.alternate * contrast;
                let votes = if as_margin { MARGIN_VOTES } else { 1 };
                (if alike { votes } else { 0 }, goes_on)
            }
            (Some(p), None) => (u32::from(same(self, p)), false),
            (None, Some(q)) => (u32::from(same(next, q)), false),
            (None, None) => (0, false),
        }
    }
}
