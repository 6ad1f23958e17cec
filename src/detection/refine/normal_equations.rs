//! One linearization of the corner model over its samples: residuals, derivatives and the sums of
//! their products, vectorized.

use pulp::{Simd, WithSimd};

use crate::detection::refine::corner_model::{CornerModel, UNKNOWNS};
use crate::detection::refine::elimination::{COLUMNS, RowProducts};
use crate::detection::refine::gaussian::edge_profile;
use crate::detection::refine::samples::Samples;

/// The index of the column of residuals.
pub(super) const RESIDUAL: usize = UNKNOWNS;

/// How noisy a sample is, and how wrong the model may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of the noise where the pattern is black, in gray levels.
    pub black: f64,
    /// Standard deviation of the noise where the pattern is white, in gray levels.
    pub white: f64,
    /// A residual of this many gray levels has lost three quarters of its weight.
    pub tolerance: f64,
}

impl Noise {
    /// Mean variance over black and white.
    pub fn variance(&self) -> f64 {
        (self.black * self.black + self.white * self.white) / 2.0
    }

    /// Mean of `squares`, a sum as in `residuals`, in units of the noise, corrected for the robust
    /// weights: with weights w = (1 + x²/k²)⁻² the mean of w·x² over normal x is smaller than that
    /// of w by the factor 1 − 4/k², to first order in 1/k².
    pub fn corrected(&self, residuals: &Residuals, squares: f64) -> f64 {
        squares / (residuals.effective - UNKNOWNS as f64).max(1.0) * (1.0 + self.loss())
    }

    /// The square of a sum of derivatives times residuals, in units of its variance under this
    /// noise, with the same correction: robust weights reduce its mean by nearly (1 + 4/k²)⁻²
    /// (within 3 % for k ≥ 4).
    pub fn corrected_disagreement(&self, square: f64) -> f64 {
        square * (1.0 + self.loss()).powi(2)
    }

    fn loss(&self) -> f64 {
        4.0 * self.variance() / (self.tolerance * self.tolerance)
    }
}

/// The sums of a linearization. Weights are 1/σ² of the noise, reduced at the window's border and
/// for outliers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct CornerEquations {
    /// Sums of products of the derivatives and the residual (measured minus modeled).
    pub products: RowProducts,
    /// The residuals.
    pub residuals: Residuals,
}

/// How well a model fits.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Residuals {
    /// Sum of the residuals' squares, in units of the noise.
    pub squares: f64,
    /// Sum of the window's and the robust weights, without the noise's: the effective number of
    /// samples.
    pub effective: f64,
    /// Residuals where the pattern is flat, if requested: sum of squares about their mean in gray
    /// levels and their number, black then white.
    pub flat: [(f64, f64); 2],
}

/// Columns of derivatives and residuals; the buffer is reused.
#[derive(Debug, Default)]
pub(super) struct ModelColumns {
    lanes: Vec<f32>,
    /// Length of a column.
    length: usize,
}

impl ModelColumns {
    /// One column of the last linearization, sample by sample.
    pub fn values(&self, k: usize) -> &[f32] {
        &self.lanes[k * self.length..(k + 1) * self.length]
    }

    /// One column of the last linearization, which was of `count` vectors.
    #[inline(always)]
    pub fn column<S: Simd>(&self, k: usize, count: usize) -> &[S::f32s] {
        let length = count * S::F32_LANES;
        S::as_simd_f32s(&self.lanes[k * length..(k + 1) * length]).0
    }
}

/// What to linearize, and how.
#[derive(Debug, Clone, Copy)]
pub(super) struct Linearized<'a> {
    /// The measured samples.
    pub samples: &'a Samples,
    /// Their noise.
    pub noise: &'a Noise,
    /// Whether residuals where the pattern is flat are wanted.
    pub with_flat: bool,
}

impl Linearized<'_> {
    /// Linearizes `model`.
    pub fn at(
        &self,
        model: &CornerModel,
        columns: &mut ModelColumns,
        equations: &mut CornerEquations,
    ) {
        pulp::Arch::new().dispatch(Linearize { what: *self, model, columns, equations });
    }
}

struct Linearize<'a> {
    what: Linearized<'a>,
    model: &'a CornerModel,
    columns: &'a mut ModelColumns,
    equations: &'a mut CornerEquations,
}

impl WithSimd for Linearize<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { what, model, columns, equations } = self;
        let length = what.samples.count.next_multiple_of(S::F32_LANES);
        let size = length * COLUMNS;
        if columns.lanes.len() < size {
            columns.lanes.resize(size, 0.0);
        }
        columns.length = length;
        let lanes = &mut columns.lanes[..size];
        equations.residuals = if what.with_flat {
            derivatives::<S, true>(simd, what, model, lanes)
        } else {
            derivatives::<S, false>(simd, what, model, lanes)
        };
        products(simd, lanes, length, equations);
    }
}

/// Residuals and derivatives, each times the square root of its sample's weight, into `columns`.
#[inline(always)]
fn derivatives<S: Simd, const WITH_FLAT: bool>(
    simd: S,
    what: Linearized<'_>,
    model: &CornerModel,
    columns: &mut [f32],
) -> Residuals {
    let Linearized { samples, noise, .. } = what;
    let of = |value: f64| simd.splat_f32s(value as f32);
    let mul = |a, b| simd.mul_f32s(a, b);
    let mul_add = |a, b, c| simd.mul_add_f32s(a, b, c);
    let one = of(1.0);
    let [xs, ys, values, weights] = samples.vectors::<S>();
    let count = xs.len();
    let (ys, values, weights) = (&ys[..count], &values[..count], &weights[..count]);
    let mut rest = columns;
    let mut out: [&mut [S::f32s]; COLUMNS] = std::array::from_fn(|_| {
        let (column, tail) = std::mem::take(&mut rest).split_at_mut(count * S::F32_LANES);
        rest = tail;
        &mut S::as_mut_simd_f32s(column).0[..count]
    });
    // Scratch columns, overwritten below.
    let [s0, s1, d0, d1, p0, p1, f0, f1, ..] = &mut out;
    profiles(simd, [xs, ys], model, 0, [s0, d0, p0, f0]);
    profiles(simd, [xs, ys], model, 1, [s1, d1, p1, f1]);
    let sharpness = model.sharpness.map(of);
    let less_sharpness = model.sharpness.map(|k| of(-k));
    let rho = model.correlation();
    let (rho_half, rho2_sixth, rho2_third) =
        (of(rho / 2.0), of(rho * rho / 6.0), of(rho * rho / 3.0));
    let rho = of(rho);
    let (level, amplitude, gamma_term) =
        (of(model.level), of(model.amplitude), of(model.gamma_term));
    let gradient = model.gradient.map(of);
    let sign = model.amplitude.signum();
    let noise_mean = of((noise.black + noise.white) / 2.0);
    let noise_slope = of(sign * (noise.white - noise.black) / 2.0);
    let tolerance = of(noise.tolerance * noise.tolerance);
    let flat_at = of(0.985);
    let mut flat = [[of(0.0); 3]; 2];
    let mut effective = of(0.0);
    for i in 0..count {
        let (x, y, value) = (xs[i], ys[i], values[i]);
        let (s, d) = ([out[0][i], out[1][i]], [out[2][i], out[3][i]]);
        let (p, f) = ([out[4][i], out[5][i]], [out[6][i], out[7][i]]);
        let u = [mul(d[0], sharpness[0]), mul(d[1], sharpness[1])];
        // t and its derivatives by u₁ and u₂.
        let squared = [mul(u[0], u[0]), mul(u[1], u[1])];
        let hermite = [simd.sub_f32s(squared[0], one), simd.sub_f32s(squared[1], one)];
        let bells = mul(rho, mul(f[0], f[1]));
        let cross = mul(u[0], u[1]);
        let series =
            mul_add(rho_half, cross, mul_add(rho2_sixth, mul(hermite[0], hermite[1]), one));
        let t = mul_add(p[0], p[1], mul(bells, series));
        let mut slope = [one; 2];
        for k in 0..2 {
            let o = 1 - k;
            // The derivative of bells · series, in units of the bells.
            let less_series = simd.negate_mul_add_f32s(rho2_third, hermite[o], series);
            let bracket = simd.negate_mul_add_f32s(u[k], less_series, mul(rho_half, u[o]));
            slope[k] = mul_add(f[k], p[o], mul(bells, bracket));
        }
        let light = mul_add(gradient[0], x, mul_add(gradient[1], y, one));
        let off = simd.negate_mul_add_f32s(t, t, one);
        let gray = mul_add(gamma_term, off, mul_add(amplitude, t, level));
        let residual = simd.negate_mul_add_f32s(gray, light, value);
        // Noise grows from black to white; outliers lose weight (Geman & McClure).
        let sd = mul_add(noise_slope, t, noise_mean);
        let sd_scale = mul_add(residual, residual, tolerance);
        let trust = simd.div_f32s(mul(weights[i], tolerance), mul(sd_scale, sd));
        let doubt = mul(trust, sd);
        effective = mul_add(doubt, doubt, effective);
        let lit = mul(light, trust);
        let by_t =
            mul(simd.negate_mul_add_f32s(simd.add_f32s(gamma_term, gamma_term), t, amplitude), lit);
        for k in 0..2 {
            let by_u = mul(by_t, slope[k]);
            let by_offset = mul(by_u, less_sharpness[k]);
            out[k][i] = mul(by_offset, s[k]);
            out[2 + k][i] = mul(by_u, d[k]);
            out[7 + k][i] = by_offset;
        }
        out[4][i] = lit;
        out[5][i] = mul(lit, t);
        out[6][i] = mul(lit, off);
        out[9][i] = mul(residual, trust);
        if !WITH_FLAT {
            continue;
        }
        // Where the pattern is flat, the residual is noise.
        let weight = mul(doubt, doubt);
        let weighted = mul(residual, weight);
        for (side, sums) in flat.iter_mut().enumerate() {
            let towards = if side == 0 { simd.neg_f32s(t) } else { t };
            let is_flat = simd.less_than_f32s(flat_at, towards);
            let seen = simd.select_f32s(is_flat, weighted, of(0.0));
            sums[0] = simd.add_f32s(sums[0], simd.select_f32s(is_flat, weight, of(0.0)));
            sums[1] = simd.add_f32s(sums[1], seen);
            sums[2] = mul_add(seen, residual, sums[2]);
        }
    }
    let [minus, plus] = flat.map(|sums| {
        let [count, sum, squares] = sums.map(|sum| f64::from(simd.reduce_sum_f32s(sum)));
        (squares - sum * sum / count.max(1.0), count)
    });
    Residuals {
        squares: 0.0,
        effective: f64::from(simd.reduce_sum_f32s(effective)),
        flat: if sign > 0.0 { [minus, plus] } else { [plus, minus] },
    }
}

/// Position of samples along and across an edge, and its profile there: the step and its slope. A
/// loop of its own, short enough for out-of-order execution.
#[inline(always)]
fn profiles<S: Simd>(
    simd: S,
    [xs, ys]: [&[S::f32s]; 2],
    model: &CornerModel,
    edge: usize,
    [s_out, d_out, p_out, f_out]: [&mut [S::f32s]; 4],
) {
    let of = |value: f64| simd.splat_f32s(value as f32);
    let ([ax, ay], [nx, ny]) = (model.along[edge], model.normals()[edge]);
    let [x, y] = model.center;
    let along_offset = of(-ax * x - ay * y);
    let across_offset = of(-nx * x - ny * y - model.pull_of_blur()[edge]);
    let half_curvature = of(model.curvature[edge] / 2.0);
    let sharpness = of(model.sharpness[edge]);
    let [ax, ay, nx, ny] = [ax, ay, nx, ny].map(of);
    let count = xs.len();
    let (ys, s_out, d_out) = (&ys[..count], &mut s_out[..count], &mut d_out[..count]);
    let (p_out, f_out) = (&mut p_out[..count], &mut f_out[..count]);
    for i in 0..count {
        let s = simd.mul_add_f32s(ax, xs[i], simd.mul_add_f32s(ay, ys[i], along_offset));
        let straight = simd.mul_add_f32s(nx, xs[i], simd.mul_add_f32s(ny, ys[i], across_offset));
        let d = simd.negate_mul_add_f32s(simd.mul_f32s(half_curvature, s), s, straight);
        let (p, f) = edge_profile(simd, simd.mul_f32s(d, sharpness));
        (s_out[i], d_out[i], p_out[i], f_out[i]) = (s, d, p, f);
    }
}

/// Sums of products of the columns, in blocks: small enough for the registers, large enough to keep
/// the vector units busy.
#[inline(always)]
fn products<S: Simd>(simd: S, columns: &[f32], length: usize, equations: &mut CornerEquations) {
    let products = &mut equations.products;
    triangle::<S, 4>(simd, columns, length, 0, products);
    block::<S, 4, 2>(simd, columns, length, [0, 4], products);
    block::<S, 4, 2>(simd, columns, length, [0, 6], products);
    block::<S, 4, 2>(simd, columns, length, [0, 8], products);
    triangle::<S, 4>(simd, columns, length, 4, products);
    block::<S, 6, 2>(simd, columns, length, [4, 8], products);
    equations.residuals.squares = products[RESIDUAL][RESIDUAL];
}

/// `COUNT` columns of `length` samples, from `first` on.
#[inline(always)]
fn vectors<S: Simd, const COUNT: usize>(
    columns: &[f32],
    length: usize,
    first: usize,
) -> [&[S::f32s]; COUNT] {
    std::array::from_fn(|k| {
        let start = (first + k) * length;
        &S::as_simd_f32s(&columns[start..start + length]).0[..length / S::F32_LANES]
    })
}

/// Sums of products of R columns from `first[0]` on with C columns from `first[1]` on.
#[inline(always)]
fn block<S: Simd, const R: usize, const C: usize>(
    simd: S,
    columns: &[f32],
    length: usize,
    first: [usize; 2],
    products: &mut RowProducts,
) {
    let (a, b) =
        (vectors::<S, R>(columns, length, first[0]), vectors::<S, C>(columns, length, first[1]));
    let mut sums = [[simd.splat_f32s(0.0); C]; R];
    for i in 0..length / S::F32_LANES {
        for r in 0..R {
            for c in 0..C {
                sums[r][c] = simd.mul_add_f32s(a[r][i], b[c][i], sums[r][c]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (c, sum) in sums.iter().enumerate() {
            products[first[0] + r][first[1] + c] = f64::from(simd.reduce_sum_f32s(*sum));
        }
    }
}

/// Sums of products of N columns from `first` on with each other.
#[inline(always)]
fn triangle<S: Simd, const N: usize>(
    simd: S,
    columns: &[f32],
    length: usize,
    first: usize,
    products: &mut RowProducts,
) {
    let a = vectors::<S, N>(columns, length, first);
    let mut sums = [[simd.splat_f32s(0.0); N]; N];
    #[expect(clippy::needless_range_loop, reason = "all columns are read at the same place")]
    for i in 0..length / S::F32_LANES {
        for r in 0..N {
            for c in r..N {
                sums[r][c] = simd.mul_add_f32s(a[r][i], a[c][i], sums[r][c]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (c, sum) in sums.iter().enumerate().skip(r) {
            products[first + r][first + c] = f64::from(simd.reduce_sum_f32s(*sum));
        }
    }
}

impl Residuals {
    /// Their mean square, in units of the noise.
    pub fn mean_square(&self) -> f64 {
        self.squares / self.effective.max(1.0)
    }
}

#[cfg(test)]
#[path = "normal_equations_tests.rs"]
mod tests;
