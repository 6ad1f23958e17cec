//! The search of the blur and the gamma with which the rendered board matches the image best.

use crate::detection::refine::alignment::{AlignedSamples, PrintLight};
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::print::PrintPatch;
use crate::detection::refine::print_blur::{PrintBlur, PrintRendering, least_near};
use crate::detection::refine::refined_corner::RefinedCorner;
use crate::detection::refine::refiner::Refiner;
use crate::detection::refine::transfer::POWERS;
use crate::detection::refine::window::Window;
use crate::detection::refine::window_context::NearbyPrint;
use crate::imaging::gray::GrayView;

/// The misfit, as a mean square in units of the noise, of a print that cannot be aligned: greater
/// than that of any that can.
const NO_PRINT: f64 = 1e6;
/// The most octaves of widths that are searched: there are four from the widest blur that can be
/// rendered to the narrowest motion that can be distinguished. Each search covers half an octave on
/// both sides.
const MOST_OCTAVES: usize = 5;
/// The fraction of the corners that fits of edges must refine to be trusted. Swept: AprilGrids in
/// motion have 0.012 px from 0.75 to 0.9, and 0.030 px at 0.5.
const LEAST_REFINED_SHARE: f64 = 0.75;
/// The differences of the logarithms of width and power over which slopes of the misfit are taken.
/// Swept: ChArUco boards in wide blur have 0.014 px, 0.017 px with half of them and 0.021 px with
/// twice.
const LOG_STEPS: [f64; 2] = [0.03, 0.06];

impl Refiner {
    /// Blur and gamma from the fits of edges, if these refined too few of the corners and the blur
    /// is wide enough to be a motion's.
    pub(super) fn rendering_of_unrefined(
        &mut self,
        refined: &[Option<RefinedCorner>],
    ) -> Option<PrintRendering> {
        let count = refined.iter().flatten().count() as f64;
        let are_few = count < LEAST_REFINED_SHARE * refined.len() as f64;
        let least_px = self.thresholds.least_motion_px;
        self.median_rendering().filter(|it| are_few && it.blur.width_px() >= least_px)
    }

    /// The blur and the gamma with which the print matches the image best at some of the known
    /// corners, near those of `nearby_print`: with any motion, and at most 42 % wider or narrower.
    pub(super) fn aligned_rendering(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        nearby_print: NearbyPrint<'_>,
    ) -> PrintRendering {
        let least_motion_px = self.thresholds.least_motion_px;
        let mut compared = self.compared(image, corners, nearby_print, SampleWeighting::Robust);
        compared.best(nearby_print.rendering, least_motion_px).0
    }

    /// The same with the motion of `nearby_print`.
    pub(super) fn aligned_again(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        nearby_print: NearbyPrint<'_>,
    ) -> PrintRendering {
        self.compared(image, corners, nearby_print, SampleWeighting::Robust)
            .adjusted(nearby_print.rendering)
            .0
    }

    /// The blur and the gamma with which the print matches the image best, where fits of edges
    /// mistake them: two edges that merge are fitted as one that is wider, never narrower. There
    /// are no robust weights: while the blur is wrong, samples that do not match show that, and are
    /// no outliers.
    pub(super) fn rendering_of_any_width(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        NearbyPrint { print, rendering }: NearbyPrint<'_>,
    ) -> PrintRendering {
        let least_motion_px = self.thresholds.least_motion_px;
        let mut width_px = rendering.blur.width_px();
        let mut best = (rendering, f64::INFINITY);
        for _ in 0..MOST_OCTAVES {
            let start = PrintRendering { blur: PrintBlur::round(width_px), ..rendering };
            let nearby_print = NearbyPrint { print, rendering: start };
            let mut compared = self.compared(image, corners, nearby_print, SampleWeighting::All);
            let found = compared.best(start, least_motion_px);
            if found.1 < best.1 {
                best = found;
            }
            width_px /= 2.0;
            if width_px < least_motion_px {
                break;
            }
        }
        best.0
    }

    /// Some of the known corners, with windows for blurs near that of `nearby_print`.
    fn compared<'a>(
        &'a mut self,
        image: GrayView<'a>,
        corners: &[GridCorner],
        NearbyPrint { print, rendering }: NearbyPrint<'_>,
        weighting: SampleWeighting,
    ) -> ComparedCorners<'a> {
        let known = corners.iter().enumerate().filter(|(slot, _)| self.known[*slot].is_some());
        let known: Vec<(usize, &GridCorner)> = known.collect();
        let every = (known.len() / self.thresholds.compared_corners).max(1);
        let is_wide = rendering.blur.width_px() > self.thresholds.coarse_blur_px;
        let bin = if is_wide { 2 } else { 1 };
        let compared = known.iter().step_by(every).filter_map(|&(slot, corner)| {
            let origin = print.expected(slot)?;
            let (window, light) = self.surroundings(corner, origin, rendering, bin)?;
            let mut patch = PrintPatch::default();
            patch.read_for_any(print, slot, &window, rendering.blur);
            Some((patch, window, light))
        });
        let corners = compared.collect();
        ComparedCorners { image, corners, samples: &mut self.aligned, weighting }
    }
}

/// Corners at which renderings are compared.
struct ComparedCorners<'a> {
    image: GrayView<'a>,
    corners: Vec<(PrintPatch, Window, PrintLight)>,
    samples: &'a mut AlignedSamples,
    weighting: SampleWeighting,
}

/// Which samples count in a misfit.
#[derive(Clone, Copy, PartialEq)]
enum SampleWeighting {
    All,
    /// Those that match the print.
    Robust,
}

impl ComparedCorners<'_> {
    /// The rendering with the least misfit near `start`, and the misfit.
    fn best(&mut self, start: PrintRendering, least_motion_px: f64) -> (PrintRendering, f64) {
        let power = start.power;
        let mut of_blur = |blur: PrintBlur| self.misfit(PrintRendering { blur, power });
        let mut blur = start.blur.best_width(&mut of_blur);
        if blur.width_px() >= least_motion_px {
            blur = PrintBlur::best(blur.width_px(), &mut of_blur);
        }
        self.adjusted(PrintRendering { blur, power })
    }

    /// `start` with the width of the blur and the power that have the least misfit, and the misfit.
    fn adjusted(&mut self, start: PrintRendering) -> (PrintRendering, f64) {
        let changed = |[width, power]: [f64; 2]| PrintRendering {
            blur: start.blur.scaled(width.exp()),
            power: (start.power * power.exp()).clamp(POWERS[0], POWERS[1]),
        };
        let (change, misfit) = least_near(LOG_STEPS, &mut |change| self.misfit(changed(change)));
        (changed(change), misfit)
    }

    /// The sum over the corners of their mean squared residuals, in units of the noise.
    fn misfit(&mut self, PrintRendering { blur, power }: PrintRendering) -> f64 {
        let each = self.corners.iter_mut().map(|(patch, window, light)| {
            light.power = power;
            if !patch.blurred(blur, window) {
                return NO_PRINT;
            }
            self.samples.gather(self.image, patch, window, light);
            let mean_square = match self.weighting {
                SampleWeighting::All => self.samples.mean_square_of_all(light),
                SampleWeighting::Robust => self.samples.align(light).map(|it| it.mean_square),
            };
            mean_square.unwrap_or(NO_PRINT)
        });
        each.sum()
    }
}
