//! The refinement of a board's corners: two fits of each, compared and combined over the board.

use crate::detection::refine::alignment::AlignedSamples;
use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::corner_std::CornerStd;
use crate::detection::refine::edge_curvature::{ExcessCurvature, edge_curvatures};
use crate::detection::refine::fit::{FitOptions, fit};
use crate::detection::refine::fitted::Fitted;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::halves::disagreements;
use crate::detection::refine::lattice::{FittedCorner, Lattice};
use crate::detection::refine::misfit::CornerMisfit;
use crate::detection::refine::noise::PooledNoise;
use crate::detection::refine::normal_equations::{ModelColumns, Noise};
use crate::detection::refine::print::{BoardPrint, PrintPatch};
use crate::detection::refine::refined_corner::RefinedCorner;
use crate::detection::refine::samples::Samples;
use crate::detection::refine::scatter::Scatter;
use crate::detection::refine::straightness::{Placed, Straightness};
use crate::detection::refine::window::Window;
use crate::detection::refine::window_context::{LocalLightCriterion, NearbyPrint, WindowContext};
use crate::detection::thresholds::refinement::RefinementThresholds;
use crate::geometry::median::median_of;
use crate::geometry::pixel::Pixel;
use crate::imaging::gray::GrayView;

/// Refines corners; its buffers are reused from call to call.
#[derive(Debug, Default)]
pub struct Refiner {
    pub(super) thresholds: RefinementThresholds,
    /// The fraction of the way to the neighbors that other edges occupy.
    pub(super) taken: f64,
    pub(super) samples: Samples,
    pub(super) columns: ModelColumns,
    /// The same for fits with light of a corner's own.
    pub(super) lit_columns: ModelColumns,
    pub(super) lattice: Lattice,
    pub(super) noise: PooledNoise,
    pub(super) scatter: Scatter,
    pub(super) misfit: CornerMisfit,
    pub(super) straightness: Straightness,
    /// Each corner's factor from its misfit; `None` if it is rejected.
    pub(super) misfit_factors: Vec<Option<f64>>,
    /// The factors of each corner's standard deviation.
    pub(super) stds: Vec<CornerStd>,
    /// The covariance of each corner in units of the square of its standard deviation: xx, xy, yy.
    pub(super) shapes: Vec<[f64; 3]>,
    /// The order of the first fits.
    pub(super) order: Vec<usize>,
    pub(super) fitted: Vec<Option<Fitted>>,
    pub(super) known: Vec<Option<FittedCorner>>,
    /// For each corner, the excess curvature of its edges in its own window.
    edge_curvatures: Vec<[Option<ExcessCurvature>; 2]>,
    /// Variances of the first fits' positions.
    variances_px2: Vec<f64>,
    pub(super) patch: PrintPatch,
    pub(super) aligned: AlignedSamples,
    /// The present positions of the corners.
    pub(super) placed: Vec<Option<Pixel>>,
    /// Widths of the blur at the corners.
    pub(super) blurs_px: Vec<f64>,
    pub(super) powers: Vec<f64>,
    /// For each corner, whether it fits worse than the others: it may have light of its own.
    pub(super) shaded: Vec<bool>,
    /// The same relative to the corners that fit best.
    may_be_lit: Vec<bool>,
    /// For each corner, when a second fit with light of its own is accepted; `None`: none is tried.
    light: Vec<Option<LocalLightCriterion>>,
    /// For each corner, its second fit if that has light of its own.
    lit: Vec<Option<Fitted>>,
    /// The mean gray values of the two pairs of quadrants in the last window of a first fit.
    pub(super) quarter_means: [f64; 2],
}

impl Refiner {
    /// A refiner with empty buffers.
    pub fn new(thresholds: RefinementThresholds) -> Self {
        Self { thresholds, ..Self::default() }
    }

    /// A refiner for boards whose next edges lie at this fraction of the way to the given
    /// neighbors.
    pub fn with_room(room: f64, thresholds: RefinementThresholds) -> Self {
        Self { taken: 1.0 - room, thresholds, ..Self::default() }
    }

    /// Refines each of `corners` of one board in `image` into `refined`, in their order, replacing
    /// its content. `None`: the image shows no chessboard corner there, or does not determine its
    /// position. Does not allocate after a board of the same size.
    pub fn refine(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        refined: &mut Vec<Option<RefinedCorner>>,
    ) {
        self.refine_printed(image, corners, None, refined);
    }

    /// The same for a board with more print than its corners' edges. Returns true if blur merges
    /// edges so much that all corners come from aligning the whole print: then a corner that is
    /// `None` is not visible.
    pub fn refine_printed(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        print: Option<&mut dyn BoardPrint>,
        refined: &mut Vec<Option<RefinedCorner>>,
    ) -> bool {
        self.fit_each(image, corners);
        self.compare_fits();
        self.lattice.fill(corners, &self.known);
        if print.is_none() {
            self.shaded.fill(false);
            self.may_be_lit.fill(false);
        }
        let mut print = print;
        let rendering = print.as_deref_mut().and_then(|it| self.fit_printed(image, corners, it));
        let nearby_print = print
            .as_deref()
            .zip(rendering)
            .map(|(print, rendering)| NearbyPrint { print, rendering });
        self.fit_edges(image, corners, nearby_print, refined);
        let rendering = rendering.or_else(|| self.rendering_of_unrefined(refined));
        let (Some(print), Some(rendering)) = (print, rendering) else { return false };
        self.align_print(image, corners, print, rendering, refined)
    }

    /// The second fits of all corners, and the constraints from the board.
    fn fit_edges(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        nearby_print: Option<NearbyPrint<'_>>,
        refined: &mut Vec<Option<RefinedCorner>>,
    ) {
        // Print that blur brings into windows is removed under the board's light only.
        let may_be_lit = nearby_print.is_none() && self.may_be_lit.contains(&true);
        let power = if may_be_lit { self.median_power() } else { None };
        let light = |most_left| power.map(|power| LocalLightCriterion { power, most_left });
        let alone = light(self.thresholds.lit_alone);
        self.light.clear();
        self.light.extend(self.may_be_lit.iter().map(|&may| alone.filter(|_| may)));
        let fitted = std::mem::take(&mut self.fitted);
        self.lit.clear();
        self.lit.resize(corners.len(), None);
        self.fit_each_again(image, corners, &fitted, nearby_print, refined);
        let lit = self.lit.iter().flatten().count();
        if lit > 0 {
            let in_highlight = light(self.thresholds.lit_in_highlight);
            if lit < self.thresholds.fewest_lit {
                self.light.fill(None);
                self.lit.fill(None);
            } else {
                self.light.fill(in_highlight);
            }
            self.fit_each_again(image, corners, &fitted, nearby_print, refined);
        }
        self.fitted = fitted;
        self.curve_edges(corners, refined);
        self.set_stds(refined);
    }

    /// The second fit of each corner, except for those already fitted with light of their own.
    fn fit_each_again(
        &mut self,
        image: GrayView<'_>,
        corners: &[GridCorner],
        fitted: &[Option<Fitted>],
        nearby_print: Option<NearbyPrint<'_>>,
        refined: &mut Vec<Option<RefinedCorner>>,
    ) {
        let noise = self.noise.of_pixels();
        refined.clear();
        self.misfit.clear();
        self.scatter.clear();
        self.straightness.clear();
        self.shapes.clear();
        self.edge_curvatures.clear();
        for (slot, (corner, first)) in corners.iter().zip(fitted).enumerate() {
            let (shaded, light) = (self.shaded[slot], self.light[slot]);
            let context = WindowContext { print: nearby_print.map(|it| (slot, it)), shaded, light };
            let second = self.lit[slot].or_else(|| {
                let first = first.as_ref()?;
                let second = self.fit_within_board(image, corner, first, noise, context)?;
                second.is_corner(corner, &self.thresholds).then_some(second)
            });
            self.lit[slot] = second.filter(|second| second.lit);
            self.misfit.take(second.as_ref().map(Fitted::quality));
            // Residuals under light of its own do not represent the board.
            let plain = second.as_ref().filter(|second| !second.lit);
            if let Some(second) = plain {
                self.note_scatter(refined.len(), second);
            }
            self.edge_curvatures.push(plain.map_or([None; 2], |second| {
                edge_curvatures(&self.samples, &self.columns, &second.fit, &second.window)
            }));
            self.shapes.push(second.as_ref().map_or([1.0, 0.0, 1.0], Fitted::shape));
            if let Some(second) = &second {
                self.straightness.note_window(second.window.extent);
            }
            refined.push(second.as_ref().map(Fitted::refined));
        }
    }

    /// Moves corners by the excess curvature of their edges over that of the second fit, estimated
    /// from the windows of all corners and the first fits' positions.
    fn curve_edges(&mut self, corners: &[GridCorner], refined: &mut [Option<RefinedCorner>]) {
        let Self { fitted, variances_px2, edge_curvatures, lattice, .. } = self;
        variances_px2.clear();
        variances_px2.extend(fitted.iter().flatten().map(|first| first.refined().std_px.powi(2)));
        let Some(variance_px2) = median_of(variances_px2) else { return };
        for axis in 0..2 {
            let own = corners.iter().zip(edge_curvatures.iter());
            let own = own.filter_map(|(corner, own)| Some((corner.index, own[axis]?)));
            let Some(field) = lattice.curvature_with_own(axis, variance_px2, own) else { continue };
            for ((corner, own), refined) in
                corners.iter().zip(edge_curvatures.iter()).zip(&mut *refined)
            {
                let (Some(own), Some(refined)) = (own[axis], refined) else { continue };
                let beyond = lattice.beyond(axis, &field, corner.index);
                refined.pixel.x += beyond * own.move_px2[0];
                refined.pixel.y += beyond * own.move_px2[1];
            }
        }
    }

    /// Updates `known` from the corners that fit as well as the others.
    pub(super) fn compare_fits(&mut self) {
        self.misfit.clear();
        self.fitted
            .iter()
            .for_each(|fitted| self.misfit.take(fitted.as_ref().map(Fitted::quality)));
        self.shaded.clear();
        self.shaded.extend(self.misfit.worse_than(self.thresholds.shaded));
        self.may_be_lit.clear();
        self.may_be_lit.extend(self.misfit.worse_than_closest(self.thresholds.may_be_lit));
        self.known.clear();
        let fits = self.misfit.fits();
        self.known.extend(
            self.fitted
                .iter()
                .zip(fits)
                .map(|(fitted, fits)| fitted.as_ref().filter(|_| fits).map(Fitted::known)),
        );
    }

    /// Sets each corner's standard deviation to the product of its factors; a corner that fits far
    /// worse than the others becomes `None`.
    pub(super) fn set_stds(&mut self, refined: &mut [Option<RefinedCorner>]) {
        self.misfit_factors.clear();
        self.misfit_factors.extend(self.misfit.std_factors());
        let scatter = self.scatter.std_factor(&self.misfit_factors);
        self.stds.clear();
        for (slot, (corner, misfit)) in refined.iter_mut().zip(&self.misfit_factors).enumerate() {
            *corner = corner.filter(|_| misfit.is_some());
            // The residuals under the board's light do not represent fits under other light.
            let scatter = if self.misfit.has_own_light(slot) { 1.0 } else { scatter };
            let fit_px = corner.map_or(0.0, |corner| corner.std_px);
            let misfit = misfit.unwrap_or(1.0);
            self.stds.push(CornerStd { fit_px, misfit, scatter, straightness: 1.0 });
        }
        let straightness = self.straightness_of(refined);
        for (corner, std) in refined.iter_mut().zip(&self.stds) {
            let std = CornerStd { straightness, ..*std };
            corner.iter_mut().for_each(|corner| corner.std_px = std.px());
        }
    }

    /// The factor on standard deviations, from the corners' scatter about the board's lines and
    /// what `stds` predict of it.
    fn straightness_of(&mut self, refined: &[Option<RefinedCorner>]) -> f64 {
        for axis in 0..2 {
            let lines = self.lattice.lines(axis).map(|(place, line)| {
                let (shapes, stds) = (&self.shapes, &self.stds);
                let placed = line.filter_map(move |slot| {
                    let (pixel, std_px) = (refined[slot]?.pixel, stds[slot].px());
                    let covariance = shapes[slot].map(|share| share * std_px * std_px);
                    Some(Placed { pixel, covariance })
                });
                (place, placed)
            });
            self.straightness.take(axis, lines);
        }
        self.straightness.std_factor()
    }

    /// Records corner `slot`'s difference between the near and far edge offsets, normalized by its
    /// predicted variance.
    fn note_scatter(&mut self, slot: usize, fitted: &Fitted) {
        let Fitted { window, fit, noise, .. } = fitted;
        let reach = [0, 1].map(|k| window.extent[k] * length(window.axes[k]) / window.bin as f64);
        for disagreement in
            disagreements(&self.samples, &fit.model, reach, &self.columns).into_iter().flatten()
        {
            self.scatter.take(slot, noise.corrected_disagreement(disagreement) / fit.mean_square);
        }
    }

    pub(super) fn gather(&mut self, image: GrayView<'_>, window: &Window) -> Option<()> {
        (self.samples.gather(image, window) > self.thresholds.least_inside
            && self.samples.count >= self.thresholds.fewest_samples)
            .then_some(())
    }

    pub(super) fn fit(
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
            lit: false,
        })
    }
}
