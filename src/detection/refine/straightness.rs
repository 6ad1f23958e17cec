//! How much more or less corners scatter than predicted, measured by how straight their lines are.
//! Noise that affects a whole corner (JPEG blocks, light that differs between corners) is not in
//! the corner's own residuals, but moves it off its lines.
//!
//! In a line's own frame, t along its chord and n across, a line is n = a + b·t + f(t, y), with its
//! own a and b whatever the perspective, and one polynomial f that all lines share, in t (from its
//! second power on) and in the line's position y: the curvature f″ of lens distortion is smooth
//! over the image.

use crate::detection::refine::corner_model::length;
use crate::detection::refine::field::basis;
use crate::detection::refine::field_sums::{
    FieldSums, LANES, Solution, TERMS, highest_order, trust,
};
use crate::geometry::pixel::Pixel;

/// Highest order of the curvature polynomial.
const LINE_CURVATURE_ORDER: usize = 4;
/// Pivot threshold relative to the diagonal; rejects near-collinear basis terms, as high powers of
/// t on short lines are.
const LEAST_PIVOT: f64 = 1e-3;
/// Least squares are repeated against outliers.
const ROUNDS: usize = 2;
/// Mean square of standard normal numbers under the robust weights (1 + z²/6)⁻².
const ROBUST_MEAN_SQUARE: f64 = 0.66;
/// Selecting the order costs more degrees of freedom than its own terms: about this part of the
/// terms of the higher orders as well. Chosen, not swept.
const SELECTION_PART: f64 = 0.5;
/// The variance of the mean square of n standard normal numbers, times n: it is 2, and a little
/// more under robust weights.
const MEAN_SQUARE_VARIANCE: f64 = 2.5;
/// Minimum corners of a line: one more than its offset and slope.
const LEAST_LINE_CORNERS: usize = 3;
/// Minimum degrees of freedom. Chosen, not swept.
const LEAST_FREE: f64 = 20.0;
/// Beyond this ratio of the measured to the predicted scatter, the scatter is probably no noise but
/// lens distortion that f cannot follow; the larger the ratio, the more certainly. Chosen, not
/// swept.
const MOST_NOISE_RATIO: f64 = 1.4;

/// A corner in its line's frame: t and y scaled to about −1 … 1, n in pixels.
#[derive(Debug, Clone, Copy)]
struct Point {
    t: f64,
    y: f64,
    n: f64,
    /// One over the predicted variance.
    certainty: f64,
}

/// A corner on a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    pub pixel: Pixel,
    /// Its predicted covariance: xx, xy, yy. Where edges cross at an acute angle, a corner is least
    /// certain along the bisector of that angle, and more certain across each edge.
    pub covariance: [f64; 3],
}

/// The lines of a board; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct Straightness {
    points: Vec<Point>,
    /// For each point, the second integrals of the curvature's terms, and n.
    columns: Vec<[f64; LANES]>,
    /// For each line, before robust weighting.
    trends: Vec<Trend>,
    /// Ends of the lines within `points`.
    ends: Vec<usize>,
    /// Remaining sum of squares and degrees of freedom, over both families of lines.
    left: f64,
    free: f64,
    /// The fractions of their edges' pixels that corners share with the next one along each axis,
    /// summed, and the number of corners.
    shared: [f64; 2],
    windows: f64,
}

impl Straightness {
    /// Forgets all lines.
    pub fn clear(&mut self) {
        (self.left, self.free) = (0.0, 0.0);
        (self.shared, self.windows) = ([0.0; 2], 0.0);
    }

    /// Takes the extent of a corner's window along each axis, as fractions of the distance to the
    /// next corner.
    pub fn note_window(&mut self, extent: [f64; 2]) {
        for (shared, extent) in self.shared.iter_mut().zip(extent) {
            *shared += (1.0 - 0.5 / extent).max(0.0);
        }
        self.windows += 1.0;
    }

    /// Takes the lines along `axis`: for each its position and its corners in order.
    pub fn take<Line>(&mut self, axis: usize, lines: impl Iterator<Item = (f64, Line)>)
    where
        Line: Iterator<Item = Placed> + Clone,
    {
        self.points.clear();
        self.ends.clear();
        lines.for_each(|(place, line)| self.add_line(place, line));
        let scale = self.points.iter().map(|point| point.t.abs()).fold(1.0, f64::max);
        self.points.iter_mut().for_each(|point| point.t /= scale);
        pulp::Arch::new().dispatch(Preparation { lines: self });
        let free: usize = self.lines().map(|line| line.len() - 2).sum();
        let order = highest_order(free, LINE_CURVATURE_ORDER);
        let (mut solution, mut mean_square) = (Solution::default(), f64::INFINITY);
        let mut scatter = None;
        for _ in 0..ROUNDS {
            let summation = LineSummation { lines: self, solution: &solution, mean_square };
            let Some(solved) =
                pulp::Arch::new().dispatch(summation).solve(order, free, LEAST_PIVOT)
            else {
                return;
            };
            mean_square = solved.mean_square.max(f64::MIN_POSITIVE);
            solution = solved.solution;
            scatter = Some(solved.chosen_mean_square);
        }
        if let Some(scatter) = scatter {
            let all = self.points.len() as f64;
            // Offset and slope of each line, and the curvature, use up degrees of freedom.
            let terms =
                solution.terms as f64 + SELECTION_PART * (TERMS[order] - solution.terms) as f64;
            let free = (free as f64 - terms).max(1.0);
            // A smooth line absorbs more of the noise that neighbors share: of n numbers whose
            // neighbors are correlated by ρ, a projection onto the p smoothest functions leaves n −
            // p − 2ρ·(n/π)·sin(πp/n).
            let correlation = self.shared[axis] / self.windows.max(1.0);
            let smooth =
                (std::f64::consts::PI * (1.0 - free / all)).sin() * all / std::f64::consts::PI;
            self.left += scatter * all / ROBUST_MEAN_SQUARE * free
                / (free - 2.0 * correlation * smooth).max(0.1 * free);
            self.free += free;
        }
    }

    /// The factor on standard deviations: close to 1 where chance explains the difference.
    pub fn std_factor(&self) -> f64 {
        if self.free < LEAST_FREE {
            return 1.0;
        }
        let square = self.left / self.free;
        let square = if square < MOST_NOISE_RATIO * MOST_NOISE_RATIO {
            square
        } else {
            (MOST_NOISE_RATIO.powi(4) / square).max(1.0)
        };
        let excess = square - 1.0;
        (1.0 + excess.powi(3) / (excess * excess + MEAN_SQUARE_VARIANCE / self.free)).sqrt()
    }

    fn lines(&self) -> impl Iterator<Item = &[Point]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.points[start..end])
    }

    fn add_line(&mut self, y: f64, line: impl Iterator<Item = Placed> + Clone) {
        let (Some(first), Some(last)) = (line.clone().next(), line.clone().last()) else { return };
        let chord = [last.pixel.x - first.pixel.x, last.pixel.y - first.pixel.y];
        let span = length(chord);
        if line.clone().count() < LEAST_LINE_CORNERS || span < 1.0 {
            return;
        }
        let [x, y_along] = chord.map(|v| v / span);
        self.points.extend(line.map(|corner| {
            let [dx, dy] = [corner.pixel.x - first.pixel.x, corner.pixel.y - first.pixel.y];
            let (t, n) = (x * dx + y_along * dy - span / 2.0, x * dy - y_along * dx);
            let [xx, xy, yy] = corner.covariance;
            let variance = y_along * y_along * xx - 2.0 * x * y_along * xy + x * x * yy;
            Point { t, y, n, certainty: 1.0 / variance.max(f64::MIN_POSITIVE) }
        }));
        self.ends.push(self.points.len());
    }
}

/// Computations common to all rounds. A struct, not a closure: all of it must be inlined to be
/// compiled for the processor.
struct Preparation<'a> {
    lines: &'a mut Straightness,
}

impl pulp::NullaryFnOnce for Preparation<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Straightness { points, columns, trends, ends, .. } = self.lines;
        columns.clear();
        for point in points.iter() {
            columns.push(curvature_columns(point));
        }
        trends.clear();
        let mut start = 0;
        for &end in ends.iter() {
            trends.push(Trend::of(&points[start..end], &columns[start..end], None));
            start = end;
        }
    }
}

struct LineSummation<'a> {
    lines: &'a Straightness,
    solution: &'a Solution,
    mean_square: f64,
}

/// A line's weighted sums of 1, t, t², and of each column and of t times it; the last column is n.
#[derive(Debug)]
struct Trend {
    moments: [f64; 3],
    columns: [[f64; LANES]; 2],
}

impl pulp::NullaryFnOnce for LineSummation<'_> {
    type Output = FieldSums;

    #[inline(always)]
    fn call(self) -> FieldSums {
        let Self { lines, solution, mean_square } = self;
        let mut sums = FieldSums::default();
        let mut start = 0;
        for (&end, trend) in lines.ends.iter().zip(&lines.trends) {
            let (line, columns) = (&lines.points[start..end], &lines.columns[start..end]);
            start = end;
            // First unweighted, then with less weight on outliers.
            if !mean_square.is_finite() {
                for (point, columns) in line.iter().zip(columns) {
                    let (columns, n) = trend.removed(point, columns);
                    sums.add(&columns, n, point.certainty, 1.0);
                }
                continue;
            }
            let trend = Trend::of(line, columns, Some((trend, solution, mean_square)));
            for (point, columns) in line.iter().zip(columns) {
                let (columns, n) = trend.removed(point, columns);
                let off = left(&columns, n, solution);
                let trust = trust(point.certainty * off * off, mean_square);
                sums.add(&columns, n, trust * point.certainty, trust);
            }
        }
        sums
    }
}

/// The second integrals by t of all terms of the curvature, followed by n.
#[inline(always)]
fn curvature_columns(point: &Point) -> [f64; LANES] {
    // By falling power of t within each order: t^p becomes t^(p+2) / ((p+1)(p+2)).
    const OVER: [f64; LANES] = [
        0.5,
        1.0 / 6.0,
        0.5,
        1.0 / 12.0,
        1.0 / 6.0,
        0.5,
        1.0 / 20.0,
        1.0 / 12.0,
        1.0 / 6.0,
        0.5,
        1.0 / 30.0,
        1.0 / 20.0,
        1.0 / 12.0,
        1.0 / 6.0,
        0.5,
        0.0,
    ];
    let squared = point.t * point.t;
    let mut columns = basis([point.t, point.y]);
    for k in 0..LANES {
        columns[k] *= squared * OVER[k];
    }
    columns[LANES - 1] = point.n;
    columns
}

impl Trend {
    #[inline(always)]
    fn of(
        line: &[Point],
        columns: &[[f64; LANES]],
        before: Option<(&Trend, &Solution, f64)>,
    ) -> Self {
        let mut trend = Self { moments: [0.0; 3], columns: [[0.0; LANES]; 2] };
        for (point, columns) in line.iter().zip(columns) {
            let mut weight = point.certainty;
            if let Some((before, solution, mean_square)) = before {
                let (columns, n) = before.removed(point, columns);
                let off = left(&columns, n, solution);
                weight *= trust(weight * off * off, mean_square);
            }
            let tilted = weight * point.t;
            trend.moments[0] += weight;
            trend.moments[1] += tilted;
            trend.moments[2] += tilted * point.t;
            let [sums, tilted_sums] = &mut trend.columns;
            for ((sum, tilted_sum), column) in sums.iter_mut().zip(tilted_sums).zip(columns) {
                *sum += weight * column;
                *tilted_sum += tilted * column;
            }
        }
        // Replaces the sums by the offset and the slope of each column.
        let [w, wt, wtt] = trend.moments;
        let unit = 1.0 / (w * wtt - wt * wt).max(1e-12);
        for k in 0..LANES {
            let [sum, tilted] = [trend.columns[0][k], trend.columns[1][k]];
            trend.columns[0][k] = (wtt * sum - wt * tilted) * unit;
            trend.columns[1][k] = (w * tilted - wt * sum) * unit;
        }
        trend
    }

    /// The columns at a point without the line's offset and slope, and n likewise.
    #[inline(always)]
    fn removed(&self, point: &Point, columns: &[f64; LANES]) -> ([f64; LANES], f64) {
        let [offsets, slopes] = &self.columns;
        let mut rest = *columns;
        for ((rest, offset), slope) in rest.iter_mut().zip(offsets).zip(slopes) {
            *rest -= offset;
            *rest -= slope * point.t;
        }
        let n = std::mem::take(&mut rest[LANES - 1]);
        (rest, n)
    }
}

/// Residual of n after `solution`.
#[inline(always)]
fn left(columns: &[f64; LANES], mut n: f64, solution: &Solution) -> f64 {
    for (column, coefficient) in columns.iter().zip(&solution.coefficients) {
        n -= column * coefficient;
    }
    n
}

#[cfg(test)]
mod tests {
    use super::*;

    const STD_PX: f64 = 0.01;
    const DRAWS: u64 = 16;

    /// Mean over several draws of the noise, windows short of each other.
    fn factor(k1: f64, noise: f64) -> f64 {
        (1..=DRAWS).map(|seed| factor_of(seed, k1, noise, [0.4; 2])).sum::<f64>() / DRAWS as f64
    }

    /// A 9×6 board in perspective, stretched by a lens (`k1` at a radius of 300 px), with noise of
    /// so many standard deviations.
    fn factor_of(seed: u64, k1: f64, noise: f64, extent: [f64; 2]) -> f64 {
        let mut state = seed;
        let mut normal = || {
            let mut sum = -6.0;
            for _ in 0..12 {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
            }
            sum * noise * STD_PX
        };
        let mut corners = Vec::new();
        for (row, col) in
            (0..6).flat_map(|row| (0..9).map(move |col| (f64::from(row), f64::from(col))))
        {
            let w = 1.0 + 0.04 * col - 0.03 * row;
            let (x, y) =
                ((60.0 * col - 10.0 * row - 240.0) / w, (12.0 * col + 55.0 * row - 150.0) / w);
            let stretched = 1.0 + k1 * (x * x + y * y) / 90_000.0;
            let pixel =
                Pixel::new(320.0 + x * stretched + normal(), 240.0 + y * stretched + normal());
            corners.push(Placed { pixel, covariance: [STD_PX * STD_PX, 0.0, STD_PX * STD_PX] });
        }
        let mut straightness = Straightness::default();
        straightness.clear();
        straightness.note_window(extent);
        straightness.take(
            0,
            (0..6)
                .map(|row| (row as f64 / 2.5 - 1.0, corners[9 * row..9 * row + 9].iter().copied())),
        );
        straightness.take(
            1,
            (0..9).map(|col| (col as f64 / 4.0 - 1.0, corners[col..].iter().copied().step_by(9))),
        );
        straightness.std_factor()
    }

    #[test]
    fn corners_that_scatter_as_predicted_keep_their_std() {
        for k1 in [0.0, -0.02, -0.1] {
            assert!((0.9..1.1).contains(&factor(k1, 1.0)), "{k1}: {}", factor(k1, 1.0));
        }
    }

    #[test]
    fn more_scatter_widens_it_and_less_narrows_it() {
        // Chance explains a part of the difference: with an excess e of the mean square and n
        // degrees of freedom the factor is √(1 + e³/(e² + 2.5/n)). Here n is about 63: 2 × 54
        // corners, less two for each of 15 lines, less half of the 15 terms of either polynomial.
        // With 1.3 and 0.5 times the predicted noise this is 1.28 and 0.55.
        assert!((1.1..1.4).contains(&factor(-0.02, 1.3)), "{}", factor(-0.02, 1.3));
        assert!((0.45..0.65).contains(&factor(0.0, 0.5)), "{}", factor(0.0, 0.5));
    }

    #[test]
    fn curvature_beyond_the_polynomials_changes_nothing() {
        assert!((0.95..1.1).contains(&factor(-0.9, 0.1)), "{}", factor(-0.9, 0.1));
    }

    #[test]
    fn noise_that_neighbors_share_is_not_taken_for_little() {
        let mut straightness = Straightness::default();
        straightness.note_window([0.85, 0.5]);
        assert_eq!(straightness.shared[1], 0.0);
        assert!((straightness.shared[0] - 0.41).abs() < 0.01);
        assert!(factor_of(1, 0.0, 1.0, [0.85; 2]) > 1.15 * factor_of(1, 0.0, 1.0, [0.4; 2]));
    }

    #[test]
    fn without_lines_nothing_is_known() {
        let mut straightness = Straightness::default();
        straightness.take(0, std::iter::empty::<(f64, std::vec::IntoIter<Placed>)>());
        assert_eq!(straightness.std_factor(), 1.0);
    }
}
