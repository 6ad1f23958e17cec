//! Readings of a whole depth image to corrected meters: what `DepthCamera::inverse_depth` says
//! pixel by pixel, in single precision and without a branch, so that it runs at the speed of
//! memory.

use crate::geometry::depth_camera::{DepthCamera, DepthReading};
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection};
use crate::geometry::pixel::Pixel;

/// The correction of every pixel, computed once.
#[derive(Debug, Clone)]
pub(super) struct DepthConversion {
    reading: DepthReading,
    width: usize,
    correction: Option<PixelCorrections>,
}

#[derive(Debug, Clone)]
struct PixelCorrections {
    quantity: CorrectedQuantity,
    /// How many there are a pixel.
    terms: usize,
    /// Row by row of the image, then power by power, then pixel by pixel.
    coefficients: Vec<f32>,
    /// The nearest and the farthest depth that the polynomial is not held at.
    seen_m: [f32; 2],
}

/// What a row is worked out in, kept from row to row.
#[derive(Debug, Default)]
pub(super) struct ConversionRow {
    /// What the polynomial is in, as read.
    quantity: Vec<f32>,
    polynomial: Vec<f32>,
}

impl DepthConversion {
    pub(super) fn new(camera: &DepthCamera) -> Self {
        let size = camera.image_size;
        let of_pixels = |correction: &DepthCorrection| {
            let [near, far] = correction.seen_m.map(|m| m as f32);
            // Fitted over no depths, it holds nowhere.
            let terms = if near <= far { correction.terms } else { 0 };
            let mut coefficients = Vec::with_capacity((size.width * size.height) as usize * terms);
            for y in 0..size.height {
                let at = |x: u32| correction.at(Pixel::new(f64::from(x), f64::from(y))).terms;
                let row: Vec<_> = (0..size.width).map(at).collect();
                for power in 0..terms {
                    coefficients.extend(
                        row.iter().map(|terms| terms.get(power).copied().unwrap_or(0.0) as f32),
                    );
                }
            }
            PixelCorrections {
                quantity: correction.quantity,
                terms,
                coefficients,
                seen_m: [near, far],
            }
        };
        let correction =
            camera.correction.as_ref().map(of_pixels).filter(|corrections| corrections.terms > 0);
        Self { reading: camera.reading, width: size.width.max(1) as usize, correction }
    }

    /// The depth of each reading in meters; 0 for `invalid` and for what no surface gives.
    pub(super) fn depths_m(&self, readings: &[u16], invalid: Option<u16>) -> Vec<f32> {
        let mut depths = vec![0.0; readings.len()];
        pulp::Arch::new().dispatch(DepthRows {
            conversion: self,
            readings,
            invalid,
            depths: &mut depths,
        });
        depths
    }

    /// The depth in meters of each reading of row `y`, as [`Self::depths_m`].
    #[inline(always)]
    pub(super) fn convert_row(
        &self,
        y: usize,
        readings: &[u16],
        invalid: Option<u16>,
        row: &mut ConversionRow,
        depths: &mut [f32],
    ) {
        match self.reading {
            DepthReading::Metric { unit_m } => {
                let unit_m = unit_m as f32;
                depths
                    .iter_mut()
                    .zip(readings)
                    .for_each(|(depth, raw)| *depth = unit_m * f32::from(*raw));
            }
            DepthReading::Disparity { offset, slope } => {
                let (offset, slope) = (offset as f32, slope as f32);
                let each = depths.iter_mut().zip(readings);
                each.for_each(|(depth, raw)| *depth = 1.0 / (offset + slope * f32::from(*raw)));
            }
        }
        let invalid = invalid.map_or(-1.0, f32::from);
        for (depth, raw) in depths.iter_mut().zip(readings) {
            *depth = if f32::from(*raw) == invalid { 0.0 } else { present(*depth) };
        }
        if let Some(correction) = &self.correction {
            correction.correct_row(y, row, depths);
        }
    }
}

impl PixelCorrections {
    #[inline(always)]
    fn correct_row(&self, y: usize, row: &mut ConversionRow, depths: &mut [f32]) {
        let (ConversionRow { quantity, polynomial }, width) = (row, depths.len());
        quantity.resize(width, 0.0);
        polynomial.resize(width, 0.0);
        polynomial.fill(0.0);
        let [near, far] = self.seen_m;
        let [low, high] = match self.quantity {
            CorrectedQuantity::Depth => {
                quantity.copy_from_slice(depths);
                [near, far]
            }
            CorrectedQuantity::InverseDepth => {
                quantity
                    .iter_mut()
                    .zip(depths.iter())
                    .for_each(|(inverse, depth)| *inverse = 1.0 / depth);
                [1.0 / far, 1.0 / near]
            }
        };
        let from = y * self.terms * width;
        let terms = self.coefficients.get(from..from + self.terms * width).unwrap_or_default();
        for terms in terms.chunks_exact(width).rev() {
            for ((sum, quantity), term) in polynomial.iter_mut().zip(quantity.iter()).zip(terms) {
                *sum = *sum * quantity.max(low).min(high) + term;
            }
        }
        let each = depths.iter_mut().zip(quantity.iter()).zip(polynomial.iter());
        match self.quantity {
            CorrectedQuantity::Depth => each.for_each(|((depth, quantity), polynomial)| {
                *depth = if *depth > 0.0 { present(quantity + polynomial) } else { 0.0 };
            }),
            CorrectedQuantity::InverseDepth => each.for_each(|((depth, quantity), polynomial)| {
                *depth = if *depth > 0.0 { present(1.0 / (quantity + polynomial)) } else { 0.0 };
            }),
        }
    }
}

/// A whole image. A struct, not a closure: all of it must be inlined to be compiled for the
/// processor.
struct DepthRows<'a> {
    conversion: &'a DepthConversion,
    readings: &'a [u16],
    invalid: Option<u16>,
    depths: &'a mut [f32],
}

impl pulp::NullaryFnOnce for DepthRows<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let mut row = ConversionRow::default();
        let width = self.conversion.width;
        let rows = self.readings.chunks_exact(width).zip(self.depths.chunks_exact_mut(width));
        for (y, (readings, depths)) in rows.enumerate() {
            self.conversion.convert_row(y, readings, self.invalid, &mut row, depths);
        }
    }
}

/// 0 for what is no depth.
#[inline(always)]
fn present(depth_m: f32) -> f32 {
    if depth_m > 0.0 && depth_m < f32::INFINITY { depth_m } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::camera_matrix::CameraMatrix;
    use crate::geometry::depth_correction::SplineGrid;
    use crate::geometry::lens::Lens;
    use crate::geometry::pixel::ImageSize;

    #[test]
    fn every_pixel_is_as_the_camera_says() {
        let size = ImageSize::new(32, 24);
        let metric = DepthReading::Metric { unit_m: 0.001 };
        let disparity = DepthReading::Disparity { offset: 3.1, slope: -0.0028 };
        let ramp: Vec<u16> = (0..32 * 24).map(|k| (k * 11 % 3000) as u16).collect();
        for (reading, invalid) in [(metric, None), (metric, Some(77)), (disparity, Some(1001))] {
            for quantity in [CorrectedQuantity::InverseDepth, CorrectedQuantity::Depth] {
                for terms in 0..=4 {
                    let grid = SplineGrid { size, cols: 3, rows: 2 };
                    let mut correction = DepthCorrection::none(quantity, terms, grid, [0.5, 2.5]);
                    correction
                        .coefficients
                        .iter_mut()
                        .enumerate()
                        .for_each(|(k, c)| *c = 0.02 * (k as f64).sin());
                    let matrix = CameraMatrix { fx: 30.0, fy: 30.0, cx: 15.5, cy: 11.5, skew: 0.0 };
                    let correction = Some(correction);
                    let camera = DepthCamera {
                        image_size: size,
                        lens: Lens::pinhole(matrix),
                        reading,
                        correction,
                    };
                    let depths = DepthConversion::new(&camera).depths_m(&ramp, invalid);
                    assert_eq!(depths.len(), ramp.len());
                    for (k, (raw, depth)) in ramp.iter().zip(&depths).enumerate() {
                        let pixel = Pixel::new((k % 32) as f64, (k / 32) as f64);
                        let inverse = camera
                            .inverse_depth(pixel, f64::from(*raw))
                            .filter(|_| Some(*raw) != invalid);
                        let expected = inverse.map_or(0.0, |inverse| 1.0 / inverse);
                        // Beyond a kilometer a single-precision 1/z says nothing.
                        let near = (f64::from(*depth) - expected).abs() <= 2e-5 * expected
                            || expected > 1e3;
                        assert!(
                            near,
                            "{reading:?} {quantity:?} {terms} at {k}, {raw}: {depth}, expected {expected}"
                        );
                    }
                }
            }
        }
    }
}
