//! Whether the model is right at all, which the residuals of the fit itself do not show: two
//! disjoint halves of the views are fitted separately, and each predicts the other.

use crate::estimation::camera_estimate::CameraEstimate;
use crate::estimation::camera_fit::CameraFit;
use crate::estimation::given_misfit::GivenCheck;
use crate::estimation::lens_choice::lens_misfit::LensMisfit;
use crate::estimation::misfit::{Misfit, board_bow_m};
use crate::estimation::problem::{BoardShape, CameraOptions};
use crate::estimation::split_halves::{LensWithCovariance, MIN_FRAME_SETS, SplitHalves};

/// The result of comparing two halves of the views.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelCheck {
    /// The difference of the halves' projections, after the best compensating rotation, over its
    /// predicted standard deviation at that pixel: the root mean square over the image, about 1
    /// when the model is right. `None` with fewer than six views.
    pub split_half_ratio: Option<f64>,
    /// Root mean square error of each half's views under the other half's lens, in pixels.
    pub held_out_rms_px: Option<f64>,
    /// By how much the focal length differs between the halves, relative to itself.
    pub focal_change: Option<f64>,
    /// Correlation of the residuals of corners that follow each other on the board: near 0 for
    /// noise, near 1 where the model cannot fit the image, and both halves agree on the same wrong
    /// result.
    pub residual_correlation: Option<f64>,
    /// The effects that would explain the misfit, where halves or neighboring corners show one.
    pub misfit: Misfit,
    /// The height of the board's middle above the plane of its edges by curvature along x and along
    /// y, in meters, where that explains a good part of the residuals and was not estimated. It is
    /// tested for every set; a board of general shape only where something else shows that the
    /// model is wrong.
    pub board_bow_m: Option<[f64; 2]>,
    /// A larger lens model that predicts views better, where the requested or chosen one is too
    /// simple.
    pub lens_misfit: Option<LensMisfit>,
    /// Whether the views fit the lens parameters that were given.
    pub given: GivenCheck,
}

/// A split-half ratio above which causes are tested: where the model is right, three sets in a
/// hundred exceed it (15 of 600 simulated sets of 8 to 37 views).
const SUSPICIOUS_RATIO: f64 = 2.0;

/// A correlation of neighbors' residuals above which causes are tested: 3.5 standard deviations for
/// [`MIN_PAIRS`] pairs of independent residuals.
const SUSPICIOUS_CORRELATION: f64 = 0.25;

/// Pairs of neighbors, of two coordinates each, that determine a correlation to 0.07 (1 sigma, the
/// root of 1 over 200).
const MIN_PAIRS: usize = 100;

impl ModelCheck {
    /// With fewer views, the halves do not determine a lens each.
    pub const MIN_VIEWS: usize = MIN_FRAME_SETS;

    pub(crate) fn of(fit: &CameraFit, estimate: &CameraEstimate, options: &CameraOptions) -> Self {
        if fit.is_exact() {
            // Halves agree to rounding, and no residuals are left to test.
            return Self {
                split_half_ratio: Some(0.0).filter(|_| some_views(fit).len() >= Self::MIN_VIEWS),
                held_out_rms_px: Some(estimate.rms_px),
                ..Self::default()
            };
        }
        let halves = Self::halves(fit, estimate).unwrap_or_default();
        let residual_correlation = residual_correlation(estimate);
        let halves = Self { residual_correlation, ..halves };
        let suspicious = halves.is_suspicious(estimate);
        let views = some_views(fit);
        let size = [estimate.image_size.width, estimate.image_size.height].map(f64::from);
        let enough = views.len() >= Self::MIN_VIEWS;
        let misfit = if suspicious && enough {
            Misfit::of(fit, &views, size, options)
        } else {
            Misfit::default()
        };
        // A bow leaves smooth residuals. It is not tested where neighbors have opposite signs.
        let smooth = residual_correlation.is_none_or(|correlation| correlation > 0.0);
        let estimated = options.board_shape != BoardShape::Flat;
        let board_bow_m =
            if enough && smooth && !estimated { board_bow_m(fit, &views) } else { None };
        Self { board_bow_m, misfit, ..halves }
    }

    /// Whether residuals, or halves of the views, show a misfit of the model.
    fn is_suspicious(&self, estimate: &CameraEstimate) -> bool {
        self.split_half_ratio.is_none_or(|ratio| ratio > SUSPICIOUS_RATIO)
            || self.residual_correlation.is_some_and(|r| r > SUSPICIOUS_CORRELATION)
            || estimate.variance_inflation > 1.0
    }

    /// Whether effects beyond lens and poses were found or are suspected, so that further causes
    /// are to be tested.
    pub(crate) fn is_beyond_noise(&self, fit: &CameraFit, estimate: &CameraEstimate) -> bool {
        !fit.is_exact() && (fit.effects.is_some() || self.is_suspicious(estimate))
    }

    fn halves(fit: &CameraFit, estimate: &CameraEstimate) -> Option<Self> {
        let halves = SplitHalves::of(fit)?;
        let stated =
            LensWithCovariance { lens: &estimate.lens, covariance: &estimate.lens_covariance };
        let difference = halves.lens_difference(0, stated, estimate.image_size);
        Some(Self {
            split_half_ratio: difference.ratio,
            held_out_rms_px: halves.held_out_rms_px(0),
            focal_change: Some(difference.focal_change),
            ..Self::default()
        })
    }
}

fn residual_correlation(estimate: &CameraEstimate) -> Option<f64> {
    let (mut together, mut squares, mut pairs) = (0.0, 0.0, 0);
    for view in estimate.views.iter().filter(|view| view.fault.is_none()) {
        let corners = view.residuals_px.iter().zip(&view.used);
        for ((a, a_used), (b, b_used)) in corners.clone().zip(corners.skip(1)) {
            if *a_used && *b_used {
                together += a[0] * b[0] + a[1] * b[1];
                squares += 0.5 * (a[0] * a[0] + a[1] * a[1] + b[0] * b[0] + b[1] * b[1]);
                pairs += 1;
            }
        }
    }
    (pairs >= MIN_PAIRS && squares > 0.0).then_some(together / squares)
}

/// The used views, or an evenly spaced sample of many.
fn some_views(fit: &CameraFit) -> Vec<usize> {
    fit.some_frame_sets().into_iter().flatten().collect()
}
