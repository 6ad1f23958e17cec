//! Refinement of a board whose edges blur into each other: each corner is placed where the rendered
//! print around it matches the image best (`alignment`), and the print is placed by all corners.

use crate::detection::refine::alignment::{Alignment, PrintLight};
use crate::detection::refine::corner_model::length;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::lattice::{FittedCorner, axes_of};
use crate::detection::refine::misfit::Quality;
use crate::detection::refine::print::{BoardPrint, PrintPatch};
use crate::detection::refine::print_blur::{PrintBlur, PrintRendering};
use crate::detection::refine::refined_corner::RefinedCorner;
use crate::detection::refine::refiner::Refiner;
use crate::detection::refine::window::Window;
use crate::detection::refine::window_context::NearbyPrint;
use crate::detection::thresholds::refinement::RefinementThresholds;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Rounds of alignment after which the blur is estimated again: the first round starts from fits of
/// edges.
const BLUR_ROUNDS: usize = 2;
/// The rounds end once the mean square of the corners' moves is below this fraction of their
/// variance: a move of a tenth of a standard deviation adds half a percent to the standard error.
const RESTING_VARIANCE_PART: f64 = 0.01;

/// An alignment in its window.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aligned {
    window: Window,
    fit: Alignment,
    blur_px: f64,
}

impl Refiner {
    /// Aligns the print with the image, starting from the present corners. Corners of `refined`
    /// that are less certain are replaced; if that is more than half of them, all are, since edges
    /// that blur into each other are taken for others and their fit states too small a standard
    /// deviation. Returns whether all are replaced.
    pub(super) fn align_print(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        print: &mut dyn BoardPrint,
        mut rendering: PrintRendering,
        refined: &mut Vec<Option<RefinedCorner>>,
    ) -> bool {
        let mut aligned: Vec<Option<Aligned>> = Vec::with_capacity(corners.len());
        let mut is_searched = false;
        for round in 0..self.thresholds.aligned_rounds {
            self.place(print);
            aligned.clear();
            for (slot, corner) in corners.iter().enumerate() {
                let nearby_print = NearbyPrint { print: &*print, rendering };
                let found = self.align_corner(image, slot, corner, nearby_print);
                aligned.push(found.filter(|it| it.is_corner(corner, &self.thresholds)));
            }
            let is_mistaken = 2 * aligned.iter().flatten().count() < corners.len();
            if is_mistaken && !is_searched {
                is_searched = true;
                let nearby_print = NearbyPrint { print: &*print, rendering };
                rendering = self.rendering_of_any_width(image, corners, nearby_print);
                continue;
            }
            self.know_aligned(&aligned);
            self.lattice.fill(corners, &self.known);
            if round < BLUR_ROUNDS {
                let nearby_print = NearbyPrint { print: &*print, rendering };
                rendering = match round {
                    0 => self.aligned_rendering(image, corners, nearby_print),
                    _ => self.aligned_again(image, corners, nearby_print),
                };
            } else if self.rests(&aligned) {
                break;
            }
        }
        let by_edges = std::mem::take(refined);
        self.scatter.clear();
        self.straightness.clear();
        self.shapes.clear();
        for (aligned, corner) in aligned.iter().zip(corners) {
            self.shapes.push(aligned.as_ref().map_or([1.0, 0.0, 1.0], Aligned::shape));
            for difference in aligned.iter().filter_map(|it| it.fit.disagreements).flatten() {
                let mean_square = aligned.map_or(1.0, |it| it.fit.mean_square);
                self.scatter.take(refined.len(), difference / mean_square);
            }
            if let (Some(aligned), Some(axes)) = (aligned, axes_of(corner)) {
                let reach_px = aligned.window.extent[0];
                self.straightness.note_window(axes.map(|axis| reach_px / length(axis)));
            }
            refined.push(aligned.as_ref().map(Aligned::refined));
        }
        self.set_stds(refined);
        let std_px = |it: &Option<RefinedCorner>| it.map_or(f64::INFINITY, |it| it.std_px);
        let better =
            by_edges.iter().zip(&*refined).filter(|(edges, it)| std_px(it) < std_px(edges));
        let is_better = 2 * better.count() > corners.len();
        if !is_better {
            let both = refined.iter_mut().zip(by_edges);
            let surer = both.filter(|(aligned, edges)| std_px(edges) < std_px(aligned));
            surer.for_each(|(aligned, edges)| *aligned = edges);
        }
        is_better
    }

    /// Whether the alignments moved the corners by less than chance does: the mean square of the
    /// moves is below a hundredth of the mean variance.
    fn rests(&self, aligned: &[Option<Aligned>]) -> bool {
        let (mut moves, mut variances) = (0.0, 0.0);
        for (aligned, placed) in aligned.iter().zip(&self.placed) {
            let (Some(aligned), Some(placed)) = (aligned, placed) else { continue };
            let refined = aligned.refined();
            moves += refined.pixel.distance_px(*placed).powi(2);
            variances += 2.0 * refined.std_px.powi(2);
        }
        moves < RESTING_VARIANCE_PART * variances
    }

    /// Updates what is known of the corners from alignments that fit as well as the others.
    fn know_aligned(&mut self, aligned: &[Option<Aligned>]) {
        self.misfit.clear();
        aligned.iter().for_each(|it| self.misfit.take(it.as_ref().map(Aligned::quality)));
        for ((known, aligned), fits) in self.known.iter_mut().zip(aligned).zip(self.misfit.fits()) {
            let along = known.map_or([[1.0, 0.0], [0.0, 1.0]], |known| known.along);
            *known = aligned.filter(|_| fits).map(|aligned| FittedCorner {
                at: aligned.center(),
                along,
                white: aligned.fit.grays[1].max(1.0).ln(),
            });
        }
    }

    fn align_corner(
        &mut self,
        image: GrayView<'_>,
        slot: usize,
        corner: &GridCorner,
        NearbyPrint { print, rendering }: NearbyPrint<'_>,
    ) -> Option<Aligned> {
        let reach_px = self.aligned_reach_px(rendering.blur);
        let bin = if PrintPatch::covers(rendering.blur, reach_px) { 1 } else { 2 };
        let (window, light) = self.surroundings(corner, print.expected(slot)?, rendering, bin)?;
        self.patch.draw(print, slot, &window, rendering.blur);
        let inside = self.aligned.gather(image, &self.patch, &window, &light);
        let fit = self.aligned.align(&light).filter(|_| inside > self.thresholds.least_inside)?;
        Some(Aligned { window, fit, blur_px: rendering.blur.width_px() })
    }

    fn aligned_reach_px(&self, blur: PrintBlur) -> f64 {
        self.thresholds.aligned_reach * blur.width_px().max(self.thresholds.least_aligned_blur_px)
    }

    /// The window of `corner` around `origin` in samples of `bin` pixels, and what is known of the
    /// light there.
    pub(super) fn surroundings(
        &mut self,
        corner: &GridCorner,
        origin: [f64; 2],
        PrintRendering { blur, power }: PrintRendering,
        bin: usize,
    ) -> Option<(Window, PrintLight)> {
        let limits = &self.thresholds;
        let window = Window {
            origin,
            axes: [[1.0, 0.0], [0.0, 1.0]],
            extent: [self.aligned_reach_px(blur); 2],
            strip_px: f64::INFINITY,
            bin,
        };
        if !PrintPatch::can_render(blur, window.bin) {
            return None;
        }
        let bin = window.bin as f64;
        let known = self.lattice.prior_of(corner.index, axes_of(corner)?);
        let light = PrintLight {
            power,
            noise: self.noise.of_pixels().map(|std| std / bin),
            gradient: known.light_gradient.map(|g| g * bin),
            tolerance: (
                limits.second_tolerance_stds,
                [limits.second_tolerance + limits.patient_tolerance, limits.second_tolerance],
            ),
        };
        Some((window, light))
    }
}

impl Aligned {
    fn center(&self) -> [f64; 2] {
        [0, 1].map(|k| self.window.origin[k] + self.window.bin as f64 * self.fit.offset[k])
    }

    /// Whether it passes the tests that a fit of two edges has to pass.
    fn is_corner(&self, corner: &GridCorner, limits: &RefinementThresholds) -> bool {
        let Some(axes) = axes_of(corner) else { return false };
        let cell = axes.map(length).into_iter().fold(f64::INFINITY, f64::min);
        let [x, y] = self.center();
        let moved = length([x - corner.pixel.x, y - corner.pixel.y]);
        let amplitude = (self.fit.grays[1] - self.fit.grays[0]) / 2.0;
        moved
            < (limits.most_moved * cell)
                .min(f64::max(limits.always_moved_px, limits.always_moved * cell))
            && amplitude > limits.least_amplitude
            && self.fit.inlier_ratio > limits.least_inliers
            && self.fit.last_step < limits.most_step
    }

    fn quality(&self) -> Quality {
        Quality {
            mean_square: self.fit.mean_square,
            inlier_ratio: self.fit.inlier_ratio,
            samples: self.fit.samples,
            local_light: false,
        }
    }

    fn shape(&self) -> [f64; 3] {
        let [xx, xy, yy] = self.fit.covariance;
        [xx, xy, yy].map(|v| v / ((xx + yy) / 2.0))
    }

    fn refined(&self) -> RefinedCorner {
        let [x, y] = self.center();
        let [xx, _, yy] = self.fit.covariance;
        let std = ((xx + yy) / 2.0 * self.fit.mean_square).sqrt();
        RefinedCorner {
            pixel: Pixel::new(x, y),
            std_px: std * self.window.bin as f64,
            blur_px: self.blur_px,
            contrast: self.fit.grays[1] - self.fit.grays[0],
        }
    }
}
