//! How much more or less corners scatter than the residuals of their fits predict, from all corners
//! of a board.

/// Differences between the offsets of edge halves.
#[derive(Debug, Default)]
pub(super) struct Scatter {
    /// The corner, and the squared difference in units of the variance that its residuals predict.
    ratios: Vec<(usize, f64)>,
}

/// Minimum edges of an estimate.
const FEWEST_EDGES: usize = 12;
/// The fraction of smallest ratios that are averaged: occluders may disturb the others.
const AVERAGED_SHARE: f64 = 0.9;
/// The mean of that fraction of the squares of normally distributed numbers: 1 − 2·z·φ(z)/0.9 with
/// z = 1.645.
const AVERAGED_MEAN_SQUARE: f64 = 0.623;

impl Scatter {
    /// Forgets all edges.
    pub fn clear(&mut self) {
        self.ratios.clear();
    }

    /// Takes the ratio of one edge of the corner of this number.
    pub fn take(&mut self, corner: usize, ratio: f64) {
        if ratio.is_finite() {
            self.ratios.push((corner, ratio));
        }
    }

    /// The factor on standard deviations that follow from the residuals, multiplied by
    /// `of_corners`.
    pub fn std_factor(&mut self, of_corners: &[Option<f64>]) -> f64 {
        for (corner, ratio) in &mut self.ratios {
            let predicted = of_corners.get(*corner).copied().flatten().unwrap_or(1.0);
            *ratio /= predicted * predicted;
        }
        let trusted = (AVERAGED_SHARE * self.ratios.len() as f64).round() as usize;
        if self.ratios.len() < FEWEST_EDGES {
            return 1.0;
        }
        self.ratios.sort_unstable_by(|(_, a), (_, b)| a.total_cmp(b));
        let mean =
            self.ratios[..trusted].iter().map(|(_, ratio)| ratio).sum::<f64>() / trusted as f64;
        (mean / AVERAGED_MEAN_SQUARE).sqrt().clamp(0.1, 10.0)
    }
}
