//! What no corner's own standard deviation knows of: a board that is not quite flat or square, a lens that its model only
//! nearly describes. It is the same for all corners, so where residuals are far above the corners' own deviations, weights by these
//! alone would trust a few sharp corners with an error that is not theirs.
//!
//! One more variance for all corners, chosen so that residuals come out as predicted (the iteration of R. C. Paule and
//! J. Mandel, *Consensus values and weighting factors*, 1982).

use crate::estimation::camera::CameraEstimate;
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence};

/// Residuals this many times the corners' own deviations are noise that was told too small, not another error.
const TOLD: f64 = 1.5;

/// The problem with the common error added to every corner's variance; `None` where the corners' own deviations explain
/// the residuals of `estimate`, or all are equal, so that weights would stay as they are.
pub(crate) fn with_model_error(problem: &CameraProblem, estimate: &CameraEstimate) -> Option<CameraProblem> {
    let views = problem.views.iter().zip(&estimate.views).filter(|(_, view)| view.fault.is_none());
    let seen: Vec<(f64, f64)> = views
        .flat_map(|(given, view)| given.correspondences.iter().zip(&view.residuals_px).zip(&view.used))
        .filter(|(_, used)| **used)
        .map(|((corner, [x, y]), _)| (corner.std_px.powi(2), 0.5 * (x * x + y * y)))
        .collect();
    let all_equal = seen.windows(2).all(|pair| pair[0].0 == pair[1].0);
    let excess = |common: f64| {
        let sum: f64 = seen.iter().map(|(variance, square)| square / (variance + common)).sum();
        sum / seen.len().max(1) as f64
    };
    if all_equal || !(excess(0.0) > TOLD * TOLD && excess(0.0).is_finite()) {
        return None;
    }
    let (mut low, mut high) = (0.0, seen.iter().map(|(_, square)| *square).sum::<f64>());
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if excess(middle) > 1.0 { low = middle } else { high = middle }
    }
    let corner = |c: &Correspondence| Correspondence { std_px: (c.std_px.powi(2) + high).sqrt(), ..*c };
    let view = |view: &BoardView| BoardView {
        name: view.name.clone(),
        correspondences: view.correspondences.iter().map(corner).collect(),
    };
    Some(CameraProblem { image_size: problem.image_size, views: problem.views.iter().map(view).collect() })
}
