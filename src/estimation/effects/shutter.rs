//! Whether the motion that was found is a rolling shutter's. The test is needed because twelve
//! unknowns per view always explain a part of any other model error.

use std::rc::Rc;

use nalgebra::Matrix6;

use crate::estimation::effects::evidence::ReducedSystem;
use crate::estimation::effects::rolling_shutter_test::RollingShutterTest;
use crate::estimation::effects::search::{EffectSearch, LEAST_GROUP_GAIN, MAX_STEPS};
use crate::estimation::effects::state::Scene;
use crate::estimation::effects::system::ViewPart;
use crate::estimation::normal_probability::normal_probability;
use crate::estimation::student::normal_deviations;
use crate::geometry::median::median;

/// The views agree where their mean is this many of its standard deviations above 0. With fifteen
/// views, chance alone exceeds it less than five times in a thousand.
const AGREED_STDS: f64 = 3.0;

/// With fewer than eight views, chance exceeds [`AGREED_STDS`] more often than once in a hundred
/// times. So the mean must also be as rare as this many standard deviations of a normal
/// distribution.
const AGREED_OF_FEW_STDS: f64 = 2.33;

/// Steps of the control before a first comparison. That result is final where it exceeds what is
/// required by this factor, after what the control would still gain was taken from it.
const FIRST_STEPS: usize = 2;
const CLEAR_FACTOR: f64 = 1.5;

/// A view's value is clamped to this many times the median of all views, so that one whose motion
/// has not converged cannot decide.
const MOST_MEDIANS: f64 = 5.0;

impl EffectSearch {
    /// Whether views agree that they were read by rows rather than by columns. Motion read by
    /// columns is the control: it explains nearly as much of any other model error (Q. H. Vuong,
    /// *Likelihood ratio tests for model selection and non-nested hypotheses*, 1989; the
    /// independent samples are the views, not their corners).
    pub(super) fn test_rolling_shutter(
        &self,
        scene: Scene<'_>,
        width: f64,
    ) -> Option<RollingShutterTest> {
        let basis = Rc::clone(&self.basis);
        let scene = Scene { basis: &basis, moves: true, ..scene };
        let by_columns = Scene { by_columns: Some(width), ..scene };
        let (rows, views_by_rows, _) = self.evidences(scene)?;
        let mut control = self.without_motion(by_columns)?;
        let mut against = |steps: usize, asked: f64| {
            control.converge(by_columns, steps)?;
            let (columns, views, missing) = control.evidences(by_columns)?;
            let each = missing / views.len() as f64;
            let of_views =
                views_by_rows.iter().zip(views).map(|(rows, columns)| rows - (columns + each));
            RollingShutterTest::of(rows - columns, &of_views.collect::<Vec<f64>>(), asked)
        };
        let first = against(FIRST_STEPS, CLEAR_FACTOR)?;
        if first.is_shown { Some(first) } else { against(MAX_STEPS - FIRST_STEPS, 1.0) }
    }

    /// The logarithm of the evidence, each view's part in it with the globals fixed, and how much
    /// their sum is short of that at the mode, which the search may not have reached.
    fn evidences(&self, scene: Scene<'_>) -> Option<(f64, Vec<f64>, f64)> {
        let lens = scene.layout.len;
        let reduced =
            ReducedSystem::of(&self.system, &self.state, scene.basis, lens, &self.variances)?;
        let noise_square = reduced.noise_square(&self.state);
        let lambda = self.variances.of_motion(&self.system);
        let of_view = |view: &ViewPart| {
            let observation = &scene.observations[view.observation];
            let motion = &self.state.motions[view.observation];
            let used = self.system.residuals[view.observation]
                .iter()
                .zip(&observation.used)
                .filter(|(_, used)| **used);
            let (cost, count) = used
                .fold((0.0, 0.0), |(cost, count), ([x, y], _)| (cost + x * x + y * y, count + 2.0));
            let penalty = lambda.component_mul(motion).dot(motion);
            let block = (view.motion + Matrix6::from_diagonal(&lambda)).cholesky()?.unpack();
            let determinant: f64 = (0..6).map(|k| 2.0 * block[(k, k)].ln() - lambda[k].ln()).sum();
            Some(-0.5 * ((cost + penalty) / noise_square + determinant + count * noise_square.ln()))
        };
        let of_views: Option<Vec<f64>> = self.system.views.iter().map(of_view).collect();
        let missing = reduced.log_likelihood_gain(&self.state);
        Some((reduced.log_evidence(&self.state), of_views?, missing))
    }
}

impl RollingShutterTest {
    /// From the log evidence for rows minus that for columns, in total and per view. All thresholds
    /// are multiplied by `asked`. `None` without views.
    fn of(favor: f64, of_views: &[f64], asked: f64) -> Option<Self> {
        let typical = median(of_views.iter().map(|one: &f64| one.abs()).collect())?;
        let of_views: Vec<f64> = of_views
            .iter()
            .map(|one| one.clamp(-MOST_MEDIANS * typical, MOST_MEDIANS * typical))
            .collect();
        let count = of_views.len() as f64;
        let mean = of_views.iter().sum::<f64>() / count;
        let squares = of_views.iter().map(|one| (one - mean).powi(2)).sum::<f64>();
        let std = (squares / (count - 1.0).max(1.0) / count).sqrt();
        let t = mean / std.max(f64::MIN_POSITIVE);
        let deviations = normal_deviations(t, count - 1.0);
        let agree = t >= asked * AGREED_STDS && deviations >= asked * AGREED_OF_FEW_STDS;
        let is_favored = favor >= asked * LEAST_GROUP_GAIN;
        let beyond_chance = if is_favored { (1.0 - 1.0 / (t * t)).max(0.0) } else { 0.0 };
        Some(Self {
            is_shown: is_favored && agree,
            agreement: if t > 0.0 { beyond_chance } else { 0.0 },
            probability: normal_probability(deviations),
        })
    }
}
