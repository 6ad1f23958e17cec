//! From light on sub-pixels to light on pixels: the Gaussian blur of the optics and the integration
//! over the pixel's area, in one filter.

use crate::simulation::rays::SUBPIXELS;

/// A separable filter that blurs and subsamples by [`SUBPIXELS`]. Along one axis it gives one value
/// for each pixel.
#[derive(Debug, Clone)]
pub(super) struct LightFilter {
    weights: Vec<f32>,
    /// The pixels on each side that contribute light.
    pub reach: usize,
}

impl LightFilter {
    /// A Gaussian with σ = `blur_px` pixels, averaged over a pixel.
    pub(super) fn new(blur_px: f64) -> Self {
        let reach = (4.5 * blur_px).ceil() as usize;
        let length = (2 * reach + 1) * SUBPIXELS;
        let middle = 0.5 * (length as f64 - 1.0);
        let gaussian = |distance: f64| {
            if blur_px > 0.0 {
                (-0.5 * (distance / blur_px).powi(2)).exp()
            } else {
                f64::from(u8::from(distance == 0.0))
            }
        };
        let mut weights: Vec<f64> = (0..length)
            .map(|tap| {
                let pixel_subs =
                    (0..SUBPIXELS).map(|sub| sub as f64 - 0.5 * (SUBPIXELS as f64 - 1.0));
                pixel_subs.map(|sub| gaussian((tap as f64 - middle - sub) / SUBPIXELS as f64)).sum()
            })
            .collect();
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= sum);
        Self { weights: weights.into_iter().map(|weight| weight as f32).collect(), reach }
    }

    /// Filters the sub-pixels of a row: `out[i]` is pixel i, whose filter begins at `row[i ·
    /// SUBPIXELS]`.
    pub(super) fn reduce_row(&self, row: &[f32], out: &mut [f32]) {
        out.fill(0.0);
        for (tap, weight) in self.weights.iter().enumerate() {
            for (value, pair) in out.iter_mut().zip(row[tap..].chunks(SUBPIXELS)) {
                *value += weight * pair[0];
            }
        }
    }

    /// Filters columns: `rows` contains one reduced row for each tap; `out` is one row of pixels.
    pub(super) fn reduce_columns<'a>(
        &self,
        rows: impl Iterator<Item = &'a [f32]>,
        out: &mut [f32],
    ) {
        out.fill(0.0);
        for (row, weight) in rows.zip(&self.weights) {
            for (value, light) in out.iter_mut().zip(row) {
                *value += weight * light;
            }
        }
    }

    /// How many sub-pixels contribute to a pixel along one axis.
    pub(super) fn taps(&self) -> usize {
        self.weights.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_light_and_place() {
        for blur_px in [0.0, 0.4, 0.8, 2.5] {
            let filter = LightFilter::new(blur_px);
            assert_eq!(filter.taps(), (2 * filter.reach + 1) * SUBPIXELS);
            let sum: f32 = filter.weights.iter().sum();
            assert!((sum - 1.0).abs() < 1e-6);
            let reversed: Vec<f32> = filter.weights.iter().rev().copied().collect();
            assert!(
                filter.weights.iter().zip(&reversed).all(|(a, b)| (a - b).abs() < 1e-7),
                "symmetric"
            );
        }
        let mut out = [0.0; 2];
        LightFilter::new(0.0).reduce_row(&[1.0, 3.0, 5.0, 3.0, 0.0, 1.0, 0.0, 1.0], &mut out);
        assert_eq!(out, [3.0, 0.5]);
    }
}
