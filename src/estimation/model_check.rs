//! Whether the model is right at all, which no residual of the fit itself can tell: two disjoint halves of the views are
//! fitted apart, and each predicts the other.

use crate::estimation::camera::{CameraEstimate, CameraFit};
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::lens_choice::{refit, squares_under};
use crate::estimation::uncertainty::{Distance, PixelGrid, projection_difference, projection_uncertainty};
use crate::geometry::lens::Lens;

/// What two halves of the views say of each other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ModelCheck {
    /// The rms difference of the halves' projections over the image, after the best compensating turn, over what their
    /// uncertainties predict: about 1 when the model is right. `None` with fewer than six views.
    pub split_half_ratio: Option<f64>,
    /// Root mean square error of each half's views under the other half's lens, in pixels.
    pub held_out_rms_px: Option<f64>,
    /// By how much the focal length differs between the halves, relative to itself.
    pub focal_change: Option<f64>,
}

/// Views looked at in the comparison, at most: with this many, two halves differ visibly wherever the model is wrong.
const MAX_VIEWS: usize = 60;

impl ModelCheck {
    pub(crate) fn of(fit: &CameraFit, estimate: &CameraEstimate) -> Self {
        Self::try_of(fit, estimate).unwrap_or_default()
    }

    fn try_of(fit: &CameraFit, estimate: &CameraEstimate) -> Option<Self> {
        let good = fit.good_views();
        let views: Vec<usize> = good.iter().step_by(good.len().div_ceil(MAX_VIEWS).max(1)).copied().collect();
        if views.len() < 6 {
            return None;
        }
        let half = |parity: usize| -> Vec<usize> { views.iter().skip(parity).step_by(2).copied().collect() };
        let (even, odd) = (half(0), half(1));
        let (a, b) = (refit(fit, &fit.sights, &even)?, refit(fit, &fit.sights, &odd)?);
        let (lens_a, lens_b) = (a.state.lenses[0], b.state.lenses[0]);
        let predicted = predicted_square(fit, &a, estimate)? + predicted_square(fit, &b, estimate)?;
        let seen: Vec<[f64; 2]> =
            projection_difference(&lens_a, &lens_b, grid(estimate)).into_iter().flatten().collect();
        let square = seen.iter().map(|[x, y]| x * x + y * y).sum::<f64>() / seen.len().max(1) as f64;
        let crossed = |lens: &Lens, views: &[usize]| -> Option<f64> {
            views.iter().map(|view| squares_under(lens, fit, &fit.sights[*view])).sum()
        };
        let held_out = crossed(&lens_b, &even)? + crossed(&lens_a, &odd)?;
        let corners = views.iter().flat_map(|view| &fit.sights[*view].used).filter(|used| **used).count();
        Some(Self {
            split_half_ratio: Some((square / predicted).sqrt()).filter(|ratio| ratio.is_finite()),
            held_out_rms_px: Some((held_out / corners.max(1) as f64).sqrt()),
            focal_change: Some((lens_a.matrix.fx - lens_b.matrix.fx).abs() / estimate.lens.matrix.fx),
        })
    }
}

fn grid(estimate: &CameraEstimate) -> PixelGrid {
    PixelGrid::over(estimate.image_size, 16)
}

/// The mean squared projection error that one half's covariance predicts, with the noise of the whole.
fn predicted_square(fit: &CameraFit, half: &Minimum, estimate: &CameraEstimate) -> Option<f64> {
    let free = &fit.layout.sensors[0].lens;
    let unit = half.equations.global_covariance()?;
    let spread = free.spread(&estimate.lens);
    let unit = unit.view((0, 0), (free.free.len(), free.free.len())).into_owned();
    let covariance = &spread * unit * spread.transpose() * estimate.noise.powi(2);
    Some(projection_uncertainty(&estimate.lens, &covariance, grid(estimate), Distance::Infinity)?.mean_square_px2)
}
