//! Sub-pixel corners: a parametric model of the blurred corner, fitted to its pixels, with a
//! calibrated standard deviation.
//!
//! | stage | file | what it does |
//! | --- | --- | --- |
//! | window | `window`, `samples` | gathers the pixels along the cells' own axes, short of the next edges |
//! | model | `corner_model`, `gaussian` | two crossing edges, each a Gaussian's integral across |
//! | fit | `fit`, `normal_equations`, `elimination` | weighted least squares, robust against what does not belong |
//! | print | `print` | takes off the window what is printed beside the two edges, where blur brings it in |
//! | shading | `shading` | takes off light that changes over a corner's window |
//! | board | `lattice`, `field`, `noise` | what all corners estimate together: the curvature of the edges, the change of light, the noise |
//! | trust | `halves`, `scatter`, `misfit`, `straightness` | how far off corners are: the parts of their edges disagree, one fits worse than the others, or they leave their lines |
//!
//! Every corner is fitted twice: in a small window by itself, then in a large one, with the
//! curvature of the edges, the change of light and the noise known from the board. `README.md`
//! beside this file has the measurements.

mod corner_model;
mod elimination;
mod field;
mod fit;
mod gaussian;
mod grid_corner;
mod halves;
mod lattice;
mod misfit;
mod noise;
mod normal_equations;
pub mod print;
mod samples;
mod scatter;
mod shading;
mod straightness;
mod window;

pub use crate::detection::refine::grid_corner::GridCorner;

use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::fit::{CornerFit, FitOptions, fit};
use crate::detection::refine::halves::disagreements;
use crate::detection::refine::lattice::{Known, Lattice, axes_of};
use crate::detection::refine::misfit::{CornerMisfit, Quality};
use crate::detection::refine::noise::PooledNoise;
use crate::detection::refine::normal_equations::{ModelColumns, Noise};
use crate::detection::refine::print::{BoardPrint, PrintBlur, PrintPatch, disturbs, linear_power};
use crate::detection::refine::samples::Samples;
use crate::detection::refine::scatter::Scatter;
use crate::detection::refine::shading::take_off_shading;
use crate::detection::refine::straightness::{Placed, Straightness};
use crate::detection::refine::window::{PIXEL_VARIANCE, Window};
use crate::geometry::median::median_of;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// A refined corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedCorner {
    /// Where it is.
    pub pixel: Pixel,
    /// Predicted standard deviation of `pixel`, per axis, in pixels.
    pub std_px: f64,
    /// Width of the blur across the edges, as a Gaussian's standard deviation in pixels, the
    /// pixel's own width not counted.
    pub blur_px: f64,
    /// White less black, in gray levels.
    pub contrast: f64,
}

/// Refines corners; its buffers are reused from call to call.
#[derive(Debug, Default)]
pub struct Refiner {
    /// The part of the way to the neighbors that is not free of other edges.
    taken: f64,
    samples: Samples,
    columns: ModelColumns,
    lattice: Lattice,
    noise: PooledNoise,
    scatter: Scatter,
    misfit: CornerMisfit,
    straightness: Straightness,
    /// The factor on each corner's standard deviation; `None` if it is rejected.
    of_corners: Vec<Option<f64>>,
    /// The covariance of each corner in units of the square of its standard deviation: xx, xy, yy.
    shapes: Vec<[f64; 3]>,
    fitted: Vec<Option<Fitted>>,
    known: Vec<Option<Known>>,
    patch: PrintPatch,
    /// Where the corners are by now.
    placed: Vec<Option<Pixel>>,
    /// Widths of the blur at the corners.
    blurs_px: Vec<f64>,
    powers: Vec<f64>,
    /// Of each corner, whether its light is its own.
    shaded: Vec<bool>,
    /// The last window of a first fit.
    quarter_means: [f64; 2],
}

/// A fit and where it was made.
#[derive(Debug, Clone, Copy)]
struct Fitted {
    window: Window,
    fit: CornerFit,
    /// The noise it was weighted with.
    noise: Noise,
    /// Inlier ratio: the share of samples that agree with the model.
    inlier_ratio: f64,
}

/// Half width of the windows, in samples: of the first fit, and the largest, beyond which more
/// pixels cost more time than they are worth.
const FIRST_REACH: f64 = 5.0;
const SECOND_REACH: f64 = 11.5;
/// Fewer samples than this determine no corner.
const FEWEST_SAMPLES: usize = 30;
/// Fits are repeated with a larger window while the blur turns out this much wider than the window
/// was made for,
const WIDER: f64 = 1.4;
/// and recentered when the corner is this many samples from the window's center.
const RECENTER: f64 = 2.0;
const MOST_WINDOWS: usize = 5;
/// Number of corners whose edges give the scatter.
const ENOUGH_CORNERS: usize = 40;
/// Corners of which the first fit leaves this many times the median's mean square are under light of
/// their own, or beside an occluder.
const SHADED: f64 = 1.6;
/// Added to the tolerance of a residual while light is taken off, as shares of the amplitude.
const SHADED_TOLERANCES: [f64; 4] = [0.5, 0.3, 0.15, 0.05];
/// No motion is distinguished from a round blur that is narrower.
const LEAST_MOTION_PX: f64 = 1.2;
/// Corners at which kinds of blur are compared.
const COMPARED_CORNERS: usize = 6;
/// How often corners are fitted with what is printed beside them taken off, before the last fit:
/// each makes black, white and blur less wrong.
const PRINT_ROUNDS: usize = 2;
/// Inlier ratio of an unoccluded corner.
const MOST_AGREE: f64 = 0.7;

impl Refiner {
    /// A refiner with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// One for boards whose next edges lie at this part of the way to the given neighbors.
    pub fn with_room(room: f64) -> Self {
        Self { taken: 1.0 - room, ..Self::default() }
    }

    /// Refines each of `corners` of one board in `image` into `refined`, in their order, replacing
    /// its content. `None`: the image shows no chessboard corner there, or does not determine its
    /// position. Does not allocate after a board as large.
    pub fn refine(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        refined: &mut Vec<Option<RefinedCorner>>,
    ) {
        self.refine_printed(image, corners, None, refined);
    }

    /// The same of a board on which more is printed than its corners' edges.
    pub fn refine_printed(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        print: Option<&mut dyn BoardPrint>,
        refined: &mut Vec<Option<RefinedCorner>>,
    ) {
        self.fit_each(image, corners);
        self.compare_fits();
        self.lattice.fill(corners, &self.known);
        if print.is_none() {
            self.shaded.fill(false);
        }
        let nearby = print.and_then(|print| self.fit_printed(image, corners, print));
        let noise = self.noise.of_pixels();
        let fitted = std::mem::take(&mut self.fitted);
        refined.clear();
        self.misfit.clear();
        self.straightness.clear();
        self.shapes.clear();
        for (slot, (corner, first)) in corners.iter().zip(&fitted).enumerate() {
            let beside = Beside { print: nearby.map(|it| (slot, it)), shaded: self.shaded[slot] };
            let second = first
                .as_ref()
                .and_then(|first| self.fit_within_board(image, corner, first, (noise, beside)));
            let second = second.filter(|second| second.is_corner(corner));
            self.misfit.take(second.as_ref().map(Fitted::quality));
            if let Some(second) = second.as_ref().filter(|_| is_compared(corners, corner)) {
                self.note_scatter(refined.len(), second);
            }
            self.shapes.push(second.as_ref().map_or([1.0, 0.0, 1.0], Fitted::shape));
            if let Some(second) = &second {
                self.straightness.note_window(second.window.extent);
            }
            refined.push(second.as_ref().map(Fitted::refined));
        }
        self.fitted = fitted;
        self.of_corners.clear();
        self.of_corners.extend(self.misfit.std_factors());
        let of_board = self.scatter.std_factor(&self.of_corners);
        for (corner, of_corner) in refined.iter_mut().zip(&self.of_corners) {
            *corner = corner.zip(*of_corner).map(|(corner, of_corner)| RefinedCorner {
                std_px: of_board * of_corner * corner.std_px,
                ..corner
            });
        }
        self.scale_by_lines(refined);
    }

    /// What is known of the corners that fit as well as the others.
    fn compare_fits(&mut self) {
        self.misfit.clear();
        self.fitted
            .iter()
            .for_each(|fitted| self.misfit.take(fitted.as_ref().map(Fitted::quality)));
        self.shaded.clear();
        self.shaded.extend(self.misfit.worse_than(SHADED));
        self.known.clear();
        let fits = self.misfit.fits();
        self.known.extend(
            self.fitted
                .iter()
                .zip(fits)
                .map(|(fitted, fits)| fitted.as_ref().filter(|_| fits).map(Fitted::known)),
        );
    }

    /// Where blur brings other edges of the print into the corners' windows: fits that take them
    /// off, each with what the one before it says of blur, black and white. `None` where it does
    /// not.
    fn fit_printed<'a>(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        print: &'a mut dyn BoardPrint,
    ) -> Option<Nearby<'a>> {
        let blur_px = self.median_blur_px()?;
        let disturbed = corners
            .iter()
            .filter_map(axes_of)
            .filter(|&axes| disturbs(print.room(), axes, blur_px));
        if 2 * disturbed.count() < corners.len() {
            return None;
        }
        self.place(print);
        let mut power = self.median_power()?;
        let mut blur = PrintBlur::round(blur_px);
        for _ in 0..PRINT_ROUNDS {
            let noise = self.noise.of_pixels();
            self.noise.clear();
            for (slot, corner) in corners.iter().enumerate() {
                let Some(first) = self.fitted[slot] else { continue };
                let print = Some((slot, Nearby { print: &*print, blur, power }));
                let beside = Beside { print, shaded: self.shaded[slot] };
                let second = self
                    .fit_within_board(image, corner, &first, (noise, beside))
                    .filter(|second| second.may_be_corner(corner));
                if let Some(second) = second {
                    self.noise.take(second.fit.residuals.flat, second.window.bin);
                    self.fitted[slot] = Some(second);
                }
            }
            self.compare_fits();
            self.lattice.fill(corners, &self.known);
            self.place(print);
            power = self.median_power()?;
            blur = self.blur_as_seen(image, &*print, power)?;
        }
        Some(Nearby { print: &*print, blur, power })
    }

    fn place(&mut self, print: &mut dyn BoardPrint) {
        self.placed.clear();
        let center = |known: &Option<Known>| known.map(|it| Pixel::new(it.at[0], it.at[1]));
        self.placed.extend(self.known.iter().map(center));
        print.place(&self.placed);
    }

    /// Median width of the blur at the corners.
    fn median_blur_px(&mut self) -> Option<f64> {
        let blurs = &mut self.blurs_px;
        blurs.clear();
        blurs.extend(self.fitted.iter().flatten().map(Fitted::blur_px));
        median_of(blurs)
    }

    /// Median of the powers of the corners' gray values that are in proportion to light.
    fn median_power(&mut self) -> Option<f64> {
        let powers = &mut self.powers;
        powers.clear();
        powers.extend(self.fitted.iter().flatten().map(|it| linear_power(&it.fit.model)));
        median_of(powers)
    }

    /// The blur that makes the print most like the image, of those that blur the edges as the
    /// corners' fits say: round, or a motion in some direction.
    fn blur_as_seen(
        &mut self,
        image: GrayView<'_>,
        print: &dyn BoardPrint,
        power: f64,
    ) -> Option<PrintBlur> {
        let blur_px = self.median_blur_px()?;
        let round = PrintBlur::round(blur_px);
        if blur_px < LEAST_MOTION_PX {
            return Some(round);
        }
        let fitted = std::mem::take(&mut self.fitted);
        let compared: Vec<(usize, &Fitted)> = (fitted.iter().enumerate())
            .filter_map(|(slot, fitted)| Some((slot, fitted.as_ref()?)))
            .filter(|(slot, _)| self.known[*slot].is_some())
            .collect();
        let every = (compared.len() / COMPARED_CORNERS).max(1);
        let mut misfit = |blur: PrintBlur| -> f64 {
            let each = compared.iter().step_by(every).filter_map(|(slot, fitted)| {
                let axes = fitted.window.axes;
                let window = Window::new(fitted.center(), axes, blur_px, (SECOND_REACH, 1.0));
                self.gather(image, &window)?;
                self.patch.render(print, *slot, &window, blur);
                let bins = [fitted.window.bin, window.bin].map(|bin| bin as f64);
                let model = fitted.fit.model.rescaled(bins[0], bins[1]);
                Some(self.patch.misfit(&mut self.samples, &model, power))
            });
            each.sum()
        };
        let best = PrintBlur::best(blur_px, &mut misfit);
        self.fitted = fitted;
        Some(best)
    }

    /// Widens or narrows all standard deviations where corners scatter more or less about the
    /// board's lines than they say.
    fn scale_by_lines(&mut self, refined: &mut [Option<RefinedCorner>]) {
        for axis in 0..2 {
            let lines = self.lattice.lines(axis).map(|(place, line)| {
                let seen: &[Option<RefinedCorner>] = refined;
                let shapes = &self.shapes;
                let placed = line.filter_map(move |slot| {
                    let RefinedCorner { pixel, std_px, .. } = seen[slot]?;
                    Some(Placed {
                        pixel,
                        covariance: shapes[slot].map(|share| share * std_px * std_px),
                    })
                });
                (place, placed)
            });
            self.straightness.take(axis, lines);
        }
        let factor = self.straightness.std_factor();
        refined.iter_mut().flatten().for_each(|corner| corner.std_px *= factor);
    }

    /// The first fits.
    fn fit_each(&mut self, image: GrayView<'_>, corners: &[GridCorner]) {
        self.fitted.clear();
        self.noise.clear();
        self.scatter.clear();
        let mut before = Before { blur_px: 1.0, contrast: 1.3, offset: 0.0, gamma_term: 0.0 };
        for corner in corners {
            let fitted = self
                .fit_alone(image, corner, &before)
                .filter(|fitted| fitted.may_be_corner(corner));
            if let Some(fitted) = &fitted {
                before = self.as_before(fitted);
                self.noise.take(fitted.fit.residuals.flat, fitted.window.bin);
            }
            self.fitted.push(fitted);
        }
    }

    /// The first fit of a corner: in a small window, whose size follows the blur and which moves
    /// with the corner. Where that fails the guess may be far off: a window of larger bins covers
    /// more.
    fn fit_alone(
        &mut self,
        image: GrayView<'_>,
        corner: &GridCorner,
        before: &Before,
    ) -> Option<Fitted> {
        let axes = axes_of(corner)?;
        let guess = [corner.pixel.x, corner.pixel.y];
        let (mut origin, mut blur_px, mut coarser) = (guess, before.blur_px.max(0.7), 1);
        let mut best = None;
        for _ in 0..MOST_WINDOWS {
            let window = Window::new(
                origin,
                axes,
                blur_px,
                (FIRST_REACH * coarser as f64, 1.0 - self.taken),
            )
            .coarsened(coarser);
            let Some(first) = self
                .fit_in(image, window, &Before { blur_px, ..*before })
                .filter(Fitted::has_settled)
            else {
                (origin, coarser) = (guess, 2 * coarser);
                continue;
            };
            let (center, seen) = (first.center(), first.blur_px());
            let stayed = length([center[0] - origin[0], center[1] - origin[1]])
                < RECENTER * window.bin as f64;
            if coarser == 1 {
                best = Some(first);
                if seen < WIDER * blur_px && stayed {
                    break;
                }
                blur_px = blur_px.max(seen);
            }
            (origin, coarser) = (center, 1);
        }
        best
    }

    /// Start values for the next corner, from the one just fitted.
    fn as_before(&self, fitted: &Fitted) -> Before {
        let model = &fitted.fit.model;
        let [minus, plus] = self.quarter_means;
        let half = ((plus - minus) / 2.0).abs().max(0.5);
        Before {
            blur_px: fitted.blur_px(),
            contrast: (model.amplitude.abs() / half).clamp(1.0, 2.0),
            offset: ((model.level - (plus + minus) / 2.0) / half).clamp(-0.3, 0.3),
            gamma_term: (model.gamma_term / half).clamp(-0.3, 0.3),
        }
    }

    fn fit_in(&mut self, image: GrayView<'_>, window: Window, before: &Before) -> Option<Fitted> {
        self.gather(image, &window)?;
        let start = self.start(&window, before)?;
        // The noise is not known yet: black and white are taken as equally noisy; the scale does
        // not matter.
        let noise = Noise { black: 1.0, white: 1.0, tolerance: 0.3 * start.amplitude.abs() + 6.0 };
        // The first step may leave the position and still find black, white and blur.
        let options = FitOptions { iterations: [2, 8], enough: 0.07, alike: 0.25, with_flat: true };
        self.fit(window, start, &noise, &options)
    }

    /// The second fit, in a large window near the edges, with the board's priors.
    fn fit_within_board(
        &mut self,
        image: GrayView<'_>,
        corner: &GridCorner,
        first: &Fitted,
        (noise, beside): ([f64; 2], Beside<'_>),
    ) -> Option<Fitted> {
        let free = if beside.print.is_some() { 1.0 } else { 1.0 - self.taken };
        let axes = axes_of(corner)?;
        let window = Window::new(first.center(), axes, first.blur_px(), (SECOND_REACH, free));
        let window = window.along_edges(first.fit.model.along, first.blur_px());
        self.gather(image, &window)?;
        let bin = window.bin as f64;
        let mut start = first.fit.model.rescaled(first.window.bin as f64, bin);
        let around = self.lattice.surroundings(corner.index, first.window.axes);
        start.center = [0.0; 2];
        start.curvature = around.curvature.map(|c| c * bin);
        start.gradient = around.light_gradient.map(|g| g * bin);
        if let Some((slot, Nearby { print, blur, power })) = beside.print
            && self.patch.render(print, slot, &window, blur)
        {
            self.patch.take_off(&mut self.samples, &start, power);
        }
        let [black, white] = noise.map(|std| std / bin);
        let noise = Noise {
            black,
            white,
            tolerance: 4.0 * black.max(white) + 0.08 * start.amplitude.abs(),
        };
        let options = FitOptions {
            iterations: [1, 4],
            enough: 0.05,
            alike: 0.0,
            with_flat: beside.print.is_some(),
        };
        let second = self.fit(window, start, &noise, &options)?;
        if beside.shaded {
            return self.fit_shaded(window, second.fit.model, &noise, &options);
        }
        if second.inlier_ratio > MOST_AGREE {
            return Some(second);
        }
        // Many outliers may belong to another corner or a hand, or the start was too far off for so
        // narrow a tolerance.
        let patient = Noise { tolerance: noise.tolerance + 0.3 * start.amplitude.abs(), ..noise };
        let start = self
            .fit(window, start, &patient, &FitOptions { iterations: [2, 8], ..options })?
            .fit
            .model;
        self.fit(window, start, &noise, &options)
    }

    /// Fits of a corner under light of its own, each after more of that is taken off.
    fn fit_shaded(
        &mut self,
        window: Window,
        mut model: CornerModel,
        noise: &Noise,
        options: &FitOptions,
    ) -> Option<Fitted> {
        let reach = [0, 1].map(|k| window.extent[k] * length(window.axes[k]) / window.bin as f64);
        let amplitude = model.amplitude.abs();
        for tolerance in SHADED_TOLERANCES {
            let patient = Noise { tolerance: noise.tolerance + tolerance * amplitude, ..*noise };
            let options = FitOptions { iterations: [1, 4], ..*options };
            model = self.fit(window, model, &patient, &options)?.fit.model;
            take_off_shading(&mut self.samples, &self.columns, reach[0].max(reach[1]));
        }
        self.fit(window, model, noise, options)
    }

    /// Records corner `slot`'s difference between the near and far edge offsets, normalized by its
    /// predicted variance.
    fn note_scatter(&mut self, slot: usize, fitted: &Fitted) {
        let Fitted { window, fit, noise, .. } = fitted;
        let reach = [0, 1].map(|k| window.extent[k] * length(window.axes[k]) / window.bin as f64);
        for apart in
            disagreements(&self.samples, &fit.model, reach, &self.columns).into_iter().flatten()
        {
            self.scatter.take(slot, noise.corrected_disagreement(apart) / fit.mean_square);
        }
    }

    fn gather(&mut self, image: GrayView<'_>, window: &Window) -> Option<()> {
        (self.samples.gather(image, window) > 0.5 && self.samples.count >= FEWEST_SAMPLES)
            .then_some(())
    }

    fn fit(
        &mut self,
        window: Window,
        start: CornerModel,
        noise: &Noise,
        options: &FitOptions,
    ) -> Option<Fitted> {
        let fit = fit(&self.samples, start, noise, options, &mut self.columns)?;
        Some(Fitted {
            window,
            fit,
            noise: *noise,
            inlier_ratio: fit.residuals.effective / self.samples.count as f64,
        })
    }

    /// The model before the first fit: along the axes, with black and white from the means of the
    /// four quadrants, corrected as at the corner before.
    fn start(&mut self, window: &Window, before: &Before) -> Option<CornerModel> {
        let bin = window.bin as f64;
        let along = window.axes.map(|axis| axis.map(|v| v / length(axis)));
        self.quarter_means = self.samples.quarter_means(along);
        let [minus, plus] = self.quarter_means;
        let sigma = (before.blur_px * before.blur_px + PIXEL_VARIANCE * bin * bin).sqrt() / bin;
        let amplitude = (plus - minus) / 2.0;
        (amplitude.abs() > 0.5).then_some(CornerModel {
            center: [0.0; 2],
            along,
            sharpness: [1.0 / sigma; 2],
            curvature: [0.0; 2],
            level: (plus + minus) / 2.0 + before.offset * amplitude.abs(),
            amplitude: before.contrast * amplitude,
            gamma_term: before.gamma_term * amplitude.abs(),
            gradient: [0.0; 2],
        })
    }
}

/// What neighboring corners have in common. The last three are in units of half the difference of
/// the quadrants' means, which blur makes smaller than that of black and white.
#[derive(Debug, Clone, Copy)]
struct Before {
    blur_px: f64,
    /// The model's amplitude, without its sign.
    contrast: f64,
    /// Its level less the mean of the quarters' means.
    offset: f64,
    gamma_term: f64,
}

/// What is printed beside the corners, and how blurred it is.
#[derive(Clone, Copy)]
struct Nearby<'a> {
    print: &'a dyn BoardPrint,
    blur: PrintBlur,
    /// The camera's gray values to this power are in proportion to light.
    power: f64,
}

/// What is beside a corner.
#[derive(Clone, Copy)]
struct Beside<'a> {
    print: Option<(usize, Nearby<'a>)>,
    /// Light of its own.
    shaded: bool,
}

/// Whether a corner's edge halves are compared: of many corners, every other one is enough.
fn is_compared(corners: &[GridCorner], corner: &GridCorner) -> bool {
    corners.len() < ENOUGH_CORNERS || (corner.index.col + corner.index.row) % 2 == 0
}

impl Fitted {
    fn center(&self) -> [f64; 2] {
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
        let model = &self.fit.model;
        let white = (model.level + model.amplitude.abs()).max(1.0).ln();
        Known { at: self.center(), along: model.along, white }
    }

    /// Whether the fit has converged to something that explains most of the contrast.
    fn has_settled(&self) -> bool {
        self.inlier_ratio > 0.4 && self.fit.last_step < 0.3
    }

    /// Whether this may be the requested corner.
    fn may_be_corner(&self, corner: &GridCorner) -> bool {
        let [x, y] = self.center();
        let cell = self.window.axes.map(length).into_iter().fold(f64::INFINITY, f64::min);
        let moved = length([x - corner.pixel.x, y - corner.pixel.y]);
        let model = &self.fit.model;
        moved < (0.4 * cell).min(f64::max(3.0, 0.08 * cell))
            && model.amplitude.abs() > 1.0
            && model.correlation().abs() < 0.985
    }

    /// Whether the second fit is accepted. True corners keep a margin to each bound in the worst
    /// conditions (motion blur over several pixels, heavy noise); of other positions in images of
    /// boards one in a hundred passes.
    fn is_corner(&self, corner: &GridCorner) -> bool {
        let model = &self.fit.model;
        self.may_be_corner(corner)
            && self.inlier_ratio > 0.42
            && self.fit.last_step < 0.25
            && model.gamma_term.abs() < model.amplitude.abs()
            && self.fit.residual_rms < 0.6 * model.amplitude.abs()
    }

    fn quality(&self) -> Quality {
        let samples = self.fit.residuals.effective.max(1.0);
        Quality { mean_square: self.fit.mean_square, inlier_ratio: self.inlier_ratio, samples }
    }

    /// The covariance of the position for a mean variance of 1 per axis.
    fn shape(&self) -> [f64; 3] {
        let [xx, xy, yy] = self.fit.covariance;
        [xx, xy, yy].map(|v| v / ((xx + yy) / 2.0))
    }

    fn refined(&self) -> RefinedCorner {
        let [x, y] = self.center();
        RefinedCorner {
            pixel: Pixel::new(x, y),
            std_px: self.fit.position_std() * self.window.bin as f64,
            blur_px: self.blur_px(),
            contrast: 2.0 * self.fit.model.amplitude.abs(),
        }
    }
}
