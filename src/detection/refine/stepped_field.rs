//! A quantity that varies smoothly over a board except for steps: the light on a board partly in
//! shadow.
//!
//! A polynomial spreads a step over the whole board, so its slopes are wrong everywhere.
//! Differences between neighbors are wrong only across the step, where they are outliers.

use crate::detection::refine::field::{BoardField, FieldSample, LEAST_PIVOT, basis, dot};
use crate::detection::refine::field_sums::{FieldSums, Solution, TERMS, highest_order, trust};
use crate::geometry::median::{STD_PER_MAD, median_of};

/// There are steps where a smooth field's mean square is this many times that expected from
/// differences between neighbors: chosen, not swept; light with noise alone did not reach it once
/// in the 500 fields of the test.
const STEPPED_MEAN_SQUARES: f64 = 4.0;
/// Rounds of weighted least squares, starting from the median slope (chosen, not swept).
const ROUNDS: usize = 4;

/// Fits of differences; its buffers are reused.
#[derive(Debug, Default)]
pub(super) struct SteppedFit {
    /// Neighbors, as indices of samples.
    pub pairs: Vec<[usize; 2]>,
    buffer: Vec<f64>,
}

impl SteppedFit {
    /// A field of at most `order` whose slope is that of `samples` between steps; `None` where
    /// `smooth`, which was fitted to all of them, describes them as well, or where there are too
    /// few neighbors. Only its slope is meaningful.
    pub fn slopes(
        &mut self,
        samples: &[FieldSample],
        smooth: &BoardField,
        order: usize,
    ) -> Option<BoardField> {
        let off = |sample: &FieldSample| (sample.value - smooth.at(sample.place)).powi(2);
        let mean_square = samples.iter().map(off).sum::<f64>() / samples.len().max(1) as f64;
        let mut field = BoardField::spanning(samples);
        field.solution = self.median_slope(samples, &field)?;
        // The variance of a difference is twice that of a sample.
        let expected = self.typical_square(samples, &field)? / 2.0;
        if mean_square <= STEPPED_MEAN_SQUARES * expected {
            return None;
        }
        let order = highest_order(samples.len(), order);
        for _ in 0..ROUNDS {
            let typical = self.typical_square(samples, &field)?;
            let mut sums = FieldSums::default();
            // Differences do not determine the mean.
            sums.normal[0][0] = 1.0;
            for &pair in &self.pairs {
                let [from, to] = pair.map(|slot| samples[slot]);
                let [a, b] = [from, to].map(|sample| basis(field.scaled(sample.place)));
                let columns = std::array::from_fn(|term| b[term] - a[term]);
                let value = to.value - from.value;
                let off = value - dot(&columns, &field.solution.coefficients);
                let trust = trust(off * off, typical);
                sums.add(&columns, value, trust, trust);
            }
            field.solution = sums.solve(order, self.pairs.len(), LEAST_PIVOT)?.solution;
        }
        Some(field)
    }

    /// The median difference per column and per row.
    fn median_slope(&mut self, samples: &[FieldSample], field: &BoardField) -> Option<Solution> {
        let Self { pairs, buffer } = self;
        let mut slope = Solution { terms: TERMS[1], ..Solution::default() };
        for axis in 0..2 {
            buffer.clear();
            buffer.extend(pairs.iter().filter_map(|pair| {
                let [from, to] = pair.map(|slot| samples[slot]);
                let step = to.place[axis] - from.place[axis];
                (step != 0.0).then(|| (to.value - from.value) / step)
            }));
            slope.coefficients[1 + axis] = median_of(buffer)? / field.scale[axis];
        }
        Some(slope)
    }

    /// The mean square of the differences' residuals from `field`, estimated from the median as if
    /// they were normally distributed.
    fn typical_square(&mut self, samples: &[FieldSample], field: &BoardField) -> Option<f64> {
        let Self { pairs, buffer } = self;
        buffer.clear();
        buffer.extend(pairs.iter().map(|pair| {
            let [from, to] = pair.map(|slot| samples[slot]);
            (to.value - from.value - (field.at(to.place) - field.at(from.place))).abs()
        }));
        Some((STD_PER_MAD * median_of(buffer)?).powi(2).max(f64::MIN_POSITIVE))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const COLS: usize = 9;
    const ROWS: usize = 6;
    const ORDER: usize = 4;
    const SLOPE: [f64; 2] = [0.02, -0.01];

    /// Light that falls off along the rows, and by `shadow` in a corner of the board, with noise
    /// as of white at 200 gray levels.
    fn samples(shadow: f64, seed: u64) -> Vec<FieldSample> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let places = (0..ROWS).flat_map(|row| (0..COLS).map(move |col| [col as f64, row as f64]));
        let light = places.map(|[x, y]| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            let shadow = if x + 0.5 * y > 5.2 { shadow } else { 0.0 };
            let value = SLOPE[0] * x + SLOPE[1] * y + shadow + 0.002 * noise;
            FieldSample { place: [x, y], value, weight: 1.0 }
        });
        light.collect()
    }

    fn neighbors() -> SteppedFit {
        let mut pairs = Vec::new();
        for slot in 0..COLS * ROWS {
            if slot % COLS + 1 < COLS {
                pairs.push([slot, slot + 1]);
            }
            if slot + COLS < COLS * ROWS {
                pairs.push([slot, slot + COLS]);
            }
        }
        SteppedFit { pairs, ..SteppedFit::default() }
    }

    /// The largest error of a slope over the board.
    fn worst(field: &BoardField, samples: &[FieldSample]) -> f64 {
        let off = |sample: &FieldSample| {
            let slope = field.slope(sample.place);
            (slope[0] - SLOPE[0]).abs().max((slope[1] - SLOPE[1]).abs())
        };
        samples.iter().map(off).fold(0.0, f64::max)
    }

    #[test]
    fn a_shadow_leaves_the_slope_of_the_light_as_it_is() {
        for (shadow, seed) in [(-0.5, 1), (-0.05, 2), (0.8, 3)] {
            let samples = samples(shadow, seed);
            let smooth = BoardField::fit(&samples, ORDER);
            assert!(worst(&smooth, &samples) > 0.2 * f64::abs(shadow));
            let slopes = neighbors().slopes(&samples, &smooth, ORDER).unwrap();
            let off = worst(&slopes, &samples);
            assert!(off < 0.004, "{off} at {shadow}");
        }
    }

    #[test]
    fn light_without_a_step_is_taken_as_smooth() {
        for seed in 0..500 {
            let samples = samples(0.0, seed);
            let smooth = BoardField::fit(&samples, ORDER);
            assert!(neighbors().slopes(&samples, &smooth, ORDER).is_none(), "{seed}");
        }
    }

    #[test]
    fn corners_without_neighbors_say_nothing() {
        let samples = samples(-0.5, 1);
        let smooth = BoardField::fit(&samples, ORDER);
        assert!(SteppedFit::default().slopes(&samples, &smooth, ORDER).is_none());
    }
}
