//! Readings of a whole depth picture to corrected metres: what `DepthCamera::inverse_depth` says pixel by pixel, in single
//! precision and without a branch, so that it runs at the speed of memory.

use crate::geometry::depth_camera::{DepthCamera, DepthReading};
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection};
use crate::geometry::pixel::Pixel;

/// The correction of every pixel, computed once.
#[derive(Debug, Clone)]
pub(super) struct DepthConversion {
    reading: DepthReading,
    correction: Option<PixelCorrections>,
}

#[derive(Debug, Clone)]
struct PixelCorrections {
    quantity: CorrectedQuantity,
    /// How many there are a pixel.
    terms: usize,
    /// Pixel by pixel, each power by power.
    coefficients: Vec<f32>,
    /// The nearest and the farthest depth that the polynomial is not held at.
    seen_m: [f32; 2],
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
                for x in 0..size.width {
                    let at = correction.at(Pixel::new(f64::from(x), f64::from(y)));
                    coefficients.extend(at.terms.iter().take(terms).map(|term| *term as f32));
                }
            }
            PixelCorrections { quantity: correction.quantity, terms, coefficients, seen_m: [near, far] }
        };
        let correction = camera.correction.as_ref().map(of_pixels).filter(|corrections| corrections.terms > 0);
        Self { reading: camera.reading, correction }
    }

    /// The depth of each reading in metres; 0 for `invalid` and for what no surface gives.
    pub(super) fn depths_m(&self, readings: &[u16], invalid: Option<u16>) -> Vec<f32> {
        match self.reading {
            DepthReading::Metric { unit_m } => {
                let unit_m = unit_m as f32;
                self.each(readings, invalid, move |raw| unit_m * raw)
            }
            DepthReading::Disparity { offset, slope } => {
                let (offset, slope) = (offset as f32, slope as f32);
                self.each(readings, invalid, move |raw| 1.0 / (offset + slope * raw))
            }
        }
    }

    fn each(&self, readings: &[u16], invalid: Option<u16>, z: impl Fn(f32) -> f32 + Copy) -> Vec<f32> {
        let Some(correction) = &self.correction else {
            return readings
                .iter()
                .map(|raw| if Some(*raw) == invalid { 0.0 } else { present(z(f32::from(*raw))) })
                .collect();
        };
        match correction.terms {
            1 => correction.depths_m::<1>(readings, invalid, z),
            2 => correction.depths_m::<2>(readings, invalid, z),
            3 => correction.depths_m::<3>(readings, invalid, z),
            _ => correction.depths_m::<4>(readings, invalid, z),
        }
    }
}

impl PixelCorrections {
    fn depths_m<const TERMS: usize>(
        &self,
        readings: &[u16],
        invalid: Option<u16>,
        z: impl Fn(f32) -> f32 + Copy,
    ) -> Vec<f32> {
        let [near, far] = self.seen_m;
        let invalid = invalid.map_or(-1.0, f32::from);
        let polynomial = |terms: &[f32; TERMS], x: f32| terms.iter().rev().fold(0.0, |sum, term| sum * x + term);
        let (pixels, _) = self.coefficients.as_chunks::<TERMS>();
        let each = readings.iter().zip(pixels);
        match self.quantity {
            CorrectedQuantity::Depth => each
                .map(|(raw, terms)| {
                    let raw = f32::from(*raw);
                    let z = z(raw);
                    let corrected = z + polynomial(terms, z.max(near).min(far));
                    if raw != invalid && z > 0.0 && z < f32::INFINITY { present(corrected) } else { 0.0 }
                })
                .collect(),
            CorrectedQuantity::InverseDepth => {
                let (low, high) = (1.0 / far, 1.0 / near);
                each.map(|(raw, terms)| {
                    let raw = f32::from(*raw);
                    let z = z(raw);
                    let inverse = 1.0 / z;
                    let corrected = 1.0 / (inverse + polynomial(terms, inverse.max(low).min(high)));
                    if raw != invalid && z > 0.0 && z < f32::INFINITY { present(corrected) } else { 0.0 }
                })
                .collect()
            }
        }
    }
}

/// 0 for what is no depth.
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
                    correction.coefficients.iter_mut().enumerate().for_each(|(k, c)| *c = 0.02 * (k as f64).sin());
                    let matrix = CameraMatrix { fx: 30.0, fy: 30.0, cx: 15.5, cy: 11.5, skew: 0.0 };
                    let correction = Some(correction);
                    let camera = DepthCamera { image_size: size, lens: Lens::pinhole(matrix), reading, correction };
                    let depths = DepthConversion::new(&camera).depths_m(&ramp, invalid);
                    assert_eq!(depths.len(), ramp.len());
                    for (k, (raw, depth)) in ramp.iter().zip(&depths).enumerate() {
                        let pixel = Pixel::new((k % 32) as f64, (k / 32) as f64);
                        let inverse = camera.inverse_depth(pixel, f64::from(*raw)).filter(|_| Some(*raw) != invalid);
                        let expected = inverse.map_or(0.0, |inverse| 1.0 / inverse);
                        // Beyond a kilometre a single-precision 1/z says nothing.
                        let near = (f64::from(*depth) - expected).abs() <= 2e-5 * expected || expected > 1e3;
                        assert!(near, "{reading:?} {quantity:?} {terms} at {k}, {raw}: {depth}, expected {expected}");
                    }
                }
            }
        }
    }
}
