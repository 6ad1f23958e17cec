//! Whether the corners of a view err together. The covariance of a least-squares estimate takes every corner's error for its
//! own; where something moves a whole view's corners (a moving board under a rolling shutter, a picture of a bent board, a lens that the
//! model cannot follow), views differ by more than their corners' scatter explains, and so do estimates from other views.
//!
//! Each view pulls the parameters by its score s = g − C H⁻¹ h (its pose eliminated), whose covariance is A, its part of the
//! information, if corners err by themselves. How much greater the scores are is the factor on the covariance: a scalar
//! form of the clustered covariance of K.-Y. Liang and S. L. Zeger, *Longitudinal data analysis using generalized linear
//! models*, 1986, which with few views would itself be too uncertain.

use nalgebra::DMatrix;

use crate::estimation::camera::CameraFit;
use crate::estimation::joint::State;
use crate::estimation::joint::minimize::Minimum;
use crate::estimation::robust::Loss;

/// Views looked at, at most.
const MAX_VIEWS: usize = 60;

/// Fewer tell nothing of how views differ.
const MIN_VIEWS: usize = 5;

/// A factor within this many standard deviations of 1 is chance.
const CHANCE: f64 = 4.0;

/// The factor on the variance of one camera's estimate, 1 or more; `unit` is the covariance of its parameters for
/// residuals of unit variance.
pub(crate) fn shared_error(fit: &CameraFit, unit: &DMatrix<f64>) -> f64 {
    let good = fit.good_views();
    if fit.layout.sensors.len() > 1 || good.len() < MIN_VIEWS || fit.layout.len == 0 {
        return 1.0;
    }
    let (mut seen, mut expected, mut variance) = (0.0, 0.0, 0.0);
    for view in good.iter().step_by(good.len().div_ceil(MAX_VIEWS)) {
        let all = &fit.robust.minimum.state;
        let state = State {
            lenses: all.lenses.clone(),
            sensor_from_rig: all.sensor_from_rig.clone(),
            rig_from_board: vec![all.rig_from_board[*view]],
            warp: all.warp,
        };
        let mut sight = fit.sights[*view].clone();
        sight.instant = 0;
        let Some(alone) = Minimum::start(&fit.layout, state, &[sight], Loss::Squares) else { continue };
        let Some((information, score)) = alone.equations.reduced(0) else { continue };
        let part = unit * information;
        let squared = part.dot(&part.transpose());
        seen += (score.transpose() * unit * &score)[(0, 0)];
        expected += part.trace() - squared;
        variance += 2.0 * squared;
    }
    let factor = seen / (fit.noise_square() * expected);
    let is_chance = !(factor > 1.0 + CHANCE * variance.sqrt() / expected);
    if is_chance || !factor.is_finite() { 1.0 } else { factor }
}
