//! Where exactly a corner is: a model of the blurred corner, fitted to its pixels, with an honest standard deviation.
//!
//! | stage | file | what it does |
//! | --- | --- | --- |
//! | window | `samples` | gathers the pixels along the cells' own axes, short of the next edges |
//! | model | `corner_model`, `gaussian` | two crossing edges, each a Gaussian's integral across |
//! | fit | `fit`, `normal_equations`, `cholesky` | weighted least squares, robust against what does not belong |
//! | board | `lattice` | what the neighbours tell: the edges' bend, the change of light |
//!
//! Every corner is fitted twice: in a small window for itself, then in a large one, with the bend of the edges, the change
//! of light and the noise known from all corners of the board.

mod cholesky;
mod corner_model;
mod fit;
mod gaussian;
mod lattice;
mod normal_equations;
mod samples;

use crate::detection::board_detection::GridIndex;
use crate::detection::refine::corner_model::CornerModel;
use crate::detection::refine::fit::{Fit, FitOptions, fit};
use crate::detection::refine::lattice::{Known, Lattice};
use crate::detection::refine::normal_equations::{Columns, Noise};
use crate::detection::refine::samples::{Samples, Window};
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// A corner as the grid knows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridCorner {
    /// Its place in the grid. Each index may occur once.
    pub index: GridIndex,
    /// Where it is, to about 1.5 px (less where cells are small: a fifth of a cell).
    pub pixel: Pixel,
    /// Its neighbours in the directions +col, +row, −col, −row, where they are known.
    pub neighbours: [Option<Pixel>; 4],
}

/// A corner as exactly as the picture tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedCorner {
    /// Where it is.
    pub pixel: Pixel,
    /// Predicted standard deviation of `pixel`, per axis, in pixels.
    pub std_px: f64,
    /// Width of the blur across the edges, as a Gaussian's standard deviation in pixels, the pixel's own width not counted.
    pub blur_px: f64,
    /// White less black, in grey levels.
    pub contrast: f64,
}

/// Refines corners; keeps its buffers from call to call.
#[derive(Debug, Default)]
pub struct Refiner {
    samples: Samples,
    columns: Columns,
    lattice: Lattice,
    first: Vec<Option<FirstFit>>,
    known: Vec<Option<Known>>,
    spreads: [Vec<f64>; 2],
}

/// A corner fitted for itself.
#[derive(Debug, Clone, Copy)]
struct FirstFit {
    window: Window,
    fit: Fit,
}

/// Largest half width of a window, in samples: first fit, second fit.
const FIRST_REACH: f64 = 5.5;
const SECOND_REACH: f64 = 11.5;
/// Variance of a square pixel's own width.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

impl Refiner {
    /// A refiner with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Refines each of `corners` of one board in `image`; the answers are in their order. `None`: what is seen there is no
    /// chessboard corner, or nothing that determines where it is.
    pub fn refine(&mut self, image: GrayView<'_>, corners: &[GridCorner]) -> Vec<Option<RefinedCorner>> {
        self.lattice.fill(corners);
        self.fit_each(image, corners);
        let noise = self.pooled_noise();
        (0..corners.len()).map(|slot| self.fit_within_board(image, &corners[slot], slot, &noise)).collect()
    }

    fn fit_each(&mut self, image: GrayView<'_>, corners: &[GridCorner]) {
        self.first.clear();
        let mut blur_px = 1.0;
        for corner in corners {
            let first = self.fit_alone(image, corner, blur_px);
            if let Some(first) = &first {
                blur_px = first.blur_px();
            }
            self.first.push(first);
        }
        self.known.clear();
        self.known.extend(self.first.iter().map(|first| first.as_ref().map(FirstFit::known)));
    }

    /// The first fit, in a window whose size follows the blur.
    fn fit_alone(&mut self, image: GrayView<'_>, corner: &GridCorner, blur_px: f64) -> Option<FirstFit> {
        let axes = Lattice::axes(corner)?;
        let mut blur_px = blur_px.max(1.0);
        let mut start = None;
        for _ in 0..3 {
            let origin = [corner.pixel.x, corner.pixel.y];
            let window = window_for(origin, axes, blur_px, FIRST_REACH);
            let first = self.fit_first(image, window, blur_px, start)?;
            let seen = first.blur_px();
            if window_for(origin, axes, seen.max(1.0), FIRST_REACH).bin <= window.bin {
                return first.is_corner(corner).then_some(first);
            }
            start = None;
            blur_px = seen;
        }
        None
    }

    fn fit_first(
        &mut self,
        image: GrayView<'_>,
        window: Window,
        blur_px: f64,
        start: Option<CornerModel>,
    ) -> Option<FirstFit> {
        if self.samples.gather(image, &window) < 0.5 || self.samples.count < 30 {
            return None;
        }
        let bin = window.bin as f64;
        let start = match start {
            Some(start) => start,
            None => self.start(&window, blur_px)?,
        };
        let sd = 2.0 / bin;
        let noise = Noise { black: sd, white: sd, tolerance: 0.3 * start.amplitude.abs() + 6.0 };
        let options = FitOptions { iterations: 8, enough: 0.01, fit_gradient: false };
        let fit = fit(&self.samples, start, &noise, &options, &mut self.columns)?;
        Some(FirstFit { window, fit })
    }

    /// The model before the first fit: along the axes, with black and white as the four quarters have them.
    fn start(&self, window: &Window, blur_px: f64) -> Option<CornerModel> {
        let bin = window.bin as f64;
        let along = window.axes.map(|[x, y]| [x / x.hypot(y), y / x.hypot(y)]);
        let mut sums = [(0.0, 0.0); 2];
        let samples = &self.samples;
        for i in 0..samples.count {
            let (x, y) = (f64::from(samples.x[i]), f64::from(samples.y[i]));
            let [a, b] = along.map(|[ax, ay]| ay * -x + ax * y);
            let sum = &mut sums[usize::from(a * b > 0.0)];
            sum.0 += f64::from(samples.value[i]);
            sum.1 += 1.0;
        }
        let [minus, plus] = sums.map(|(sum, count)| sum / f64::max(count, 1.0));
        let sigma = (blur_px * blur_px + PIXEL_VARIANCE * bin * bin).sqrt() / bin;
        let amplitude = (plus - minus) / 2.0;
        (amplitude.abs() > 0.5).then_some(CornerModel {
            center: [0.0; 2],
            along,
            sharpness: [1.0 / sigma; 2],
            curvature: [0.0; 2],
            level: (plus + minus) / 2.0,
            amplitude: 1.3 * amplitude,
            bend: 0.0,
            gradient: [0.0; 2],
        })
    }

    /// Standard deviation of the noise of single pixels in black and in white: the median over the corners.
    fn pooled_noise(&mut self) -> [f64; 2] {
        for spread in &mut self.spreads {
            spread.clear();
        }
        for first in self.first.iter().flatten() {
            for (spread, (squares, count)) in self.spreads.iter_mut().zip(first.fit.equations.flat) {
                if count > 6.0 {
                    spread.push(squares / (count - 1.5) * (first.window.bin * first.window.bin) as f64);
                }
            }
        }
        let floor = 1.0 / 12.0;
        let mut median = |k: usize| {
            let spread: &mut Vec<f64> = &mut self.spreads[k];
            let middle = spread.len() / 2;
            (middle < spread.len()).then(|| *spread.select_nth_unstable_by(middle, f64::total_cmp).1)
        };
        let (black, white) = (median(0), median(1));
        let black_or = black.or(white).unwrap_or(4.0).max(floor);
        [black_or.sqrt(), white.unwrap_or(black_or).max(floor).sqrt()]
    }

    /// The second fit, in a large window, with what the board tells.
    fn fit_within_board(
        &mut self,
        image: GrayView<'_>,
        corner: &GridCorner,
        slot: usize,
        noise: &[f64; 2],
    ) -> Option<RefinedCorner> {
        let first = (*self.first.get(slot)?)?;
        let axes = first.window.axes;
        let origin = first.origin_in_image();
        let blur_px = first.blur_px();
        let window = window_for(origin, axes, blur_px, SECOND_REACH);
        let bin = window.bin as f64;
        if self.samples.gather(image, &window) < 0.5 || self.samples.count < 30 {
            return None;
        }
        let mut start = first.fit.model.rescaled(first.window.bin as f64, bin);
        start.center = [0.0; 2];
        for k in 0..2 {
            let bend = self.lattice.curvature(corner.index, k, start.along[k], &self.known);
            start.curvature[k] = bend.unwrap_or(0.0) * bin;
        }
        start.gradient = self.lattice.light_gradient(corner.index, axes, &self.known).map(|g| g * bin);
        let tolerance = 4.0 * noise[0].max(noise[1]) / bin + 0.08 * start.amplitude.abs();
        let noise = Noise { black: noise[0] / bin, white: noise[1] / bin, tolerance };
        let options = FitOptions { iterations: 3, enough: 0.002, fit_gradient: false };
        let fit = fit(&self.samples, start, &noise, &options, &mut self.columns)?;
        let second = FirstFit { window, fit };
        second.is_corner(corner).then(|| second.refined())
    }
}

impl FirstFit {
    fn origin_in_image(&self) -> [f64; 2] {
        let bin = self.window.bin as f64;
        [0, 1].map(|k| self.window.origin[k] + bin * self.fit.model.center[k])
    }

    fn blur_px(&self) -> f64 {
        let bin = self.window.bin as f64;
        let [a, b] = self.fit.model.sharpness;
        let variance = bin * bin * (0.5 / (a * a) + 0.5 / (b * b) - PIXEL_VARIANCE);
        variance.max(0.01).sqrt()
    }

    fn known(&self) -> Known {
        Known { at: self.origin_in_image(), level: self.fit.model.level, contrast: self.fit.model.amplitude.abs() }
    }

    /// Whether this is still the corner that was asked for, and a corner at all.
    fn is_corner(&self, corner: &GridCorner) -> bool {
        let [x, y] = self.origin_in_image();
        let axes = self.window.axes;
        let cell = axes.iter().map(|[x, y]| x.hypot(*y)).fold(f64::INFINITY, f64::min);
        let moved = (x - corner.pixel.x).hypot(y - corner.pixel.y);
        let model = &self.fit.model;
        let steady = model.correlation().abs() < 0.985 && model.along.iter().flatten().all(|v| v.is_finite());
        steady && moved < f64::min(3.0, 0.4 * cell).max(1.0) && model.amplitude.abs() > 1.0
    }

    fn refined(&self) -> RefinedCorner {
        let bin = self.window.bin as f64;
        let [x, y] = self.origin_in_image();
        let [xx, _, yy] = self.fit.covariance;
        let equations = &self.fit.equations;
        let excess = (equations.squares / (equations.effective - 9.0).max(1.0)).max(1.0);
        RefinedCorner {
            pixel: Pixel::new(x, y),
            std_px: ((xx + yy) / 2.0 * excess).sqrt() * bin,
            blur_px: self.blur_px(),
            contrast: 2.0 * self.fit.model.amplitude.abs(),
        }
    }
}

/// The window for a corner: short of the next edges, no more than `reach` samples along each axis, in bins that keep what
/// the blur leaves of the picture.
fn window_for(origin: [f64; 2], axes: [[f64; 2]; 2], blur_px: f64, reach: f64) -> Window {
    let sigma = (blur_px * blur_px + PIXEL_VARIANCE).sqrt();
    let area = (axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0]).abs();
    let lengths = axes.map(|[x, y]| x.hypot(y));
    // The distance from the corner to the next edge that runs along the other axis.
    let room = [area / lengths[1], area / lengths[0]];
    let fraction = room.map(|r| (1.0 - 2.3 * sigma / r).clamp(0.45, 0.85));
    let wanted = f64::max(fraction[0] * lengths[0], fraction[1] * lengths[1]);
    let bin = match sigma {
        s if s > 4.4 && wanted > 2.0 * reach => 4,
        s if s > 2.2 && wanted > reach => 2,
        _ => 1,
    };
    let most = [0, 1].map(|k| reach * bin as f64 / lengths[k]);
    let extent = [fraction[0].min(most[0]), fraction[1].min(most[1])];
    Window { origin, axes, extent, bin }
}
