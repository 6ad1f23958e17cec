//! What is printed near a corner besides its own two edges, and how to take it off the pixels that
//! the corner is fitted to.
//!
//! A marker's edges run as near to a corner as an eighth of a square: blur brings them into the
//! window, where they are no noise. But what is printed is known, and where it lies is known from
//! the neighboring corners, to a fraction of the blur. So the print is rendered twice, as it is and
//! as the corner's two edges alone would have it, each blurred as the board is, and the difference
//! is taken off the image. Near the two edges both agree, so the neighbors' errors do not enter.

use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::samples::Samples;
use crate::detection::refine::window::Window;
use crate::geometry::pixel::Pixel;

/// The print of a board in an image.
pub trait BoardPrint {
    /// Moves the print to where its corners are, in the order in which they are refined.
    fn place(&mut self, corners: &[Option<Pixel>]);

    /// The print near the corner of this number, at a position in the image in pixels, 1 where it is
    /// white and −1 where it is black: as it is, and as the two edges through the corner alone would
    /// have it. `None` where that is not known.
    fn near(&self, corner: usize, pixel: [f64; 2]) -> Option<[f32; 2]>;

    /// How far from a corner its edges are the only ones, as a part of the way to its neighbors.
    fn room(&self) -> f64;
}

/// Edges nearer than this many standard deviations of the blur disturb a corner: its own are fitted
/// up to 2.7 of them away, and others show as far.
const DISTURBS: f64 = 5.0;
/// Standard deviations of the blur beyond which nothing of an edge is rendered.
const KERNEL_REACH: f64 = 3.0;
/// Points per sample and axis at which the print is read: fewer where blur covers the difference.
const POINTS: [usize; 2] = [2, 3];
const COVERED: f64 = 1.2;
/// Largest half width of a rendered patch, in samples: twice that of the window of a second fit.
const MOST_REACH: i64 = 28;

/// Whether other edges at the part `room` of the way along `axes` disturb a corner blurred so.
pub(super) fn disturbs(room: f64, [u, v]: [[f64; 2]; 2], blur_px: f64) -> bool {
    let height = (u[0] * v[1] - u[1] * v[0]).abs() / length(u).max(length(v));
    room * height < DISTURBS * blur_px
}

/// The print around one corner, in the samples of its window.
#[derive(Debug, Default)]
pub(super) struct PrintPatch {
    /// Half width, in samples.
    reach: i64,
    /// From the window's origin to the patch's middle, in samples.
    offset: [f64; 2],
    /// The print as it is and as two edges alone, row by row.
    layers: [Vec<f32>; 2],
    passed: Vec<f32>,
    kernel: Vec<f32>,
}

impl PrintPatch {
    /// Renders the print around `corner` in the samples of `window`, with a Gaussian blur of
    /// `blur_px`. False where nothing but the corner's two edges is printed.
    pub fn render(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur_px: f64,
    ) -> bool {
        let bin = window.bin as f64;
        let half = (bin - 1.0) / 2.0;
        self.offset = window.origin.map(|o| ((o - half).round() + half - o) / bin);
        let reach = [0, 1].map(|k| {
            window.extent[0] * window.axes[0][k].abs() + window.extent[1] * window.axes[1][k].abs()
        });
        self.reach = ((reach[0].max(reach[1]) / bin).ceil() as i64 + 1).min(MOST_REACH);
        self.fill_kernel(blur_px / bin);
        let disturbed = self.read(print, corner, window, blur_px / bin);
        if disturbed {
            self.blur();
        }
        disturbed
    }

    /// Takes off `samples`, which are those of the rendered window, what the corner's two edges do
    /// not explain, in the gray values of `model`.
    pub fn take_off(&self, samples: &mut Samples, model: &CornerModel) {
        let side = 2 * self.reach + 1;
        let amplitude = model.amplitude.abs() as f32;
        let gamma_term = model.gamma_term as f32;
        let gradient = model.gradient.map(|g| g as f32);
        let [dx, dy] = self.offset.map(|o| o as f32);
        samples.change(|x, y, value| {
            let (i, j) =
                ((x - dx).round() as i64 + self.reach, (y - dy).round() as i64 + self.reach);
            if !(0..side).contains(&i) || !(0..side).contains(&j) {
                return value;
            }
            let at = (j * side + i) as usize;
            let (full, alone) = (self.layers[0][at], self.layers[1][at]);
            let light = 1.0 + gradient[0] * x + gradient[1] * y;
            let by_edges = amplitude * alone - gamma_term * alone * alone;
            let as_printed = amplitude * full - gamma_term * full * full;
            value + light * (by_edges - as_printed)
        });
    }

    fn fill_kernel(&mut self, sigma: f64) {
        let radius = (KERNEL_REACH * sigma).ceil().max(1.0) as i64;
        self.kernel.clear();
        let weight = |k: i64| (-0.5 * (k as f64 / sigma.max(0.2)).powi(2)).exp();
        let total: f64 = (-radius..=radius).map(weight).sum();
        self.kernel.extend((-radius..=radius).map(|k| (weight(k) / total) as f32));
    }

    /// Reads the print at all samples and as far around them as blur reaches.
    fn read(&mut self, print: &dyn BoardPrint, corner: usize, window: &Window, sigma: f64) -> bool {
        let around = self.reach + (self.kernel.len() / 2) as i64;
        let points = if sigma > COVERED { POINTS[0] } else { POINTS[1] };
        let bin = window.bin as f64;
        let step = 1.0 / points as f64;
        let share = (step * step) as f32;
        let mut disturbed = false;
        self.layers.iter_mut().for_each(Vec::clear);
        for j in -around..=around {
            for i in -around..=around {
                let mut sums = [0.0_f32; 2];
                for k in 0..points * points {
                    let sub = [k % points, k / points].map(|k| (k as f64 + 0.5) * step - 0.5);
                    let pixel = [
                        window.origin[0] + bin * (i as f64 + self.offset[0] + sub[0]),
                        window.origin[1] + bin * (j as f64 + self.offset[1] + sub[1]),
                    ];
                    if let Some([full, alone]) = print.near(corner, pixel) {
                        disturbed |= full != alone;
                        sums = [sums[0] + full, sums[1] + alone];
                    }
                }
                self.layers[0].push(sums[0] * share);
                self.layers[1].push(sums[1] * share);
            }
        }
        disturbed
    }

    /// Blurs both layers, and leaves what lies within reach.
    fn blur(&mut self) {
        let Self { reach, layers, passed, kernel, .. } = self;
        let inner = 2 * *reach as usize + 1;
        let outer = inner + kernel.len() - 1;
        for layer in layers {
            passed.clear();
            for row in layer.chunks_exact(outer) {
                passed.extend(row.windows(kernel.len()).map(|seen| {
                    seen.iter()
                        .zip(kernel.iter())
                        .map(|(value, weight)| value * weight)
                        .sum::<f32>()
                }));
            }
            layer.clear();
            layer.resize(inner * inner, 0.0);
            for (row, sums) in layer.chunks_exact_mut(inner).enumerate() {
                for (k, weight) in kernel.iter().enumerate() {
                    let from = &passed[(row + k) * inner..][..inner];
                    sums.iter_mut().zip(from).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    }
}
