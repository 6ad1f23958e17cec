//! How an image renders a print: blurred by lens, focus and motion during the exposure, and with
//! the camera's gamma.

use nalgebra::{Matrix2, Vector2};

/// The number of Newton steps: each leaves the square of the previous error. And the longest step,
/// in units of the differences that slopes are taken over: 30 % of a width. Swept: half and twice
/// of it give the same corners to 0.001 px.
const NEWTON_STEPS: usize = 3;
const MOST_STEPS: f64 = 10.0;
/// Standard deviations of the blur at which its kernel ends.
const KERNEL_REACH: f64 = 3.0;
/// How far any blur of a width reaches, in widths: three standard deviations of a round one that is
/// e^0.7 times as wide; half the path of a motion is at most 2.4 widths, and e^0.7 times that.
const ANY_REACH: f64 = 7.0;
/// Directions of motion that are tried, over a half turn. Chosen, not swept.
const ANGLES: usize = 12;
/// The fraction of the variance that is from motion: the first one tried, and the others. Chosen,
/// not swept.
const FIRST_MOTION_SHARE: f64 = 0.9;
const MOTION_SHARES: [f64; 6] = [0.5, 0.7, 0.8, 0.85, 0.94, 0.97];
/// The natural logarithm of the greatest error of a width, twice the 17 % by which widths of edges
/// were too large on AprilGrids; and the sections after which it is known to 1 %.
const MOST_LOG_WIDTH: f64 = 0.35;
const SECTIONS: usize = 8;
/// A motion is accepted if its misfit is less than this fraction of that of a round blur.
/// Chosen, not swept.
const MOST_MOTION_MISFIT: f64 = 0.8;
/// No lens and sensor has less blur, in pixels. Chosen: a pixel's own width is 0.29.
const SHARPEST_PX: f64 = 0.35;

/// How an image renders a print, common to a whole board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PrintRendering {
    pub blur: PrintBlur,
    /// Gray values to this power are proportional to light.
    pub power: f64,
}

/// A blur: a Gaussian followed by a uniform motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PrintBlur {
    /// The Gaussian's standard deviation, in pixels.
    pub sigma_px: f64,
    /// Half of the path of the motion, in pixels.
    pub line_px: [f64; 2],
}

impl PrintBlur {
    /// Without motion.
    pub fn round(sigma_px: f64) -> Self {
        Self { sigma_px, line_px: [0.0; 2] }
    }

    /// The root mean variance across two perpendicular edges, in pixels.
    pub fn width_px(&self) -> f64 {
        let [x, y] = self.line_px;
        (self.sigma_px * self.sigma_px + (x * x + y * y) / 6.0).sqrt()
    }

    /// A motion in the direction `angle` that has the fraction `share` of the variance across two
    /// perpendicular edges, which is 2·`blur_px`² in total.
    fn moving(blur_px: f64, angle: f64, share: f64) -> Self {
        let variance = 2.0 * blur_px * blur_px;
        // A uniform motion over 2h has a variance of h²/3.
        let half = (3.0 * share * variance).sqrt();
        let sigma_px = ((1.0 - share) * variance / 2.0).sqrt().max(SHARPEST_PX);
        let (sin, cos) = angle.sin_cos();
        Self { sigma_px, line_px: [half * cos, half * sin] }
    }

    /// How far any blur reaches that a search from this one tries, in samples of `bin` pixels.
    pub fn reach_of_any(self, bin: usize) -> i64 {
        (ANY_REACH * self.width_px() / bin as f64).ceil() as i64
    }

    /// How far it reaches, in samples of `bin` pixels.
    pub fn reach(self, bin: usize) -> i64 {
        let bin = bin as f64;
        line_reach(self.line_px.map(|v| v / bin)) + kernel_radius(self.sigma_px / bin)
    }

    /// The same in an image `factor` times as large.
    pub fn scaled(self, factor: f64) -> Self {
        Self { sigma_px: factor * self.sigma_px, line_px: self.line_px.map(|v| factor * v) }
    }

    /// The width with the least `misfit`, of those that differ from its own by at most 42 %.
    pub fn best_width(self, misfit: &mut dyn FnMut(Self) -> f64) -> Self {
        let at = |log: f64| misfit(self.scaled(log.exp()));
        self.scaled(golden_section([-MOST_LOG_WIDTH, MOST_LOG_WIDTH], SECTIONS, at).exp())
    }

    /// The blur with the least `misfit`, of those whose variance across perpendicular edges is that
    /// of `blur_px`.
    pub fn best(blur_px: f64, misfit: &mut dyn FnMut(Self) -> f64) -> Self {
        let round = Self::round(blur_px);
        let mut best = (MOST_MOTION_MISFIT * misfit(round), round);
        let mut at = (0.0, FIRST_MOTION_SHARE);
        let mut offer = |angle: f64, share: f64, at: &mut (f64, f64)| {
            let moving = Self::moving(blur_px, angle, share);
            let found = misfit(moving);
            if found < best.0 {
                best = (found, moving);
                *at = (angle, share);
            }
        };
        let step = std::f64::consts::PI / ANGLES as f64;
        (0..ANGLES).for_each(|k| offer(step * k as f64, FIRST_MOTION_SHARE, &mut at));
        let angle = at.0;
        MOTION_SHARES.iter().for_each(|share| offer(angle, *share, &mut at));
        let (angle, share) = at;
        [-0.5, -0.25, 0.25, 0.5].iter().for_each(|k| offer(angle + k * step, share, &mut at));
        best.1
    }
}

/// How far a motion to both ends of `line` reaches to each side, in samples.
pub(super) fn line_reach(line: [f64; 2]) -> i64 {
    line[0].abs().max(line[1].abs()).ceil() as i64
}

/// Half the width of a Gaussian's kernel.
pub(super) fn kernel_radius(sigma: f64) -> i64 {
    (KERNEL_REACH * sigma).ceil().max(1.0) as i64
}

/// The position of the minimum of `value` in a range, if it has one minimum there: to
/// 0.618^`sections` of the range (J. Kiefer: Sequential minimax search for a maximum, 1953).
pub(super) fn golden_section(
    [mut low, mut high]: [f64; 2],
    sections: usize,
    mut value: impl FnMut(f64) -> f64,
) -> f64 {
    let golden = (5_f64.sqrt() - 1.0) / 2.0;
    let mut inner = [high - golden * (high - low), low + golden * (high - low)];
    let mut found = inner.map(&mut value);
    for _ in 0..sections {
        if found[0] < found[1] {
            high = inner[1];
            inner = [high - golden * (high - low), inner[0]];
            found = [value(inner[0]), found[0]];
        } else {
            low = inner[0];
            inner = [inner[1], low + golden * (high - low)];
            found = [found[1], value(inner[1])];
        }
    }
    (low + high) / 2.0
}

/// The position of the minimum of `value` near [0, 0], and the value there: by Newton's method with
/// differences over `steps`, in steps of at most ten of them.
pub(super) fn least_near(
    steps: [f64; 2],
    value: &mut dyn FnMut([f64; 2]) -> f64,
) -> ([f64; 2], f64) {
    let mut at = [0.0; 2];
    let mut least = value(at);
    for _ in 0..NEWTON_STEPS {
        let mut beside = |i: f64, j: f64| value([at[0] + i * steps[0], at[1] + j * steps[1]]);
        let [right, left] = [beside(1.0, 0.0), beside(-1.0, 0.0)];
        let [below, above] = [beside(0.0, 1.0), beside(0.0, -1.0)];
        let mixed = beside(1.0, 1.0) - right - below + least;
        let slope = Vector2::new(right - left, below - above) / 2.0;
        let curvature = [right + left - 2.0 * least, below + above - 2.0 * least];
        let hessian = Matrix2::new(curvature[0], mixed, mixed, curvature[1]);
        let step = match hessian.cholesky() {
            Some(convex) => -convex.solve(&slope),
            None => -slope.map(f64::signum),
        };
        let step = step.map(|part| part.clamp(-MOST_STEPS, MOST_STEPS));
        let to = |part: f64| [0, 1].map(|k| at[k] + part * step[k] * steps[k]);
        let mut tried = [1.0, 0.25].into_iter().map(|part| (to(part), value(to(part))));
        let Some((next, smaller)) = tried.find(|(_, it)| *it < least) else { break };
        (at, least) = (next, smaller);
    }
    (at, least)
}

#[cfg(test)]
mod tests {
    use super::{golden_section, least_near};

    #[test]
    fn the_golden_section_finds_the_least_value_within_its_bound() {
        let found = golden_section([-0.35, 0.35], 8, |x| (x - 0.123).powi(2));
        assert!((found - 0.123).abs() < 0.7 * 0.618_f64.powi(8), "{found}");
    }

    #[test]
    fn correlated_unknowns_are_found_together() {
        // A valley: changing one of the two alone gains next to nothing.
        let value = |[x, y]: [f64; 2]| (x + y - 0.1).powi(2) + 0.01 * (x - y - 0.3).powi(2) + 2.0;
        let (at, least) = least_near([0.03, 0.06], &mut { value });
        assert!((at[0] - 0.2).abs() < 1e-6 && (at[1] + 0.1).abs() < 1e-6, "{at:?}");
        assert!((least - 2.0).abs() < 1e-9, "{least}");
    }

    #[test]
    fn what_cannot_be_made_less_stays_where_it_is() {
        let (at, least) = least_near([0.03, 0.06], &mut |_| 7.0);
        assert_eq!((at, least), ([0.0; 2], 7.0));
    }
}
