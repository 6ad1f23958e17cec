//! Pixel noise, from the residuals of the first fits where the pattern is flat.

use crate::geometry::median::median_of;

/// Noise where the pattern is black and where it is white, over all corners of a board.
#[derive(Debug, Default)]
pub(super) struct PooledNoise {
    /// Variances of single pixels, one for each corner: black, white.
    variances: [Vec<f64>; 2],
}

/// Variance of rounding to whole gray levels.
const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;

impl PooledNoise {
    /// Forgets all corners.
    pub fn clear(&mut self) {
        self.variances.iter_mut().for_each(Vec::clear);
    }

    /// Takes one corner's residuals where the pattern is flat: the sum of squares about their mean,
    /// and their count, black then white, of samples that average `bin` × `bin` pixels.
    pub fn take(&mut self, flat: [(f64, f64); 2], bin: usize) {
        for (variances, (squares, count)) in self.variances.iter_mut().zip(flat) {
            if count > 6.0 {
                variances.push(squares / (count - 2.0) * (bin * bin) as f64);
            }
        }
    }

    /// Standard deviation of single pixels in gray levels, black then white: the median over the
    /// corners. Shot noise grows with the light, and a camera's gamma can reverse that, so either
    /// may be the larger.
    pub fn of_pixels(&mut self) -> [f64; 2] {
        let [black, white] = self.variances.each_mut().map(|variances| median_of(variances));
        [black.or(white), white.or(black)]
            .map(|variance| variance.unwrap_or(4.0).max(ROUNDING_VARIANCE).sqrt())
    }
}
