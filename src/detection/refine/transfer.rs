//! Gray values and light: a camera's gamma.

use crate::detection::refine::corner_model::CornerModel;

/// The darkest gray level: half a step of eight bits. And the range of powers that may make gray
/// levels proportional to light: somewhat wider than from a linear camera's 1 to the 2.2 to 2.6 of
/// displays.
const DARKEST: f64 = 0.5;
pub(super) const POWERS: [f64; 2] = [0.7, 3.0];

/// Gray values of a pattern, 1 white and −1 black, in a camera whose gray values to a power are
/// proportional to light (its gamma).
pub(super) struct Transfer {
    middle: f64,
    half: f64,
    inverse: f64,
}

impl Transfer {
    pub fn of(model: &CornerModel, power: f64) -> Self {
        let [black, white] = black_and_white(model).map(|gray| gray.powf(power));
        Self { middle: (white + black) / 2.0, half: (white - black) / 2.0, inverse: 1.0 / power }
    }

    pub fn at(&self, pattern: f32) -> f32 {
        let light = self.middle + self.half * f64::from(pattern);
        light.max(0.0).powf(self.inverse) as f32
    }
}

fn black_and_white(model: &CornerModel) -> [f64; 2] {
    let half = model.amplitude.abs();
    [model.level - half, model.level + half].map(|gray| gray.max(DARKEST))
}

/// The power of gray values at which the mean of black and white, in light, is the gray value that
/// `model` has at its edges.
pub(super) fn linear_power(model: &CornerModel) -> f64 {
    let [black, white] = black_and_white(model);
    let edge = (model.level + model.gamma_term).max(DARKEST);
    // Above the root, the light at the edge is less than the mean of black and white.
    let mean_less_edge = |power: f64| (black / edge).powf(power) + (white / edge).powf(power) - 2.0;
    let [mut low, mut high] = POWERS;
    if mean_less_edge(high) < 0.0 {
        return high;
    }
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if mean_less_edge(middle) < 0.0 { low = middle } else { high = middle }
    }
    high
}
