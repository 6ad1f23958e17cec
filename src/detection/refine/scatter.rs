//! How much more or less corners scatter than the residuals of their fits foretell, over all corners of a board.

/// How far the halves of edges disagree.
#[derive(Debug, Default)]
pub(super) struct Scatter {
    /// Squares, in units of the variance that a fit's residuals foretell.
    ratios: Vec<f64>,
}

/// Fewer edges than this say nothing about a board.
const FEWEST_EDGES: usize = 12;
/// The share of the ratios, the smallest, that are averaged: what covers a board disturbs the others.
const TRUSTED: f64 = 0.9;
/// The mean of that share of the squares of normally distributed numbers: 1 − 2·z·φ(z)/0.9 with z = 1.645.
const TRUSTED_MEAN: f64 = 0.623;
/// What the board's bend and light, themselves found with noise, add to a corner's standard deviation.
const FROM_BOARD: f64 = 1.05;

impl Scatter {
    /// Forgets all edges.
    pub fn clear(&mut self) {
        self.ratios.clear();
    }

    /// Takes one edge's ratio.
    pub fn take(&mut self, ratio: f64) {
        if ratio.is_finite() {
            self.ratios.push(ratio);
        }
    }

    /// The factor on standard deviations that were taken from the residuals.
    pub fn std_factor(&mut self) -> f64 {
        let trusted = (TRUSTED * self.ratios.len() as f64).round() as usize;
        if self.ratios.len() < FEWEST_EDGES {
            return FROM_BOARD;
        }
        self.ratios.sort_unstable_by(f64::total_cmp);
        let mean = self.ratios[..trusted].iter().sum::<f64>() / trusted as f64;
        FROM_BOARD * (mean / TRUSTED_MEAN).sqrt().clamp(0.1, 10.0)
    }
}
