//! The second fit of a corner: in a large window, with the edges' curvature, the light and the
//! noise estimated from the whole board.

use crate::detection::refine::corner_model::{CornerModel, length};
use crate::detection::refine::fit::{FitOptions, position_covariance};
use crate::detection::refine::fitted::Fitted;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::lattice::axes_of;
use crate::detection::refine::local_light::LocalLightFit;
use crate::detection::refine::normal_equations::{CornerEquations, Linearized, Noise};
use crate::detection::refine::refiner::Refiner;
use crate::detection::refine::shading::{joint_step, take_off_shading};
use crate::detection::refine::window::Window;
use crate::detection::refine::window_context::{LocalLightCriterion, NearbyPrint, WindowContext};
use crate::imaging::gray::GrayView;

impl Refiner {
    /// The second fit, in a large window along the edges, with the board's priors.
    pub(super) fn fit_within_board(
        &mut self,
        image: GrayView<'_>,
        corner: &GridCorner,
        first: &Fitted,
        noise: [f64; 2],
        context: WindowContext<'_>,
    ) -> Option<Fitted> {
        let free = if context.print.is_some() { 1.0 } else { 1.0 - self.taken };
        let axes = axes_of(corner)?;
        let window =
            Window::new(first.center(), axes, first.blur_px(), self.thresholds.second_reach, free);
        let window = window.along_edges(first.fit.model.along, first.blur_px());
        self.gather(image, &window)?;
        let bin = window.bin as f64;
        let mut start = first.fit.model.rescaled(first.window.bin as f64, bin);
        let around = self.lattice.prior_of(corner.index, first.window.axes);
        start.center = [0.0; 2];
        start.curvature = around.curvature.map(|c| c * bin);
        start.gradient = around.light_gradient.map(|g| g * bin);
        if let Some((slot, NearbyPrint { print, rendering })) = context.print
            && self.patch.render(print, slot, &window, rendering.blur)
        {
            self.patch.take_off(&mut self.samples, &start, rendering.power);
        }
        let [black, white] = noise.map(|std| std / bin);
        let noise = Noise {
            black,
            white,
            tolerance: self.thresholds.second_tolerance_stds * black.max(white)
                + self.thresholds.second_tolerance * start.amplitude.abs(),
        };
        let options = FitOptions {
            iterations: [1, 4],
            enough: self.thresholds.second_enough,
            alike: 0.0,
            with_flat: context.print.is_some(),
        };
        let second = self.fit(window, start, &noise, &options)?;
        let lit = context.light.and_then(|light| self.fit_lit(window, &second, &noise, light));
        if context.shaded {
            let shaded = self.fit_shaded(window, second.fit.model, &noise, &options);
            return [lit, shaded]
                .into_iter()
                .flatten()
                .min_by(|a, b| a.fit.mean_square.total_cmp(&b.fit.mean_square));
        }
        if lit.is_some() {
            return lit;
        }
        if second.inlier_ratio > self.thresholds.clear_inliers {
            return Some(second);
        }
        // Many outliers: another corner or a hand may be in the window, or the start was too far
        // off for so narrow a tolerance.
        let patient = Noise {
            tolerance: noise.tolerance + self.thresholds.patient_tolerance * start.amplitude.abs(),
            ..noise
        };
        let start = self
            .fit(window, start, &patient, &FitOptions { iterations: [2, 8], ..options })?
            .fit
            .model;
        self.fit(window, start, &noise, &options)
    }

    /// A fit of a corner and its own light; `None` where its mean square is hardly less than that
    /// of `second`, the fit under the board's light.
    fn fit_lit(
        &mut self,
        window: Window,
        second: &Fitted,
        noise: &Noise,
        light: LocalLightCriterion,
    ) -> Option<Fitted> {
        let corner_and_light = LocalLightFit {
            samples: &self.samples,
            noise,
            tolerances: &self.thresholds.shaded_tolerances,
            reach: reach(&window),
            power: light.power,
            enough: self.thresholds.second_enough,
        };
        let fit = corner_and_light.fit(second.fit.model, &mut self.lit_columns)?;
        let inlier_ratio = fit.residuals.effective / self.samples.count as f64;
        let lit = Fitted { window, fit, noise: *noise, inlier_ratio, lit: true };
        (fit.mean_square < light.most_left * second.fit.mean_square).then_some(lit)
    }

    /// Alternates fits of a corner with estimates of its own light, which is subtracted; the last
    /// step solves for both together.
    fn fit_shaded(
        &mut self,
        window: Window,
        mut model: CornerModel,
        noise: &Noise,
        options: &FitOptions,
    ) -> Option<Fitted> {
        let reach = reach(&window);
        let amplitude = model.amplitude.abs();
        for tolerance in self.thresholds.shaded_tolerances {
            let patient = Noise { tolerance: noise.tolerance + tolerance * amplitude, ..*noise };
            let options = FitOptions { iterations: [1, 4], ..*options };
            model = self.fit(window, model, &patient, &options)?.fit.model;
            take_off_shading(&mut self.samples, &self.columns, reach);
        }
        let mut fitted = self.fit(window, model, noise, options)?;
        let mut equations = CornerEquations::default();
        let linearized = Linearized { samples: &self.samples, noise, with_flat: false };
        linearized.at(&fitted.fit.model, &mut self.columns, &mut equations);
        let joint = joint_step(&mut self.samples, &self.columns, reach, amplitude)?;
        fitted.fit.model = fitted.fit.model.moved_by(&joint.step);
        fitted.fit.covariance = position_covariance(joint.offset_covariance, &fitted.fit.model);
        Some(fitted)
    }
}

/// Half the extent of a window, in samples.
fn reach(window: &Window) -> f64 {
    let along = |k: usize| window.extent[k] * length(window.axes[k]) / window.bin as f64;
    along(0).max(along(1))
}
