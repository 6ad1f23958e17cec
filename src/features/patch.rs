//! Luma between pixels, for comparing two images of one place.

use crate::features::scale_space::LONGEST_SIDE;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::{GrayImage, GrayView};

/// An image that can be sampled anywhere. A large one is halved to the size at which features are
/// detected.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchImage {
    gray: GrayImage,
    /// Pixel (x, y) of `gray` is pixel (x, y) · spacing + offset of the image.
    spacing_px: f64,
    offset_px: f64,
}

/// Luma, 0 to 255, and its slopes along x and y, per pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LumaSample {
    /// Luma.
    pub value: f64,
    /// Its slope along x and y.
    pub slope: [f64; 2],
}

impl PatchImage {
    /// Of `image`.
    pub fn of(image: GrayView<'_>) -> Self {
        let rows = (0..image.height()).flat_map(|y| image.row(y).iter().copied());
        let gray = GrayImage::from_pixels(image.width(), image.height(), rows.collect());
        let mut patches = Self { gray: gray.unwrap_or_default(), spacing_px: 1.0, offset_px: 0.0 };
        while patches.gray.width().max(patches.gray.height()) > LONGEST_SIDE {
            patches.gray = mean_of_four(&patches.gray);
            patches.offset_px += 0.5 * patches.spacing_px;
            patches.spacing_px *= 2.0;
        }
        patches
    }

    /// The length of a sampled pixel, in pixels of the image.
    pub fn spacing_px(&self) -> f64 {
        self.spacing_px
    }

    /// Luma at `pixel` by cubic convolution (R. Keys, *Cubic convolution interpolation for digital
    /// image processing*, 1981), exact for parabolas; `None` at the border and outside.
    #[inline]
    pub fn sample(&self, pixel: Pixel) -> Option<LumaSample> {
        let x = (pixel.x - self.offset_px) / self.spacing_px;
        let y = (pixel.y - self.offset_px) / self.spacing_px;
        let (width, height) = (self.gray.width(), self.gray.height());
        let inside = x >= 1.0 && y >= 1.0 && x + 2.0 < width as f64 && y + 2.0 < height as f64;
        if !inside {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (across, across_slope) = cubic(x - column as f64);
        let (down, down_slope) = cubic(y - row as f64);
        let (mut value, mut slope_x, mut slope_y) = (0.0, 0.0, 0.0);
        for k in 0..4 {
            let taps = &self.gray.row(row + k - 1)[column - 1..column + 3];
            let taps: [f64; 4] = std::array::from_fn(|j| f64::from(taps[j]));
            let along = |weights: &[f64; 4]| -> f64 {
                taps[0] * weights[0]
                    + taps[1] * weights[1]
                    + taps[2] * weights[2]
                    + taps[3] * weights[3]
            };
            let (here, slope) = (along(&across), along(&across_slope));
            value += down[k] * here;
            slope_x += down[k] * slope;
            slope_y += down_slope[k] * here;
        }
        let slope = [slope_x / self.spacing_px, slope_y / self.spacing_px];
        Some(LumaSample { value, slope })
    }
}

/// Keys's weights of the four pixels around a position, which is the fraction `t` past the second
/// of them, and their derivatives by `t`.
#[inline(always)]
fn cubic(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    let weights = [
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        -0.5 * t2 + 0.5 * t3,
    ];
    let slopes =
        [-0.5 + 2.0 * t - 1.5 * t2, -5.0 * t + 4.5 * t2, 0.5 + 4.0 * t - 4.5 * t2, -t + 1.5 * t2];
    (weights, slopes)
}

fn mean_of_four(gray: &GrayImage) -> GrayImage {
    let (width, height) = (gray.width() / 2, gray.height() / 2);
    let mut half = GrayImage::filled(width, height, 0);
    for (y, row) in half.pixels_mut().chunks_exact_mut(width.max(1)).enumerate() {
        let (above, below) = (gray.row(2 * y), gray.row(2 * y + 1));
        for (x, value) in row.iter_mut().enumerate() {
            let four = [above[2 * x], above[2 * x + 1], below[2 * x], below[2 * x + 1]];
            *value = ((four.into_iter().map(u16::from).sum::<u16>() + 2) / 4) as u8;
        }
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between pixels, a parabola and its slopes are reproduced up to rounding to eight bits.
    #[test]
    fn parabolas_are_interpolated() {
        let light = |x: f64, y: f64| 20.0 + 2.0 * x + y + 0.05 * x * x - 0.03 * x * y;
        let pixels = (0..40 * 30).map(|k| light(f64::from(k % 40), f64::from(k / 40)) as u8);
        let gray = GrayImage::from_pixels(40, 30, pixels.collect()).unwrap();
        let patches = PatchImage::of(gray.view());
        for (x, y) in [(3.25, 4.5), (20.7, 11.1), (36.5, 26.9)] {
            let sample = patches.sample(Pixel::new(x, y)).unwrap();
            // Rounding down subtracts half a step.
            assert!((sample.value - (light(x, y) - 0.5)).abs() < 0.8, "{sample:?}");
            let slope = [2.0 + 0.1 * x - 0.03 * y, 1.0 - 0.03 * x];
            assert!((sample.slope[0] - slope[0]).abs() < 1.2, "{sample:?} {slope:?}");
            assert!((sample.slope[1] - slope[1]).abs() < 1.2, "{sample:?} {slope:?}");
        }
        assert!(patches.sample(Pixel::new(0.9, 5.0)).is_none());
        assert!(patches.sample(Pixel::new(5.0, 28.1)).is_none());
    }

    /// Halving keeps positions.
    #[test]
    fn large_images_are_halved_in_place() {
        let width = LONGEST_SIDE + 200;
        let pixels = (0..width * 8).map(|k| ((k % width) / 16) as u8);
        let gray = GrayImage::from_pixels(width, 8, pixels.collect()).unwrap();
        let patches = PatchImage::of(gray.view());
        assert_eq!(patches.spacing_px(), 2.0);
        let sample = patches.sample(Pixel::new(1607.5, 3.5)).unwrap();
        assert!((sample.value - 100.0).abs() <= 0.6, "{sample:?}");
    }
}
