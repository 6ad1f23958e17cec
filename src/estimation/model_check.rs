//! Whether the model is right at all, which the residuals of the fit itself do not show: two
//! disjoint halves of the views are fitted separately, and each predicts the other.

use nalgebra::{DMatrix, DVector};

use crate::estimation::camera_estimate::CameraEstimate;
use crate::estimation::camera_fit::CameraFit;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::joint::normal::ReducedView;
use crate::estimation::joint::per_observation::assemble;
use crate::estimation::lens_misfit::LensMisfit;
use crate::estimation::lens_trial::{refit, squares_under};
use crate::estimation::misfit::{Misfit, board_bow_m};
use crate::estimation::problem::{BoardShape, CameraOptions};
use crate::estimation::uncertainty::{
    Distance, PixelGrid, projection_difference, projection_uncertainty,
};
use crate::geometry::lens::Lens;

/// What two halves of the views say of each other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ModelCheck {
    /// The difference of the halves' projections, after the best compensating rotation, over what
    /// their uncertainties predict at that pixel: the root of the mean square over the image, about
    /// 1 when the model is right. `None` with fewer than six views.
    pub split_half_ratio: Option<f64>,
    /// Root mean square error of each half's views under the other half's lens, in pixels.
    pub held_out_rms_px: Option<f64>,
    /// By how much the focal length differs between the halves, relative to itself.
    pub focal_change: Option<f64>,
    /// Correlation of the residuals of corners that follow each other on the board: near 0 for
    /// noise, near 1 where the model cannot follow the image, and halves agree on the same wrong
    /// answer.
    pub residual_correlation: Option<f64>,
    /// What seems to be wrong where halves or neighboring corners show that something is.
    pub misfit: Misfit,
    /// How far the board's middle seems to be off the plane of its edges by curvature along x and by
    /// curvature along y, in meters, where that explains a good part of the residuals and was not
    /// estimated. It is tested of every set; a board of any shape is where something else shows that
    /// the model is wrong.
    pub board_bow_m: Option<[f64; 2]>,
    /// Whether the lens model that was asked for is too simple.
    pub lens_misfit: Option<LensMisfit>,
}

/// A split-half ratio above which causes are tested: where the model is right, one set in a hundred
/// has more.
const SUSPICIOUS_RATIO: f64 = 2.0;

/// A correlation of neighbors' residuals above which causes are tested: 3.5 standard deviations of
/// that of [`MIN_PAIRS`] pairs of independent residuals.
const SUSPICIOUS_CORRELATION: f64 = 0.25;

/// Where another lens raises the squares of a view by less than this part, what second order leaves
/// out of it is far less.
const NEARBY: f64 = 0.2;

/// Pairs of neighbors, of two coordinates each, that determine a correlation to 0.07 (1 sigma, the
/// root of 1 over 200).
const MIN_PAIRS: usize = 100;

impl ModelCheck {
    /// Fewer views have no halves that determine a lens each.
    pub const MIN_VIEWS: usize = 6;

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
        // A bow leaves smooth residuals: where neighbors differ in sign, it is not tested.
        let smooth = residual_correlation.is_none_or(|correlation| correlation > 0.0);
        let estimated = options.board_shape != BoardShape::Flat;
        let board_bow_m =
            if enough && smooth && !estimated { board_bow_m(fit, &views) } else { None };
        Self { board_bow_m, misfit, ..halves }
    }

    /// Whether residuals, or halves of the views, say that something is not as modeled.
    fn is_suspicious(&self, estimate: &CameraEstimate) -> bool {
        self.split_half_ratio.is_none_or(|ratio| ratio > SUSPICIOUS_RATIO)
            || self.residual_correlation.is_some_and(|r| r > SUSPICIOUS_CORRELATION)
            || estimate.variance_inflation > 1.0
    }

    /// Whether something beyond lens and poses was found or is suspected: what else is wrong with
    /// them may be asked then.
    pub(crate) fn is_beyond_noise(&self, fit: &CameraFit, estimate: &CameraEstimate) -> bool {
        !fit.is_exact() && (fit.effects.is_some() || self.is_suspicious(estimate))
    }

    fn halves(fit: &CameraFit, estimate: &CameraEstimate) -> Option<Self> {
        let views = some_views(fit);
        if views.len() < Self::MIN_VIEWS {
            return None;
        }
        let half = |parity: usize| -> Vec<usize> {
            views.iter().skip(parity).step_by(2).copied().collect()
        };
        let (even, odd) = (half(0), half(1));
        let local = &fit.robust.minimum.equations.local;
        let [a, b] = [&even, &odd].map(|half| refit(fit, &fit.observations, local, half));
        let (lens_a, lens_b) = (a.state.lenses[0], b.state.lenses[0]);
        let covariance = lens_covariance(fit, &a, estimate)? + lens_covariance(fit, &b, estimate)?;
        let grid = PixelGrid::over(estimate.image_size, 10);
        let predicted =
            projection_uncertainty(&estimate.lens, &covariance, grid, Distance::Infinity)?;
        let seen = projection_difference(&lens_a, &lens_b, grid, &predicted.weights);
        // Each pixel against its own prediction: a corner that no view reached must not drown the
        // rest.
        let ratios = seen.iter().zip(&predicted.square_px2).filter_map(|(seen, predicted)| {
            let [x, y] = (*seen)?;
            Some((x * x + y * y) / (*predicted)?)
        });
        let (count, sum) =
            ratios.fold((0.0, 0.0), |(count, sum), ratio| (count + 1.0, sum + ratio));
        let crossed = |lens: &Lens, views: &[usize]| -> Option<f64> {
            let at_best_pose = |view: usize| squares_under(lens, fit, &fit.observations[view]);
            views
                .iter()
                .map(|view| squares_nearby(lens, fit, *view).or_else(|| at_best_pose(*view)))
                .sum()
        };
        let held_out = crossed(&lens_b, &even).and_then(|sum| Some(sum + crossed(&lens_a, &odd)?));
        let corners = views
            .iter()
            .flat_map(|view| &fit.observations[*view].used)
            .filter(|used| **used)
            .count();
        Some(Self {
            split_half_ratio: Some(f64::sqrt(sum / count)).filter(|ratio| ratio.is_finite()),
            held_out_rms_px: held_out.map(|squares| (squares / corners.max(1) as f64).sqrt()),
            focal_change: Some(
                (lens_a.matrix.fx - lens_b.matrix.fx).abs() / estimate.lens.matrix.fx,
            ),
            ..Self::default()
        })
    }
}

/// The sum of squared pixel errors of one view at its best pose under a lens near that of the fit,
/// to second order from what the view said there; `None` where that is not near enough, or its
/// corners have not all the same to say.
fn squares_nearby(lens: &Lens, fit: &CameraFit, view: usize) -> Option<f64> {
    let (minimum, observation) = (&fit.robust.minimum, &fit.observations[view]);
    let free = &fit.layout.sensors[0].lens.free;
    let inverse_std = *observation.inverse_std.first()?;
    if fit.layout.len > free.len()
        || observation.inverse_std.iter().any(|other| *other != inverse_std)
    {
        return None;
    }
    let part = std::iter::once((view, 0));
    let alone = assemble(&minimum.equations.local, fit.minimum_point(), &fit.observations, part, 1);
    let ReducedView { information, gradient } = alone.reduced(0)?;
    let (there, here) = (lens.parameters(), fit.lens().parameters());
    let moved =
        DVector::from_iterator(free.len(), free.iter().map(|index| there[*index] - here[*index]));
    let raised = 2.0 * gradient.dot(&moved) + moved.dot(&(&information * &moved));
    (raised.abs() < NEARBY * alone.cost)
        .then_some((alone.cost + raised) / (inverse_std * inverse_std))
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

/// The used views, or enough of them, evenly.
fn some_views(fit: &CameraFit) -> Vec<usize> {
    fit.some_frame_sets().into_iter().flatten().collect()
}

/// The covariance of the lens that one half gives: what its own views determine, as much wider as
/// that of the whole is than corners that err by themselves would make it.
fn lens_covariance(
    fit: &CameraFit,
    half: &Minimum,
    estimate: &CameraEstimate,
) -> Option<DMatrix<f64>> {
    let lens = &fit.layout.sensors[0].lens;
    let (free, size) = (&lens.free, lens.free.len());
    let of = |minimum: &Minimum| -> Option<DMatrix<f64>> {
        Some(minimum.equations.global_covariance()?.view((0, 0), (size, size)).into_owned())
    };
    let unit = of(&fit.robust.minimum)?;
    // Parameters differ by orders of magnitude: in units of their own deviations.
    let scale: Vec<f64> = unit.diagonal().iter().map(|v| v.sqrt()).collect();
    let scaled = |m: &dyn Fn(usize, usize) -> f64| {
        DMatrix::from_fn(size, size, |i, j| m(i, j) / (scale[i] * scale[j]))
    };
    let stated = scaled(&|i, j| estimate.lens_covariance[(free[i], free[j])]);
    let from = scaled(&|i, j| unit[(i, j)]).cholesky()?.unpack();
    let widened = stated.cholesky()?.unpack() * from.try_inverse()?;
    let half = of(half)?;
    let half = &widened * scaled(&|i, j| half[(i, j)]) * widened.transpose();
    let half = DMatrix::from_fn(size, size, |i, j| half[(i, j)] * scale[i] * scale[j]);
    let by_free = lens.all_by_free(&estimate.lens);
    Some(&by_free * half * by_free.transpose())
}
