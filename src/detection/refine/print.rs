//! The print near a corner besides its own two edges, and its removal from the pixels that the
//! corner is fitted to.
//!
//! A marker's edges come as close to a corner as an eighth of a square: blur brings them into the
//! window, where they are systematic and no noise. But the print is known, and the neighboring
//! corners locate it to a fraction of the blur. So the print is rendered twice, as it is and as the
//! corner's two edges alone would be, each blurred as the board is, and the difference is
//! subtracted from the image. Near the two edges both agree, so the neighbors' errors do not enter.

use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::print_blur::{PrintBlur, kernel_radius, line_reach};
use crate::detection::refine::samples::Samples;
use crate::detection::refine::transfer::Transfer;
use crate::detection::refine::window::Window;
use crate::geometry::pixel::Pixel;

/// The print of a board in an image.
pub trait BoardPrint {
    /// Places the print by its corners, in the order in which they are refined.
    fn put(&mut self, corners: &[Option<Pixel>]);

    /// The position in the print of a pixel near the corner of this number. `None` where that is
    /// not known.
    fn place_of(&self, corner: usize, pixel: [f64; 2]) -> Option<[f64; 2]>;

    /// The mean of the print over a rectangle about `place` that reaches `half` to each side: 1
    /// where all is white and −1 where all is black.
    fn mean(&self, place: [f64; 2], half: [f64; 2]) -> f32;

    /// The same if only the two edges through the corner of this number were printed.
    fn mean_of_edges(&self, corner: usize, place: [f64; 2], half: [f64; 2]) -> f32;

    /// The position in the image, in pixels, at which the print has the corner of this number.
    /// `None` where that is not known.
    fn expected(&self, corner: usize) -> Option<[f64; 2]>;

    /// How far from a corner there are no edges but its own, as a fraction of the way to its
    /// neighbors.
    fn room(&self) -> f64;
}

/// Edges closer than this many standard deviations of the blur disturb a corner: its own edges are
/// fitted up to 2.7 of them away, and others are visible as far. Chosen, not swept.
const DISTURBING_BLURS: f64 = 5.0;
/// Means of the print, −1 … 1, with a smaller difference are equal: a tenth of what eight bits
/// distinguish.
const EQUAL_MEANS: f32 = 1e-3;
/// Largest half width of a rendered patch, in samples: twice that of the window of a second fit.
const MOST_REACH: i64 = 28;

/// Whether other edges, at the fraction `room` of the way along `axes`, disturb a corner with this
/// blur.
pub(super) fn disturbs(room: f64, [u, v]: [[f64; 2]; 2], blur_px: f64) -> bool {
    let height = (u[0] * v[1] - u[1] * v[0]).abs() / length(u).max(length(v));
    room * height < DISTURBING_BLURS * blur_px
}

/// The print around one corner, in the samples of its window.
#[derive(Debug, Default)]
pub(super) struct PrintPatch {
    /// Half width, in samples.
    reach: i64,
    /// From the window's origin to the patch's middle, in samples.
    offset: [f64; 2],
    /// The print as it is, and as the two edges alone, row by row, wider than the patch by `margin`
    /// samples on each side.
    read: [Vec<f32>; 2],
    margin: i64,
    /// The same after blurring, within `reach`.
    layers: [Vec<f32>; 2],
    passed: Vec<f32>,
    kernel: Vec<f32>,
}

/// Which layers of a print are read.
#[derive(Clone, Copy, PartialEq)]
enum Layers {
    Print,
    /// And the corner's two edges alone.
    Both,
}

impl PrintPatch {
    /// Whether `blur` is narrow enough to be rendered in samples of `bin` pixels in bounded time.
    pub fn can_render(blur: PrintBlur, bin: usize) -> bool {
        blur.reach(bin) <= 2 * MOST_REACH
    }

    /// Whether a patch of single pixels can be rendered that reaches as far as `reach_px`.
    pub fn covers(blur: PrintBlur, reach_px: f64) -> bool {
        reach_px + 1.0 <= MOST_REACH as f64 && Self::can_render(blur, 1)
    }

    /// Renders the print around `corner` in the samples of `window`, blurred. Returns false where
    /// only the corner's two edges are printed.
    pub fn render(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur: PrintBlur,
    ) -> bool {
        let margin = blur.reach(window.bin);
        let disturbed = self.read(print, corner, window, margin, Layers::Both);
        disturbed && self.blurred(blur, window)
    }

    /// Renders the whole print around `corner`, without the layer of its two edges.
    pub fn draw(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur: PrintBlur,
    ) {
        self.read(print, corner, window, blur.reach(window.bin), Layers::Print);
        self.blurred(blur, window);
    }

    /// Reads the print as far out as any blur reaches that a search from `blur` tries, for
    /// [`Self::blurred`].
    pub fn read_for_any(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        blur: PrintBlur,
    ) {
        self.read(print, corner, window, blur.reach_of_any(window.bin), Layers::Print);
    }

    /// Blurs what was read in the samples of `window`. Returns false where the blur reaches farther
    /// than that.
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

    /// The whole print, this many samples right of and below the middle.
    pub fn full(&self, i: i64, j: i64) -> f64 {
        let side = 2 * self.reach + 1;
        f64::from(self.layers[0][((j + self.reach) * side + i + self.reach) as usize])
    }

    /// Subtracts from `samples`, which are those of the rendered window, all print but the corner's
    /// two edges, in the gray values of `model`; these to `power` are proportional to light.
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

    /// Reads the print at all samples of `window` and `margin` around them. With both layers:
    /// returns whether edges other than the corner's two are printed there.
    fn read(
        &mut self,
        print: &dyn BoardPrint,
        corner: usize,
        window: &Window,
        margin: i64,
        layers: Layers,
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
        // A sample is the mean over a square of the image; a rectangle along the print's axes with
        // the same variances replaces it.
        let half = [0, 1].map(|k| {
            let [across, down] = [right[k] - left[k], below[k] - above[k]];
            (across * across + down * down).sqrt() / 2.0
        });
        let mut disturbed = false;
        for j in -around..=around {
            for i in -around..=around {
                let place = place_of(i as f64, j as f64);
                let full = place.map_or(0.0, |place| print.mean(place, half));
                self.read[0].push(full);
                if layers == Layers::Both {
                    let alone = place.map_or(0.0, |place| print.mean_of_edges(corner, place, half));
                    disturbed |= (full - alone).abs() > EQUAL_MEANS;
                    self.read[1].push(alone);
                }
            }
        }
        disturbed
    }

    /// Blurs the layers, and keeps the part within reach.
    fn blur(&mut self, line: [f64; 2]) {
        let moved = line_reach(line) as usize;
        let Self { reach, margin, read, layers, passed, kernel, .. } = self;
        let side = 2 * *reach as usize + 1;
        let inner = side + 2 * moved;
        let outer = inner + kernel.len() - 1;
        let wide = side + 2 * *margin as usize;
        let first = (wide - outer) / 2;
        for (read, layer) in read.iter().zip(layers).filter(|(read, _)| !read.is_empty()) {
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

/// Averages `layer`, `side` samples and a margin wide, along `line` to both sides; the margin is
/// dropped.
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
        // The centers of equal parts of the line.
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
