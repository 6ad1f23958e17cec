//! Tests of corners under a highlight that saturates: their errors and scatter compared with the
//! stated uncertainty, and each derivative compared with finite differences.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::detection::refine::fit::{FitOptions, fit};
use crate::detection::refine::window::Window;
use crate::imaging::gray::GrayImage;

const REACH: f64 = 11.0;
const POWER: f64 = 2.2;
const NOISE: Noise = Noise { black: 1.0, white: 1.0, tolerance: 12.0 };
/// Added tolerances as of the detector.
const TOLERANCES: [f64; 4] = [0.5, 0.3, 0.15, 0.05];
const MODEL: CornerModel = CornerModel {
    center: [0.3, -0.2],
    along: [[0.980_067, 0.198_669], [-0.099_833, 0.995_004]],
    sharpness: [0.9, 0.8],
    curvature: [0.0; 2],
    level: 150.0,
    amplitude: 80.0,
    gamma_term: 0.0,
    gradient: [0.0; 2],
};

/// Samples of the corner's pattern, which is what their values are.
fn samples() -> Samples {
    let window = Window {
        origin: [20.0, 20.0],
        axes: [[REACH, 0.0], [0.0, REACH]],
        extent: [1.0; 2],
        strip_px: f64::INFINITY,
        bin: 1,
    };
    let mut samples = Samples::default();
    samples.gather(GrayImage::filled(41, 41, 0).view(), &window);
    let (mut columns, mut equations) = (ModelColumns::default(), CornerEquations::default());
    let plain = Noise { black: 1.0, white: 1.0, tolerance: 1e6 };
    let linearized = Linearized { samples: &samples, noise: &plain, with_flat: false };
    linearized.at(&pattern(&MODEL), &mut columns, &mut equations);
    let mut less_pattern = columns.values(RESIDUAL).iter();
    samples.change(|_, _, _| -less_pattern.next().copied().unwrap_or(0.0));
    samples
}

/// Gray levels of black 0.06 and white 0.85 in light, to which a highlight twice as wide as the
/// window adds up to 1.2 beside it, with noise of one level: a part of the samples is at white.
fn highlighted(seed: u64) -> Samples {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let middle = [30.0 + 3.0 * normal(), 10.0 * normal()];
    let mut samples = samples();
    samples.change(|x, y, t| {
        let from_middle = f64::hypot(f64::from(x) - middle[0], f64::from(y) - middle[1]);
        let highlight = 1.2 * (-0.5 * (from_middle / 25.0).powi(2)).exp();
        let light = 0.455 + 0.395 * f64::from(t) + highlight;
        let gray = WHITE * light.powf(1.0 / POWER) + normal();
        gray.round().clamp(0.0, WHITE) as f32
    });
    samples
}

fn local_light<'a>(samples: &'a Samples, noise: &'a Noise) -> LocalLightFit<'a> {
    let (reach, power, enough) = (REACH, POWER, 0.05);
    LocalLightFit { samples, noise, tolerances: &TOLERANCES, reach, power, enough }
}

#[test]
fn corners_under_a_highlight_scatter_as_stated() {
    const SEEDS: u64 = 200;
    let options = FitOptions { iterations: [1, 4], enough: 0.05, alike: 0.0, with_flat: false };
    let (mut lit_z2, mut plain_px2, mut lit_px2, mut mean) = (0.0, 0.0, 0.0, [0.0; 2]);
    for seed in 0..SEEDS {
        let samples = highlighted(seed);
        let at_white = samples.vectors::<pulp::Scalar>()[2].iter().filter(|&&v| v > 254.5).count();
        assert!(at_white > 20, "{at_white} samples at white");
        let plain = fit(&samples, MODEL, &NOISE, &options, &mut ModelColumns::default()).unwrap();
        let lit = local_light(&samples, &NOISE);
        let lit = lit.fit(plain.model, &mut ModelColumns::default()).unwrap();
        assert!(lit.mean_square < 0.5 * plain.mean_square, "seed {seed}");
        let off = |fit: &CornerFit| [0, 1].map(|k| fit.model.center[k] - MODEL.center[k]);
        let px2 = |[x, y]: [f64; 2]| (x * x + y * y) / 2.0;
        lit_z2 += px2(off(&lit)) / lit.position_std().powi(2) / SEEDS as f64;
        lit_px2 += px2(off(&lit)) / SEEDS as f64;
        plain_px2 += px2(off(&plain)) / SEEDS as f64;
        (0..2).for_each(|k| mean[k] += off(&lit)[k] / SEEDS as f64);
    }
    assert!((0.9..1.15).contains(&lit_z2.sqrt()), "{}", lit_z2.sqrt());
    assert!(plain_px2 > 25.0 * lit_px2, "{plain_px2} {lit_px2}");
    assert!(mean.iter().all(|off| off.abs() < 0.003), "{mean:?}");
}

#[test]
fn the_equations_are_the_slope_of_the_sum_of_squares() {
    let mut samples = samples();
    samples.change(|x, _, t| 120.0 + 60.0 * t + x);
    let flat = Noise { black: 1.0, white: 1.0, tolerance: 1e6 };
    let lit_corner = local_light(&samples, &flat);
    let mut at = lit_corner.from(&MODEL);
    at.light = std::array::from_fn(|k| at.light[k] + 0.01 * (k as f64 - 5.0) / 5.0);
    let mut columns = ModelColumns::default();
    let equations = lit_corner.linearize(&at, flat.tolerance, &mut columns);
    for unknown in 0..UNKNOWNS {
        let moved = |size: f64| {
            let mut step = SVector::<f64, UNKNOWNS>::zeros();
            step[unknown] = size;
            let moved = at.moved_by(&step);
            lit_corner.linearize(&moved, flat.tolerance, &mut ModelColumns::default()).squares
        };
        let size = 1e-2 * if (SHAPES..SHAPES + TERMS).contains(&unknown) { 0.1 } else { 1.0 };
        let numeric = (moved(-size) - moved(size)) / (4.0 * size);
        let analytic = equations.products[unknown][UNKNOWNS];
        let scale = equations.products[unknown][unknown].sqrt() * equations.squares.sqrt();
        assert!((numeric - analytic).abs() < 0.01 * scale, "{unknown}: {analytic} {numeric}");
    }
}

#[test]
fn a_window_that_is_white_determines_no_corner() {
    let mut samples = samples();
    samples.change(|x, _, t| if x > -10.0 { WHITE as f32 } else { 120.0 + 60.0 * t });
    let answer = local_light(&samples, &NOISE).fit(MODEL, &mut ModelColumns::default());
    assert!(answer.is_none());
}
