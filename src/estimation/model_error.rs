//! The noise floor: an error common to all corners, beyond their own standard deviations. A board
//! is not quite flat or square, a lens model is only nearly right, and the standard deviations are
//! themselves estimates. Without a noise floor, the few corners that appear sharpest would get most
//! of the weight.
//!
//! It is a variance component that is added to every corner's own variance. Where corners of small
//! and of large standard deviations have equal residuals it is large, and the weights become nearly
//! equal; where residuals are proportional to the standard deviations it is 0. It maximizes the
//! likelihood of variances k · (std² + common²) with k free (as in R. C. Paule and J. Mandel,
//! *Consensus values and weighting factors*, 1982, where k is 1).

use std::borrow::Cow;

use crate::estimation::camera_estimate::CameraEstimate;
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence};

/// Weights within this relative difference of the best ones lose next to no precision.
const NEARLY_BEST_PART: f64 = 0.2;

/// The largest number of corners in the sample.
const MOST_CORNERS: usize = 1000;

/// The range of common variances that are tried: the least in units of a sharp corner's own
/// variance, the greatest in units of a blurred one's. Each is twice the one before.
const VARIANCE_RANGE: [f64; 2] = [0.125, 64.0];

/// The problem with `noise_floor_px` added to every corner's own standard deviation, in quadrature.
pub(crate) fn with_noise_floor(
    problem: &CameraProblem,
    noise_floor_px: f64,
) -> Cow<'_, CameraProblem> {
    if noise_floor_px == 0.0 {
        return Cow::Borrowed(problem);
    }
    let corner =
        |c: &Correspondence| Correspondence { std_px: c.std_px.hypot(noise_floor_px), ..*c };
    let view = |view: &BoardView| BoardView {
        name: view.name.clone(),
        correspondences: view.correspondences.iter().map(corner).collect(),
    };
    Cow::Owned(CameraProblem {
        image_size: problem.image_size,
        views: problem.views.iter().map(view).collect(),
    })
}

/// The maximum-likelihood noise floor from the residuals of `estimate`, in pixels. `None` where the
/// weights would be close to those of `estimate`, or all corners have the same standard deviation,
/// so that no noise floor changes their weights.
pub(crate) fn noise_floor_px_of(problem: &CameraProblem, estimate: &CameraEstimate) -> Option<f64> {
    let views = problem.views.iter().zip(&estimate.views).filter(|(_, view)| view.fault.is_none());
    let corners = views.flat_map(|(given, view)| {
        given.correspondences.iter().zip(&view.residuals_px).zip(&view.used)
    });
    let seen: Vec<UsedCorner> = corners
        .filter(|(_, used)| **used)
        .map(|((corner, residual), _)| UsedCorner::of(corner, residual))
        .collect();
    if seen.windows(2).all(|pair| pair[0].variance == pair[1].variance) {
        return None;
    }
    let seen: Vec<UsedCorner> =
        seen.iter().step_by(seen.len().div_ceil(MOST_CORNERS)).copied().collect();
    let mut variances: Vec<f64> = seen.iter().map(|seen| seen.variance).collect();
    let [sharp, blurred] = [0.05, 0.95].map(|part| {
        let at = ((variances.len() - 1) as f64 * part) as usize;
        *variances.select_nth_unstable_by(at, f64::total_cmp).1
    });
    let doubled = |common: &f64| (*common < VARIANCE_RANGE[1] * blurred).then_some(2.0 * common);
    let least = (VARIANCE_RANGE[0] * sharp).max(f64::MIN_POSITIVE);
    let tried = std::iter::once(0.0).chain(std::iter::successors(Some(least), doubled));
    let likelihoods = tried.map(|common| (negative_log_likelihood(&seen, common), common));
    let best = likelihoods.min_by(|a, b| a.0.total_cmp(&b.0))?.1;
    // The ratio of a sharp corner's weight to a blurred one's, as a logarithm.
    let contrast = |common: f64| ((blurred + common) / (sharp + common)).ln();
    ((contrast(best) - contrast(estimate.noise_floor_px.powi(2))).abs() > NEARLY_BEST_PART)
        .then_some(best.sqrt())
}

/// A used corner.
#[derive(Debug, Clone, Copy)]
struct UsedCorner {
    /// Its given variance per axis.
    variance: f64,
    /// The mean square of its two residuals.
    square: f64,
}

impl UsedCorner {
    fn of(corner: &Correspondence, [x, y]: &[f64; 2]) -> Self {
        Self { variance: corner.std_px.powi(2), square: 0.5 * (x * x + y * y) }
    }
}

/// −ln of the likelihood, up to a constant, at the maximum-likelihood k.
fn negative_log_likelihood(seen: &[UsedCorner], common: f64) -> f64 {
    let (mut level, mut log_determinant) = (0.0, 0.0);
    for UsedCorner { variance, square } in seen {
        level += square / (variance + common);
        log_determinant += (variance + common).ln();
    }
    seen.len() as f64 * level.ln() + log_determinant
}
