//! One linearisation of the corner model over its samples: residuals, derivatives and their sums of products, in lanes.

use pulp::{Simd, WithSimd};

use crate::detection::refine::corner_model::{CornerModel, UNKNOWNS};
use crate::detection::refine::gaussian::edge_profile;
use crate::detection::refine::samples::Samples;

/// The derivatives by each unknown, then the residual.
const COLUMNS: usize = UNKNOWNS + 1;

/// How noisy a sample is, and how wrong the model may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of the noise where the pattern is black, in grey levels.
    pub black: f64,
    /// Standard deviation of the noise where the pattern is white, in grey levels.
    pub white: f64,
    /// A residual of this many grey levels has lost three quarters of its weight.
    pub tolerance: f64,
}

/// The sums of a linearisation. Weights are 1/σ² of the noise, less for the window's border and for outliers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct NormalEquations {
    /// Sums of products of derivatives, the lower triangle.
    pub normal: [[f64; UNKNOWNS]; UNKNOWNS],
    /// Sums of derivative times residual (seen less modelled).
    pub gradient: [f64; UNKNOWNS],
    /// Sum of the residuals' squares, in units of the noise.
    pub squares: f64,
    /// Sum of the weights of the window and of outliers, without the noise's: the number of samples in effect.
    pub effective: f64,
    /// Residuals where the pattern is flat: sum of squares in grey levels and their number, black then white.
    pub flat: [(f64, f64); 2],
}

/// Columns of derivatives, kept to be used again.
#[derive(Debug, Default)]
pub(super) struct Columns {
    lanes: Vec<f32>,
}

/// Linearises `model` over `samples`.
pub(super) fn linearise(
    samples: &Samples,
    model: &CornerModel,
    noise: &Noise,
    columns: &mut Columns,
) -> NormalEquations {
    pulp::Arch::new().dispatch(Linearise { samples, model, noise, columns })
}

struct Linearise<'a> {
    samples: &'a Samples,
    model: &'a CornerModel,
    noise: &'a Noise,
    columns: &'a mut Columns,
}

impl WithSimd for Linearise<'_> {
    type Output = NormalEquations;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> NormalEquations {
        let length = self.samples.x.len();
        self.columns.lanes.resize(length * COLUMNS, 0.0);
        let mut equations = NormalEquations::default();
        derivatives(simd, self.samples, self.model, self.noise, &mut self.columns.lanes, &mut equations);
        products(simd, &self.columns.lanes, length, &mut equations);
        equations
    }
}

/// Residuals and derivatives, each times the square root of its sample's weight, into `columns`.
#[inline(always)]
fn derivatives<S: Simd>(
    simd: S,
    samples: &Samples,
    model: &CornerModel,
    noise: &Noise,
    columns: &mut [f32],
    equations: &mut NormalEquations,
) {
    let of = |value: f64| simd.splat_f32s(value as f32);
    let mul = |a, b| simd.mul_f32s(a, b);
    let mul_add = |a, b, c| simd.mul_add_f32s(a, b, c);
    let one = of(1.0);
    let length = samples.x.len();
    let (xs, ys) = (S::as_simd_f32s(&samples.x).0, S::as_simd_f32s(&samples.y).0);
    let (values, weights) = (S::as_simd_f32s(&samples.value).0, S::as_simd_f32s(&samples.weight).0);
    let mut rest = columns;
    let out: [&mut [S::f32s]; COLUMNS] = std::array::from_fn(|_| {
        let (column, tail) = std::mem::take(&mut rest).split_at_mut(length);
        rest = tail;
        S::as_mut_simd_f32s(column).0
    });
    let along = model.along.map(|d| d.map(of));
    let normals = model.normals().map(|n| n.map(of));
    let sharpness = model.sharpness.map(of);
    let half_curvature = model.curvature.map(|c| of(c / 2.0));
    let center = model.center.map(of);
    let rho = model.correlation();
    let (rho4, rho_half, rho2_sixth) = (of(4.0 * rho), of(rho / 2.0), of(rho * rho / 6.0));
    let rho2_third = of(rho * rho / 3.0);
    let (level, amplitude, bend) = (of(model.level), of(model.amplitude), of(model.bend));
    let gradient = model.gradient.map(of);
    let sign = model.amplitude.signum();
    let noise_mean = of((noise.black + noise.white) / 2.0);
    let noise_slope = of(sign * (noise.white - noise.black) / 2.0);
    let tolerance = of(noise.tolerance * noise.tolerance);
    let flat_at = of(0.985);
    let mut flat = [[of(0.0); 2]; 2];
    let mut effective = of(0.0);
    for i in 0..xs.len() {
        let (x, y, value) = (xs[i], ys[i], values[i]);
        let dx = simd.sub_f32s(x, center[0]);
        let dy = simd.sub_f32s(y, center[1]);
        let mut s = [one; 2];
        let mut d = [one; 2];
        let mut u = [one; 2];
        let mut p = [one; 2];
        let mut f = [one; 2];
        for k in 0..2 {
            s[k] = mul_add(along[k][0], dx, mul(along[k][1], dy));
            let straight = mul_add(normals[k][0], dx, mul(normals[k][1], dy));
            d[k] = simd.negate_mul_add_f32s(mul(half_curvature[k], s[k]), s[k], straight);
            u[k] = mul(d[k], sharpness[k]);
            (p[k], f[k]) = edge_profile(simd, u[k]);
        }
        // t and its derivatives by u₁ and u₂.
        let squared = [mul(u[0], u[0]), mul(u[1], u[1])];
        let hermite = [simd.sub_f32s(squared[0], one), simd.sub_f32s(squared[1], one)];
        let bells = mul(rho4, mul(f[0], f[1]));
        let cross = mul(u[0], u[1]);
        let series = mul_add(rho_half, cross, mul_add(rho2_sixth, mul(hermite[0], hermite[1]), one));
        let t = mul_add(p[0], p[1], mul(bells, series));
        let mut slope = [one; 2];
        for k in 0..2 {
            let o = 1 - k;
            let bracket = mul_add(rho_half, u[o], mul(mul(rho2_third, u[k]), hermite[o]));
            let bracket = simd.negate_mul_add_f32s(u[k], series, bracket);
            slope[k] = mul_add(mul(simd.add_f32s(f[k], f[k]), one), p[o], mul(bells, bracket));
        }
        let light = mul_add(gradient[0], x, mul_add(gradient[1], y, one));
        let off = simd.negate_mul_add_f32s(t, t, one);
        let grey = mul_add(bend, off, mul_add(amplitude, t, level));
        let residual = simd.negate_mul_add_f32s(grey, light, value);
        // Noise grows from black to white; outliers lose weight (Geman & McClure).
        let sd = mul_add(noise_slope, t, noise_mean);
        let sd_scale = simd.add_f32s(tolerance, mul(residual, residual));
        let trust = simd.div_f32s(mul(weights[i], tolerance), mul(sd_scale, sd));
        let doubt = mul(trust, sd);
        effective = mul_add(doubt, doubt, effective);
        let by_t = mul(mul(simd.negate_mul_add_f32s(simd.add_f32s(bend, bend), t, amplitude), light), trust);
        let by_u = [mul(by_t, slope[0]), mul(by_t, slope[1])];
        let by_d = [mul(by_u[0], sharpness[0]), mul(by_u[1], sharpness[1])];
        let lit = mul(light, trust);
        let shade = mul(grey, trust);
        out[0][i] = simd.neg_f32s(by_d[0]);
        out[1][i] = simd.neg_f32s(by_d[1]);
        out[2][i] = mul(shade, x);
        out[3][i] = mul(shade, y);
        out[4][i] = simd.neg_f32s(mul(by_d[0], s[0]));
        out[5][i] = simd.neg_f32s(mul(by_d[1], s[1]));
        out[6][i] = mul(by_u[0], d[0]);
        out[7][i] = mul(by_u[1], d[1]);
        out[8][i] = lit;
        out[9][i] = mul(lit, t);
        out[10][i] = mul(lit, off);
        out[11][i] = mul(residual, trust);
        // Where the pattern is flat, what is left is noise.
        let square = mul(mul(residual, residual), mul(doubt, doubt));
        for (side, sums) in flat.iter_mut().enumerate() {
            let towards = if side == 0 { simd.neg_f32s(t) } else { t };
            let is_flat = simd.less_than_f32s(flat_at, towards);
            let count = simd.select_f32s(is_flat, mul(doubt, doubt), of(0.0));
            sums[0] = simd.add_f32s(sums[0], simd.select_f32s(is_flat, square, of(0.0)));
            sums[1] = simd.add_f32s(sums[1], count);
        }
    }
    equations.effective = f64::from(simd.reduce_sum_f32s(effective));
    for (side, sums) in flat.iter().enumerate() {
        let side = if sign > 0.0 { side } else { 1 - side };
        equations.flat[side] = (f64::from(simd.reduce_sum_f32s(sums[0])), f64::from(simd.reduce_sum_f32s(sums[1])));
    }
}

/// Sums of products of the columns.
#[inline(always)]
fn products<S: Simd>(simd: S, columns: &[f32], length: usize, equations: &mut NormalEquations) {
    let column = |k: usize| S::as_simd_f32s(&columns[k * length..(k + 1) * length]).0;
    for rows in 0..COLUMNS / 4 {
        for others in 0..=rows {
            let a: [&[S::f32s]; 4] = std::array::from_fn(|k| column(4 * rows + k));
            for half in 0..2 {
                let b: [&[S::f32s]; 2] = std::array::from_fn(|k| column(4 * others + 2 * half + k));
                let mut sums = [[simd.splat_f32s(0.0); 2]; 4];
                for i in 0..length / S::F32_LANES {
                    for (sums, a) in sums.iter_mut().zip(&a) {
                        for (sum, b) in sums.iter_mut().zip(&b) {
                            *sum = simd.mul_add_f32s(a[i], b[i], *sum);
                        }
                    }
                }
                for (r, sums) in sums.iter().enumerate() {
                    for (c, sum) in sums.iter().enumerate() {
                        let (row, col) = (4 * rows + r, 4 * others + 2 * half + c);
                        equations.put(row, col, f64::from(simd.reduce_sum_f32s(*sum)));
                    }
                }
            }
        }
    }
}

impl NormalEquations {
    fn put(&mut self, row: usize, col: usize, sum: f64) {
        match (row, col) {
            (UNKNOWNS, UNKNOWNS) => self.squares = sum,
            (UNKNOWNS, col) => self.gradient[col] = sum,
            (row, UNKNOWNS) => self.gradient[row] = sum,
            (row, col) if col <= row => self.normal[row][col] = sum,
            _ => {}
        }
    }
}
