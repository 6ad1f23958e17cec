//! Tests of the nine columns of the corner model against finite differences.

use pulp::Scalar;

use super::*;
use crate::detection::refine::corner_model::OFFSETS;
use crate::detection::refine::window::Window;
use crate::imaging::gray::GrayImage;

/// Weights of 1: noise of one gray level, and a tolerance far above any residual.
const FLAT: Noise = Noise { black: 1.0, white: 1.0, tolerance: 1e6 };
/// Columns agree to this share of their largest entry: the profile's own error (5·10⁻⁶) over the
/// step, and what the curvature's small terms leave out.
const TOLERANCE: f64 = 0.02;

fn model(angle: f64, crossing: f64) -> CornerModel {
    CornerModel {
        center: [0.3, -0.2],
        along: [[angle.cos(), angle.sin()], [(angle + crossing).cos(), (angle + crossing).sin()]],
        sharpness: [1.1, 0.8],
        curvature: [0.0005, -0.0008],
        level: 120.0,
        amplitude: 70.0,
        gamma_term: 12.0,
        gradient: [0.004, -0.006],
    }
}

fn samples() -> Samples {
    let pixels = (0..40 * 40).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let image = GrayImage::from_pixels(40, 40, pixels).expect("as many pixels");
    let axes = [[16.0, 2.0], [-3.0, 15.0]];
    let window =
        Window { origin: [20.0, 20.0], axes, extent: [0.6; 2], strip_px: f64::INFINITY, bin: 1 };
    let mut samples = Samples::default();
    samples.gather(image.view(), &window);
    samples
}

/// All columns at `model`, sample by sample: nine derivatives and the residual.
fn columns_at(samples: &Samples, model: &CornerModel) -> Vec<Vec<f64>> {
    let (mut columns, mut equations) = (ModelColumns::default(), CornerEquations::default());
    Linearized { samples, noise: &FLAT, with_flat: false }.at(model, &mut columns, &mut equations);
    let length = columns.lanes.len() / COLUMNS;
    let column = |k: usize| {
        let lanes = &columns.lanes[k * length..k * length + samples.count];
        lanes.iter().copied().map(f64::from).collect()
    };
    (0..COLUMNS).map(column).collect()
}

/// The change from a rotation of edge `edge` through the correlation ρ of the blur, which the
/// linearization holds fixed: ∂gray/∂ρ · ∂ρ/∂angle at each sample.
fn by_correlation(samples: &Samples, model: &CornerModel, edge: usize) -> Vec<f64> {
    let [xs, ys, ..] = samples.vectors::<Scalar>();
    let (rho, normals, pull) = (model.correlation(), model.normals(), model.pull_of_blur());
    let other = model.along[1 - edge];
    let rho_by_angle = normals[edge][0] * other[0] + normals[edge][1] * other[1];
    let at = |(&x, &y): (&f32, &f32)| {
        let (x, y) = (f64::from(x), f64::from(y));
        let u = [0, 1].map(|k| {
            let p = [x - model.center[0], y - model.center[1]];
            let s = model.along[k][0] * p[0] + model.along[k][1] * p[1];
            let d = normals[k][0] * p[0] + normals[k][1] * p[1] - pull[k];
            (d - model.curvature[k] / 2.0 * s * s) * model.sharpness[k]
        });
        let profiles = u.map(|u| edge_profile(Scalar, u as f32));
        let [(p0, f0), (p1, f1)] = profiles.map(|(p, f)| (f64::from(p), f64::from(f)));
        let hermite = (u[0] * u[0] - 1.0) * (u[1] * u[1] - 1.0);
        let t_by_rho = f0 * f1 * (1.0 + rho * u[0] * u[1] + rho * rho / 2.0 * hermite);
        let series = 1.0 + rho / 2.0 * u[0] * u[1] + rho * rho / 6.0 * hermite;
        let t = p0 * p1 + rho * f0 * f1 * series;
        let light = 1.0 + model.gradient[0] * x + model.gradient[1] * y;
        (model.amplitude - 2.0 * model.gamma_term * t) * light * t_by_rho * rho_by_angle
    };
    xs.iter().zip(ys).take(samples.count).map(at).collect()
}

#[test]
fn each_column_is_the_derivative_of_the_model() {
    let samples = samples();
    for (angle, crossing) in [(0.1, 1.55), (0.7, 1.2), (-0.4, 1.9)] {
        let model = model(angle, crossing);
        let columns = columns_at(&samples, &model);
        for unknown in 0..UNKNOWNS {
            let step = if (4..OFFSETS).contains(&unknown) { 1.0 } else { 0.02 };
            let residual = |size: f64| {
                let mut change = [0.0; UNKNOWNS];
                change[unknown] = size;
                columns_at(&samples, &model.moved_by(&change)).swap_remove(RESIDUAL)
            };
            let (ahead, behind) = (residual(step), residual(-step));
            let held = if unknown < 2 {
                by_correlation(&samples, &model, unknown)
            } else {
                vec![0.0; samples.count]
            };
            let analytic = &columns[unknown];
            let largest = analytic.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            for i in 0..samples.count {
                let numeric = (behind[i] - ahead[i]) / (2.0 * step) - held[i];
                assert!(
                    (numeric - analytic[i]).abs() < TOLERANCE * largest,
                    "unknown {unknown}, sample {i}: {} but {numeric} by differences (of {largest})",
                    analytic[i]
                );
            }
        }
    }
}
