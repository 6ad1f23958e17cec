//! Bundle adjustment with an unknown noise level and some outliers.

use crate::estimation::scene::bundle::{Bundle, BundleStop, SceneState};
use crate::geometry::median::median;

/// Observations with a longer residual, in standard deviations of a coordinate, are outliers: of
/// inliers, one in 500 is longer.
const OUTLIER_STDS: f64 = 3.5;

/// Rounds of fitting and dropping outliers.
const ROUNDS: usize = 4;

/// The scale of Cauchy's loss while outliers are not yet dropped, in standard deviations (95 %
/// efficient without outliers).
pub(super) const CAUCHY: f64 = 2.4;

/// The median of a squared length whose two coordinates have unit variance.
const MEDIAN_SQUARE: f64 = 2.0 * std::f64::consts::LN_2;

/// A fit with the observations in use, and their noise.
#[derive(Debug, Clone)]
pub struct RobustBundle {
    /// The inlier observations, with their true standard deviations.
    pub bundle: Bundle,
    /// The estimate.
    pub state: SceneState,
    /// Number of dropped observations.
    pub dropped: usize,
    /// The factor between the expected standard deviations and those that the residuals show.
    pub noise_factor: f64,
}

impl Bundle {
    /// The squared residual of each observation in squared standard deviations, by point; infinite
    /// behind a camera.
    pub fn squares(&self, state: &SceneState) -> Vec<Vec<f64>> {
        let points = state.points.iter().zip(&self.observations);
        points
            .map(|(point, seen)| {
                seen.iter()
                    .map(|seen| {
                        let in_camera = state.cameras_from_scene[seen.camera] * *point;
                        let pixel = state.lens.pixel_from_point(&in_camera);
                        pixel.map_or(f64::INFINITY, |pixel| {
                            (pixel.to_vector() - seen.pixel.to_vector()).norm_squared()
                                * seen.inverse_std.powi(2)
                        })
                    })
                    .collect()
            })
            .collect()
    }

    /// The degrees of freedom of the residuals over their number.
    pub fn free_part(&self, cameras: usize) -> f64 {
        let observations: usize = self.observations.iter().map(Vec::len).sum();
        let equations = 2.0 * observations as f64;
        let unknowns = 3.0 * self.observations.len() as f64 + self.size(cameras) as f64;
        ((equations - unknowns) / equations).max(0.02)
    }

    /// The noise factor from the median residual, on which outliers have little effect.
    pub fn median_noise(&self, state: &SceneState) -> f64 {
        let squares = self.squares(state).into_iter().flatten().collect();
        let free = self.free_part(state.cameras_from_scene.len());
        (median(squares).unwrap_or(1.0) / MEDIAN_SQUARE / free).sqrt().max(1e-6)
    }

    /// Multiplies the standard deviation of all observations by `factor`.
    pub fn rescaled(&mut self, factor: f64) {
        self.observations.iter_mut().flatten().for_each(|seen| seen.inverse_std /= factor);
    }
}

/// Fits, estimates the noise and drops outliers, in rounds. The last fit is least squares of the
/// remaining observations. Points left with fewer than two observations are dropped with them.
pub fn fit_robustly(bundle: Bundle, start: SceneState, stop: BundleStop) -> RobustBundle {
    let (mut bundle, mut state) = (bundle, start);
    let all: usize = bundle.observations.iter().map(Vec::len).sum();
    let mut noise_factor = 1.0;
    for round in 0..ROUNDS {
        let factor = bundle.median_noise(&state);
        bundle.rescaled(factor);
        noise_factor *= factor;
        let is_last = round + 1 == ROUNDS;
        bundle.robust_limit = if is_last { f64::INFINITY } else { CAUCHY };
        state = bundle.minimize(state, stop);
        if !is_last {
            let factor = bundle.median_noise(&state);
            bundle.rescaled(factor);
            noise_factor *= factor;
            drop_wrong(&mut bundle, &mut state);
        }
    }
    let squares: f64 = bundle.squares(&state).iter().flatten().filter(|s| s.is_finite()).sum();
    let kept: usize = bundle.observations.iter().map(Vec::len).sum();
    let free = bundle.free_part(state.cameras_from_scene.len());
    let factor = (squares / (2.0 * kept.max(1) as f64 * free)).sqrt().max(1e-6);
    bundle.rescaled(factor);
    noise_factor *= factor;
    RobustBundle { bundle, state, dropped: all - kept, noise_factor }
}

/// Drops outliers, and points that then have fewer than two observations.
fn drop_wrong(bundle: &mut Bundle, state: &mut SceneState) {
    let squares = bundle.squares(state);
    let mut kept_points = Vec::new();
    let mut kept_observations = Vec::new();
    for ((seen, squares), point) in bundle.observations.iter().zip(&squares).zip(&state.points) {
        let right =
            seen.iter().zip(squares).filter(|(_, square)| **square <= OUTLIER_STDS * OUTLIER_STDS);
        let seen: Vec<_> = right.map(|(seen, _)| *seen).collect();
        if seen.len() >= 2 {
            kept_observations.push(seen);
            kept_points.push(*point);
        }
    }
    bundle.observations = kept_observations;
    state.points = kept_points;
}
