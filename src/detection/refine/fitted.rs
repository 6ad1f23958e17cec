//! The fit of one corner, and the tests of whether it is the requested corner.

use crate::detection::refine::corner_model::length;
use crate::detection::refine::fit::CornerFit;
use crate::detection::refine::grid_corner::GridCorner;
use crate::detection::refine::lattice::FittedCorner;
use crate::detection::refine::misfit::Quality;
use crate::detection::refine::normal_equations::Noise;
use crate::detection::refine::refined_corner::RefinedCorner;
use crate::detection::refine::window::{PIXEL_VARIANCE, Window};
use crate::detection::thresholds::refinement::RefinementThresholds;
use crate::geometry::pixel::Pixel;

/// Least variance of the blur, in pixels squared: samples cannot distinguish an edge that is
/// sharper than a tenth of a pixel.
const LEAST_BLUR_VARIANCE: f64 = 0.01;

/// The fit of one corner, with the window and the noise it was made with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fitted {
    pub(super) window: Window,
    pub(super) fit: CornerFit,
    /// The noise that weighted its samples.
    pub(super) noise: Noise,
    /// Inlier ratio: the share of samples that agree with the model.
    pub(super) inlier_ratio: f64,
    /// Whether it was fitted with light of its own.
    pub(super) lit: bool,
}

impl Fitted {
    pub(super) fn center(&self) -> [f64; 2] {
        let bin = self.window.bin as f64;
        [0, 1].map(|k| self.window.origin[k] + bin * self.fit.model.center[k])
    }

    pub(super) fn blur_px(&self) -> f64 {
        let bin = self.window.bin as f64;
        let [a, b] = self.fit.model.sharpness;
        let variance = bin * bin * (0.5 / (a * a) + 0.5 / (b * b) - PIXEL_VARIANCE);
        variance.max(LEAST_BLUR_VARIANCE).sqrt()
    }

    pub(super) fn known(&self) -> FittedCorner {
        let model = &self.fit.model;
        let white = (model.level + model.amplitude.abs()).max(1.0).ln();
        FittedCorner { at: self.center(), along: model.along, white }
    }

    /// Whether the fit has converged to something that explains most of the contrast.
    pub(super) fn has_settled(&self, limits: &RefinementThresholds) -> bool {
        self.inlier_ratio > limits.least_settled_inliers
            && self.fit.last_step < limits.most_settled_step
    }

    /// Whether this may be the requested corner.
    pub(super) fn may_be_corner(&self, corner: &GridCorner, limits: &RefinementThresholds) -> bool {
        let [x, y] = self.center();
        let cell = self.window.axes.map(length).into_iter().fold(f64::INFINITY, f64::min);
        let moved = length([x - corner.pixel.x, y - corner.pixel.y]);
        let model = &self.fit.model;
        moved
            < (limits.most_moved * cell)
                .min(f64::max(limits.always_moved_px, limits.always_moved * cell))
            && model.amplitude.abs() > limits.least_amplitude
            && model.correlation().abs() < limits.most_correlation
    }

    /// Whether the second fit is accepted. True corners pass each bound with a margin in the worst
    /// conditions (motion blur over several pixels, heavy noise); of other positions in images of
    /// boards one in a hundred passes.
    pub(super) fn is_corner(&self, corner: &GridCorner, limits: &RefinementThresholds) -> bool {
        let model = &self.fit.model;
        self.may_be_corner(corner, limits)
            && self.inlier_ratio > limits.least_inliers
            && self.fit.last_step < limits.most_step
            && model.gamma_term.abs() < model.amplitude.abs()
            && self.fit.residual_rms < limits.most_residual * model.amplitude.abs()
    }

    pub(super) fn quality(&self) -> Quality {
        let samples = self.fit.residuals.effective.max(1.0);
        let (mean_square, inlier_ratio) = (self.fit.mean_square, self.inlier_ratio);
        Quality { mean_square, inlier_ratio, samples, local_light: self.lit }
    }

    /// The covariance of the position, scaled to a mean variance of 1 per axis.
    pub(super) fn shape(&self) -> [f64; 3] {
        let [xx, xy, yy] = self.fit.covariance;
        [xx, xy, yy].map(|v| v / ((xx + yy) / 2.0))
    }

    pub(super) fn refined(&self) -> RefinedCorner {
        let [x, y] = self.center();
        RefinedCorner {
            pixel: Pixel::new(x, y),
            std_px: self.fit.position_std() * self.window.bin as f64,
            blur_px: self.blur_px(),
            contrast: 2.0 * self.fit.model.amplitude.abs(),
        }
    }
}
