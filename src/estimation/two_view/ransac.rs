//! RANSAC with an unknown noise level: the inliers of one model among many correspondences.
//!
//! Samples are drawn, fitted and scored a contrario. Of all residual limits, the one is used whose
//! inliers are the least likely to arise by chance (L. Moisan and B. Stival, *A probabilistic
//! criterion to detect rigid point matches between two images and estimate the fundamental matrix*,
//! 2004), so that the inliers' scale comes from the data. Each new best model is fitted again to
//! its inliers (O. Chum, J. Matas and J. Kittler, *Locally optimized RANSAC*, 2003). Deterministic:
//! the samples come from a generator with a fixed seed.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::geometry::pixel::ImageSize;

/// A model that few correspondences determine.
pub trait SampledModel {
    /// The fitted model.
    type Model: Clone;

    /// Number of correspondences that determine the model, up to a few solutions.
    const SAMPLE: usize;

    /// Number of correspondences.
    fn count(&self) -> usize;

    /// The models through the sample.
    fn fit_sample(&self, sample: &[usize]) -> Vec<Self::Model>;

    /// The best model for many inliers, near `model`; `None` where they do not determine one.
    fn fit_inliers(&self, model: &Self::Model, inliers: &[usize]) -> Option<Self::Model>;

    /// The squared residual of one correspondence, in px²; infinite for one it cannot explain.
    fn squared_residual_px2(&self, model: &Self::Model, index: usize) -> f64;

    /// The probability that a wrong correspondence has a residual below `limit_px` by chance.
    fn chance(&self, limit_px: f64) -> f64;

    /// The largest number of models from one sample.
    fn max_solutions(&self) -> f64;
}

/// How samples are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RansacOptions {
    /// The largest number of samples.
    pub max_samples: usize,
    /// Sampling ends where the probability of having missed a better model is below this.
    pub miss_probability: f64,
    /// Residuals above this are never inliers, in pixels.
    pub max_limit_px: f64,
}

impl Default for RansacOptions {
    fn default() -> Self {
        Self { max_samples: 1000, miss_probability: 1e-3, max_limit_px: 8.0 }
    }
}

/// A model with its inliers.
#[derive(Debug, Clone, PartialEq)]
pub struct Consensus<M> {
    /// The model.
    pub model: M,
    /// The inliers, ascending.
    pub inliers: Vec<usize>,
    /// The residual limit of the inliers, chosen by the data, in pixels.
    pub limit_px: f64,
    /// The natural logarithm of the number of false alarms: how many consensuses as good as this
    /// are expected by chance alone. Far below 0 for a real one.
    pub log_false_alarms: f64,
}

/// Number of residual limits tried, and the ratio between them. The greatest is
/// [`RansacOptions::max_limit_px`].
const LIMIT_COUNT: usize = 40;
const LIMIT_RATIO: f64 = 1.15;

/// The largest number of fits to the inliers of each new best model.
const LOCAL_STEPS: usize = 3;

/// The consensus that is least likely by chance; `None` where chance explains every one.
pub fn ransac<S: SampledModel>(
    problem: &S,
    options: &RansacOptions,
) -> Option<Consensus<S::Model>> {
    let count = problem.count();
    if count <= S::SAMPLE {
        return None;
    }
    let scoring = Scoring::new(problem, options);
    let mut random = ChaCha8Rng::seed_from_u64(0x5ca1e);
    let mut best: Option<Scored<S::Model>> = None;
    let mut needed = options.max_samples;
    let mut drawn = 0;
    while drawn < needed {
        drawn += 1;
        let sample = draw(&mut random, count, S::SAMPLE);
        for model in problem.fit_sample(&sample) {
            let scored = scoring.score(problem, model);
            if best.as_ref().is_some_and(|best| scored.log_false_alarms >= best.log_false_alarms) {
                continue;
            }
            let scored = scoring.polish(problem, scored);
            let part = scored.inliers as f64 / count as f64;
            needed = needed.min(samples_needed(part, S::SAMPLE, options).max(drawn));
            best = Some(scored);
        }
    }
    let best = best.filter(|best| best.log_false_alarms < 0.0)?;
    let limit_px2 = best.limit_px * best.limit_px;
    let agrees = |k: &usize| problem.squared_residual_px2(&best.model, *k) <= limit_px2;
    let inliers = (0..count).filter(agrees).collect();
    let Scored { model, limit_px, log_false_alarms, .. } = best;
    Some(Consensus { model, inliers, limit_px, log_false_alarms })
}

/// The least number of samples: a first model may have its inliers by chance.
const LEAST_SAMPLES: usize = 8;

/// The number of samples of `size` after which a model with this part of inliers is missed with
/// [`RansacOptions::miss_probability`] (HZ equation 4.18); the largest number where it has none.
fn samples_needed(part: f64, size: usize, options: &RansacOptions) -> usize {
    // By ln_1p: ln(1 − hit) would round to 0 for a small hit, and lose its sign.
    let log_miss = (-part.powi(size as i32)).ln_1p();
    let enough =
        if log_miss < 0.0 { options.miss_probability.ln() / log_miss } else { f64::INFINITY };
    (enough.ceil() as usize).max(LEAST_SAMPLES).min(options.max_samples)
}

#[derive(Clone)]
struct Scored<M> {
    model: M,
    inliers: usize,
    limit_px: f64,
    log_false_alarms: f64,
}

struct Scoring {
    limits_px: Vec<f64>,
    log_chances: Vec<f64>,
    /// log of (n choose k) (k choose sample), by k.
    log_choices: Vec<f64>,
    log_tests: f64,
}

impl Scoring {
    fn new<S: SampledModel>(problem: &S, options: &RansacOptions) -> Self {
        let n = problem.count();
        let down = |k: usize| options.max_limit_px / LIMIT_RATIO.powi((LIMIT_COUNT - 1 - k) as i32);
        let limits_px: Vec<f64> = (0..LIMIT_COUNT).map(down).collect();
        let chance = |limit: &f64| problem.chance(*limit).clamp(1e-12, 1.0).ln();
        let mut log_factorial = vec![0.0; n + 1];
        for k in 1..=n {
            log_factorial[k] = log_factorial[k - 1] + (k as f64).ln();
        }
        let choose = |n: usize, k: usize| {
            if k > n { 0.0 } else { log_factorial[n] - log_factorial[k] - log_factorial[n - k] }
        };
        Self {
            log_chances: limits_px.iter().map(chance).collect(),
            limits_px,
            log_choices: (0..=n).map(|k| choose(n, k) + choose(k, S::SAMPLE)).collect(),
            log_tests: (problem.max_solutions() * (n - S::SAMPLE) as f64).ln(),
        }
    }

    fn score<S: SampledModel>(&self, problem: &S, model: S::Model) -> Scored<S::Model> {
        let mut counts = [0_usize; LIMIT_COUNT];
        let (greatest, steps_per_log) =
            (self.limits_px[LIMIT_COUNT - 1].powi(2), 0.5 / LIMIT_RATIO.ln());
        for k in 0..problem.count() {
            let residual = problem.squared_residual_px2(&model, k);
            if residual <= greatest {
                let below = ((greatest / residual.max(1e-12)).ln() * steps_per_log) as usize;
                counts[LIMIT_COUNT - 1 - below.min(LIMIT_COUNT - 1)] += 1;
            }
        }
        let (mut inliers, mut best) = (0, (0, 0, f64::INFINITY));
        for (k, count) in counts.iter().enumerate() {
            inliers += count;
            if inliers <= S::SAMPLE {
                continue;
            }
            let free = (inliers - S::SAMPLE) as f64;
            let log = self.log_tests + self.log_choices[inliers] + free * self.log_chances[k];
            if log < best.2 {
                best = (k, inliers, log);
            }
        }
        let (k, inliers, log_false_alarms) = best;
        Scored { model, inliers, limit_px: self.limits_px[k], log_false_alarms }
    }

    fn polish<S: SampledModel>(&self, problem: &S, start: Scored<S::Model>) -> Scored<S::Model> {
        let mut best = start;
        for _ in 0..LOCAL_STEPS {
            let limit_px2 = best.limit_px * best.limit_px;
            let agrees = |k: &usize| problem.squared_residual_px2(&best.model, *k) <= limit_px2;
            let inliers: Vec<usize> = (0..problem.count()).filter(agrees).collect();
            let Some(model) = problem.fit_inliers(&best.model, &inliers) else { break };
            let scored = self.score(problem, model);
            if scored.log_false_alarms >= best.log_false_alarms {
                break;
            }
            best = scored;
        }
        best
    }
}

/// The probability that a random point in an image is within `limit_px` of a line through the
/// image.
pub fn chance_beside_line(size: ImageSize, limit_px: f64) -> f64 {
    let area = f64::from(size.width) * f64::from(size.height);
    2.0 * size.diagonal_px() * limit_px / area.max(1.0)
}

/// The probability that a random point in an image is within `limit_px` of a given point in it.
pub fn chance_in_disk(size: ImageSize, limit_px: f64) -> f64 {
    let area = f64::from(size.width) * f64::from(size.height);
    std::f64::consts::PI * limit_px * limit_px / area.max(1.0)
}

/// `size` different indices below `count`.
fn draw(random: &mut ChaCha8Rng, count: usize, size: usize) -> Vec<usize> {
    let mut sample = Vec::with_capacity(size);
    while sample.len() < size {
        let index = (random.next_u64() % count as u64) as usize;
        if !sample.contains(&index) {
            sample.push(index);
        }
    }
    sample
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With 99 %: the numbers of HZ table 4.3. A first model without inliers does not end sampling.
    #[test]
    fn samples_are_drawn_until_a_better_model_is_hardly_missed() {
        let options = RansacOptions { miss_probability: 0.01, ..RansacOptions::default() };
        for (size, outliers, samples) in [(4, 0.3, 17), (8, 0.3, 78), (7, 0.5, 588)] {
            assert_eq!(samples_needed(1.0 - outliers, size, &options), samples);
        }
        assert_eq!(samples_needed(0.0, 7, &options), options.max_samples);
        assert_eq!(samples_needed(1e-4, 7, &options), options.max_samples);
        assert_eq!(samples_needed(1.0, 7, &options), LEAST_SAMPLES);
    }
}
