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
    fn put(&mut self, corners: &[Option<Pixel>]);

    /// The place in the print of a position in the image in pixels, near the corner of this number.
    /// `None` where that is not known.
    fn place_of(&self, corner: usize, pixel: [f64; 2]) -> Option<[f64; 2]>;

    /// The mean of the print near the corner of this number over a rectangle about `place` that
    /// reaches `half` to each side, 1 where all is white and −1 where all is black: as it is, and
    /// as the two edges through the corner alone would have it.
    fn mean(&self, corner: usize, place: [f64; 2], half: [f64; 2]) -> [f32; 2];

    /// Where the print has the corner of this number, in the image in pixels. `None` where that is
    /// not known.
    fn expected(&self, corner: usize) -> Option<[f64; 2]>;

    /// How far from a corner its edges are the only ones, as a part of the way to its neighbors.
    fn room(&self) -> f64;
}

/// Edges nearer than this many standard deviations of the blur disturb a corner: its own are fitted
/// up to 2.7 of them away, and others show as far.
const DISTURBS: f64 = 5.0;
/// Standard deviations of the blur beyond which nothing of an edge is rendered.
const KERNEL_REACH: f64 = 3.0;
/// Means of the print, −1 … 1, that differ by less are the same: a tenth of what eight bits
/// distinguish.
const SAME: f32 = 1e-3;
/// What any blur of a width reaches, in widths: three standard deviations of a round one that is
/// e^0.7 times as wide; the half way of a motion is at most 2.4 widths, and e^0.7 times that.
const ANY_REACH: f64 = 7.0;
/// Largest half width of a rendered patch, in samples: twice that of the window of a second fit.
const MOST_REACH: i64 = 28;

/// Whether other edges at the part `room` of the way along `axes` disturb a corner blurred so.
pub(super) fn disturbs(room: f64, [u, v]: [[f64; 2]; 2], blur_px: f64) -> bool {
    let height = (u[0] * v[1] - u[1] * v[0]).abs() / length(u).max(length(v));
    room * height < DISTURBS * blur_px
}

/// A blur: a Gaussian's, and a uniform motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PrintBlur {
    /// The Gaussian's standard deviation, in pixels.
    sigma_px: f64,
    /// Half of the way of the motion, in pixels.
    line_px: [f64; 2],
}

impl PrintBlur {
    /// Without motion.
    pub fn round(sigma_px: f64) -> Self {
        Self { sigma_px, line_px: [0.0; 2] }
    }

    /// The root of the mean variance across two edges at a right angle, in pixels.
    pub fn width_px(&self) -> f64 {
        let [x, y] = self.line_px;
        (self.sigma_px * self.sigma_px + (x * x + y * y) / 6.0).sqrt()
    }

    /// A motion in the direction `angle` that has `share` of the variance across two edges at a
    /// right angle, which together are 2·`blur_px`².
    fn moving(blur_px: f64, angle: f64, share: f64) -> Self {
        let variance = 2.0 * blur_px * blur_px;
        // A uniform motion over 2h has a variance of h²/3.
        let half = (3.0 * share * variance).sqrt();
        let sigma_px = ((1.0 - share) * variance / 2.0).sqrt().max(SHARPEST_PX);
        let (sin, cos) = angle.sin_cos();
        Self { sigma_px, line_px: [half * cos, half * sin] }
    }

    /// Whether it is narrow enough to be rendered in samples of `bin` pixels in bounded time.
    pub fn can_be_rendered(self, bin: usize) -> bool {
        self.reach(bin) <= 2 * MOST_REACH
    }

    /// How far it reaches, in samples of `bin` pixels.
    fn reach(self, bin: usize) -> i64 {
        let bin = bin as f64;
        line_reach(self.line_px.map(|v| v / bin)) + kernel_radius(self.sigma_px / bin)
    }

    /// The same in an image `factor` times as large.
    fn scaled(self, factor: f64) -> Self {
        Self { sigma_px: factor * self.sigma_px, line_px: self.line_px.map(|v| factor * v) }
    }

    /// The width of least `misfit`, by the golden section.
    pub fn best_width(self, misfit: &mut dyn FnMut(Self) -> f64) -> Self {
        let golden = (5_f64.sqrt() - 1.0) / 2.0;
        let mut at = |log: f64| misfit(self.scaled(log.exp()));
        let (mut low, mut high) = (-WIDTHS, WIDTHS);
        let mut inner = [high - golden * (high - low), low + golden * (high - low)];
        let mut found = inner.map(&mut at);
        for _ in 0..SECTIONS {
            if found[0] < found[1] {
                high = inner[1];
                inner = [high - golden * (high - low), inner[0]];
                found = [at(inner[0]), found[0]];
            } else {
                low = inner[0];
                inner = [inner[1], low + golden * (high - low)];
                found = [found[1], at(inner[1])];
            }
        }
        self.scaled(((low + high) / 2.0).exp())
    }

    /// The blur of least `misfit`, of those with the variance of `blur_px` across edges at a right
    /// angle.
    pub fn best(blur_px: f64, misfit: &mut dyn FnMut(Self) -> f64) -> Self {
        let round = Self::round(blur_px);
        let mut best = (MOVES * misfit(round), round);
        let mut at = (0.0, FIRST_SHARE);
        let mut offer = |angle: f64, share: f64, at: &mut (f64, f64)| {
            let moving = Self::moving(blur_px, angle, share);
            let found = misfit(moving);
            if found < best.0 {
                best = (found, moving);
                *at = (angle, share);
            }
        };
        let step = std::f64::consts::PI / ANGLES as f64;
        (0..ANGLES).for_each(|k| offer(step * k as f64, FIRST_SHARE, &mut at));
        let angle = at.0;
        SHARES.iter().for_each(|share| offer(angle, *share, &mut at));
        let (angle, share) = at;
        [-0.5, -0.25, 0.25, 0.5].iter().for_each(|k| offer(angle + k * step, share, &mut at));
        best.1
    }
}

/// Directions in which motion is sought, over a half turn.
const ANGLES: usize = 12;
/// The part of the variance that is motion's: first, and then.
const FIRST_SHARE: f64 = 0.9;
const SHARES: [f64; 6] = [0.5, 0.7, 0.8, 0.85, 0.94, 0.97];
/// The natural logarithm of the most that a width is wrong by, twice the 17 % by which widths of
/// edges were too large on AprilGrids, and the sections until it is known to 1 %.
const WIDTHS: f64 = 0.35;
const SECTIONS: usize = 8;
/// Motion must leave less than this part of what a round blur leaves.
const MOVES: f64 = 0.8;
/// No lens with its pixels is sharper, in pixels.
const SHARPEST_PX: f64 = 0.35;
/// The darkest gray level, and the powers of gray levels that may be in proportion to light.
const DARKEST: f64 = 0.5;
const POWERS: [f64; 2] = [0.7, 3.0];

/// The print around one corner, in the samples of its window.
#[derive(Debug, Default)]
pub(super) struct PrintPatch {
    /// Half width, in samples.
    reach: i64,
    /// From the window's origin to the patch's middle, in samples.
    offset: [f64; 2],
    /// The print as it is and as two edges alone, row by row, `margin` samples wider to each side
    /// than the patch.
    read: [Vec<f32>; 2],
    margin: i64,
    /// The same blurred, within `reach`.
    layers: [Vec<f32>; 2],
    passed: Vec<f32>,
    kernel: Vec<f32>,
}

impl PrintPatch {
    /// Renders the print around `corner` in the samples of `window`, blurred. False where nothing
    /// but the corner's two edges is printed.
    pub fn render(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur: PrintBlur,
    ) -> bool {
        let margin = blur.reach(window.bin);
        let disturbed = self.read(print, corner, window, margin);
        disturbed && self.blurred(blur, window)
    }

    /// The same wherever anything is printed.
    pub fn draw(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur: PrintBlur,
    ) {
        let margin = blur.reach(window.bin);
        self.read(print, corner, window, margin);
        self.blurred(blur, window);
    }

    /// Reads the print as far around as any blur in [`PrintBlur::best`] of the width of `blur`
    /// reaches, for [`Self::blurred`].
    pub fn read_for_any(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur: PrintBlur,
    ) {
        let margin = (ANY_REACH * blur.width_px() / window.bin as f64).ceil() as i64;
        self.read(print, corner, window, margin);
    }

    /// Blurs what was read in the samples of `window`. False where the blur reaches farther than
    /// that.
    pub fn blurred(&mut self, blur: PrintBlur, window: &Window) -> bool {
        let bin = window.bin as f64;
        if blur.reach(window.bin) > self.margin {
            return false;
        }
        self.fill_kernel(blur.sigma_px / bin);
        self.blur(blur.line_px.map(|v| v / bin));
        true
    }

    /// Half its width, in samples.
    pub fn reach(&self) -> i64 {
        self.reach
    }

    /// From the window's origin to its middle, in samples.
    pub fn offset(&self) -> [f64; 2] {
        self.offset
    }

    /// The whole print, so many samples right of and below the middle.
    pub fn full(&self, i: i64, j: i64) -> f64 {
        let side = 2 * self.reach + 1;
        f64::from(self.layers[0][((j + self.reach) * side + i + self.reach) as usize])
    }

    /// Takes off `samples`, which are those of the rendered window, what the corner's two edges do
    /// not explain, in the gray values of `model`, which to `power` are in proportion to light.
    pub fn take_off(&self, samples: &mut Samples, model: &CornerModel, power: f64) {
        let gray = Transfer::of(model, power);
        let gradient = model.gradient.map(|g| g as f32);
        samples.change(|x, y, value| match self.at(x, y) {
            Some([full, alone]) if full != alone => {
                let light = 1.0 + gradient[0] * x + gradient[1] * y;
                value + light * (gray.at(alone) - gray.at(full))
            }
            _ => value,
        });
    }

    /// Mean square of the differences between `samples` and the rendered print, in squares of gray
    /// levels.
    pub fn misfit(&self, samples: &mut Samples, model: &CornerModel, power: f64) -> f64 {
        let gray = Transfer::of(model, power);
        let (mut sum, mut count) = (0.0, 0.0);
        samples.change(|x, y, value| {
            if let Some([full, _]) = self.at(x, y) {
                sum += f64::from(value - gray.at(full)).powi(2);
                count += 1.0;
            }
            value
        });
        sum / f64::max(count, 1.0)
    }

    /// The print at a place of the window: as it is, and as two edges alone.
    fn at(&self, x: f32, y: f32) -> Option<[f32; 2]> {
        let side = 2 * self.reach + 1;
        let [dx, dy] = self.offset.map(|o| o as f32);
        let (i, j) = ((x - dx).round() as i64 + self.reach, (y - dy).round() as i64 + self.reach);
        let inside = (0..side).contains(&i) && (0..side).contains(&j);
        let at = (j * side + i) as usize;
        inside.then(|| [self.layers[0][at], self.layers[1][at]])
    }

    fn fill_kernel(&mut self, sigma: f64) {
        let radius = kernel_radius(sigma);
        self.kernel.clear();
        let weight = |k: i64| (-0.5 * (k as f64 / sigma.max(0.2)).powi(2)).exp();
        let total: f64 = (-radius..=radius).map(weight).sum();
        self.kernel.extend((-radius..=radius).map(|k| (weight(k) / total) as f32));
    }

    /// Reads the print at all samples of `window` and `margin` around them. Whether other edges
    /// than the corner's two are printed there.
    fn read(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        margin: i64,
    ) -> bool {
        let bin = window.bin as f64;
        let half = (bin - 1.0) / 2.0;
        self.offset = window.origin.map(|o| ((o - half).round() + half - o) / bin);
        let reach = [0, 1].map(|k| {
            window.extent[0] * window.axes[0][k].abs() + window.extent[1] * window.axes[1][k].abs()
        });
        self.reach = ((reach[0].max(reach[1]) / bin).ceil() as i64 + 1).min(MOST_REACH);
        self.margin = margin;
        let around = self.reach + margin;
        self.read.iter_mut().for_each(Vec::clear);
        let place_of = |i: f64, j: f64| {
            let pixel = [i + self.offset[0], j + self.offset[1]];
            print.place_of(corner, [0, 1].map(|k| window.origin[k] + bin * pixel[k]))
        };
        let ends =
            [place_of(-0.5, 0.0), place_of(0.5, 0.0), place_of(0.0, -0.5), place_of(0.0, 0.5)];
        let [Some(left), Some(right), Some(above), Some(below)] = ends else {
            let side = (2 * around + 1) as usize;
            self.read.iter_mut().for_each(|layer| layer.resize(side * side, 0.0));
            return false;
        };
        // A sample is the mean over a square of the image; one along the print's axes that is as
        // wide has the same mean and variances.
        let half = [0, 1].map(|k| {
            let [across, down] = [right[k] - left[k], below[k] - above[k]];
            (across * across + down * down).sqrt() / 2.0
        });
        let mut disturbed = false;
        for j in -around..=around {
            for i in -around..=around {
                let place = place_of(i as f64, j as f64);
                let [full, alone] = place.map_or([0.0; 2], |place| print.mean(corner, place, half));
                disturbed |= (full - alone).abs() > SAME;
                self.read[0].push(full);
                self.read[1].push(alone);
            }
        }
        disturbed
    }

    /// Blurs both layers, and leaves what lies within reach.
    fn blur(&mut self, line: [f64; 2]) {
        let moved = line_reach(line) as usize;
        let Self { reach, margin, read, layers, passed, kernel, .. } = self;
        let side = 2 * *reach as usize + 1;
        let inner = side + 2 * moved;
        let outer = inner + kernel.len() - 1;
        let wide = side + 2 * *margin as usize;
        let first = (wide - outer) / 2;
        for (read, layer) in read.iter().zip(layers) {
            passed.clear();
            for row in read.chunks_exact(wide).skip(first).take(outer) {
                passed.extend(row[first..first + outer].windows(kernel.len()).map(|seen| {
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
            if moved > 0 {
                move_along(layer, passed, side, moved, line);
            }
        }
    }
}

/// By how many samples a motion to both ends of `line` reaches to each side.
fn line_reach(line: [f64; 2]) -> i64 {
    line[0].abs().max(line[1].abs()).ceil() as i64
}

/// Half the width of a Gaussian's kernel.
fn kernel_radius(sigma: f64) -> i64 {
    (KERNEL_REACH * sigma).ceil().max(1.0) as i64
}

/// Averages `layer`, `side` samples and a margin wide, along `line` to both sides; what lies within
/// the margin is left.
fn move_along(
    layer: &mut Vec<f32>,
    moved: &mut Vec<f32>,
    side: usize,
    margin: usize,
    line: [f64; 2],
) {
    let wide = side + 2 * margin;
    let steps = (3.0 * line[0].hypot(line[1])).ceil().max(1.0) as i64;
    moved.clear();
    moved.resize(side * side, 0.0);
    let weight = 1.0 / (2 * steps + 1) as f32;
    for step in -steps..=steps {
        // The middles of equal parts of the line.
        let part = 2.0 * step as f64 / (2 * steps + 1) as f64;
        let at = line.map(|v| v * part + margin as f64);
        let [i, j] = at.map(|v| (v.floor() as usize).min(2 * margin - 1));
        let [fx, fy] = [(at[0] - i as f64) as f32, (at[1] - j as f64) as f32];
        for (row, sums) in moved.chunks_exact_mut(side).enumerate() {
            let (upper, lower) =
                (&layer[(row + j) * wide + i..], &layer[(row + j + 1) * wide + i..]);
            for (k, sum) in sums.iter_mut().enumerate() {
                let above = upper[k] + fx * (upper[k + 1] - upper[k]);
                let below = lower[k] + fx * (lower[k + 1] - lower[k]);
                *sum += weight * (above + fy * (below - above));
            }
        }
    }
    std::mem::swap(layer, moved);
}

/// Gray values of a pattern, 1 white and −1 black, of which a power is in proportion to light, as
/// of a camera with a gamma.
struct Transfer {
    middle: f64,
    half: f64,
    inverse: f64,
}

impl Transfer {
    fn of(model: &CornerModel, power: f64) -> Self {
        let [black, white] = black_and_white(model).map(|gray| gray.powf(power));
        Self { middle: (white + black) / 2.0, half: (white - black) / 2.0, inverse: 1.0 / power }
    }

    fn at(&self, pattern: f32) -> f32 {
        let light = self.middle + self.half * f64::from(pattern);
        light.max(0.0).powf(self.inverse) as f32
    }
}

fn black_and_white(model: &CornerModel) -> [f64; 2] {
    let half = model.amplitude.abs();
    [model.level - half, model.level + half].map(|gray| gray.max(DARKEST))
}

/// The power of gray values that makes the gray value midway between black and white in light that
/// which `model` has at its edges.
pub(super) fn linear_power(model: &CornerModel) -> f64 {
    let [black, white] = black_and_white(model);
    let edge = (model.level + model.gamma_term).max(DARKEST);
    // Above the root, light at the edge is less than the mean of black and white.
    let mean_less_edge = |power: f64| (black / edge).powf(power) + (white / edge).powf(power) - 2.0;
    let [mut low, mut high] = POWERS;
    if mean_less_edge(high) < 0.0 {
        return high;
    }
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if mean_less_edge(middle) < 0.0 { low = middle } else { high = middle }
    }
    high
}
