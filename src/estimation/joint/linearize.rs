//! Residuals and their derivatives, one observation of the board at a time, and their products in
//! the normal equations.
//!
//! An observation's derivatives are stored as columns (one parameter each; all corners' x, then all
//! corners' y), so that every product of the normal equations is a dot product of two contiguous
//! columns. Local columns: the lens's free parameters, the warp's two, the pose's six (rotation ω,
//! translation τ in the sensor's frame), the residual.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::robust::Loss;
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::lens::Lens;
use crate::geometry::lens::columns::DistortedColumns;

/// The normal equations of one observation in its local columns: `products[i * columns + j]` for i
/// ≤ j.
#[derive(Debug, Clone, Default)]
pub(crate) struct LocalEquations {
    pub(crate) columns: usize,
    pub(crate) products: Vec<f64>,
    /// Σ ρ(residual²) of the loss.
    pub(crate) cost: f64,
}

impl LocalEquations {
    pub(crate) fn product(&self, i: usize, j: usize) -> f64 {
        self.products[i.min(j) * self.columns + i.max(j)]
    }
}

/// Buffers for one observation's columns, reused between observations.
#[derive(Debug, Default)]
pub(crate) struct Columns {
    /// Rotated points (without the translation), then points in the camera frame: x, y, z each.
    points: [Vec<f64>; 6],
    distorted: DistortedColumns,
    /// The residuals in pixels, and √weight / std of each corner; the latter is 0 for an unused
    /// corner.
    miss: [Vec<f64>; 2],
    factor: Vec<f64>,
    values: Vec<f64>,
}

impl Columns {
    /// The weighted Jacobian of the observation linearized last: its local columns, each all
    /// corners' x, then all corners' y, padded with zeros.
    pub(crate) fn values(&self) -> &[f64] {
        &self.values
    }
}

/// Columns are padded with zeros to a multiple of this, the width of the widest vectors.
const LANES: usize = 8;

/// Where observations are linearized.
#[derive(Clone, Copy)]
pub(crate) struct LinearizationPoint<'a> {
    /// Which parameters are free.
    pub(crate) layout: &'a Layout,
    /// The values of all parameters.
    pub(crate) state: &'a State,
}

/// One observation, linearized.
pub(crate) struct LinearizedObservation<'a> {
    /// Per corner (projected − observed) / std, without the loss's weight.
    pub(crate) residuals: &'a mut [[f64; 2]],
    /// The products of its columns, and its cost.
    pub(crate) local: &'a mut LocalEquations,
}

/// Linearizes one observation. Returns false where a used corner cannot be projected.
pub(crate) fn linearize_observation(
    at: LinearizationPoint<'_>,
    observation: &BoardObservation,
    loss: Loss,
    columns: &mut Columns,
    into: LinearizedObservation<'_>,
) -> bool {
    Arch::new().dispatch(Linearization { at, observation, loss, columns, into, multiplied: true })
}

/// As [`linearize_observation`], without the products of its columns: in the local equations only
/// the cost is set.
pub(crate) fn differentiate_observation(
    at: LinearizationPoint<'_>,
    observation: &BoardObservation,
    loss: Loss,
    columns: &mut Columns,
    into: LinearizedObservation<'_>,
) -> bool {
    Arch::new().dispatch(Linearization { at, observation, loss, columns, into, multiplied: false })
}

struct Linearization<'a> {
    at: LinearizationPoint<'a>,
    observation: &'a BoardObservation,
    loss: Loss,
    columns: &'a mut Columns,
    into: LinearizedObservation<'a>,
    /// Whether the products of the columns are computed too.
    multiplied: bool,
}

impl WithSimd for Linearization<'_> {
    type Output = bool;

    /// The loops below are plain: compiled in here, they use the machine's widest vectors.
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> bool {
        self.transform();
        let points = [3, 4, 5].map(|k| self.columns.points[k].as_slice());
        self.at.state.lenses[self.observation.sensor]
            .distort_columns(points, &mut self.columns.distorted);
        if !self.weigh() {
            return false;
        }
        let count = self.differentiate();
        if self.multiplied {
            multiply_columns(simd, &self.columns.values, count, self.into.local);
        }
        true
    }
}

impl Linearization<'_> {
    /// Transforms the corners to the sensor's frame, padded with points on the optical axis.
    #[inline(always)]
    fn transform(&mut self) {
        let sensor_from_board =
            self.at.state.sensor_from_board(self.observation.sensor, self.observation.frame_set);
        let (r, t) = (sensor_from_board.rotation_matrix(), sensor_from_board.translation());
        let padded = self.observation.points.len().max(1).next_multiple_of(LANES);
        let [x, y, z, moved @ ..] = &mut self.columns.points;
        for (column, (rotated, moved)) in [x, y, z].into_iter().zip(moved).enumerate() {
            let row = [r[(column, 0)], r[(column, 1)], r[(column, 2)]];
            let on_axis = f64::from(u8::from(column == 2));
            rotated.resize(padded, 0.0);
            moved.resize(padded, 0.0);
            rotated[self.observation.points.len()..].fill(on_axis);
            moved[self.observation.points.len()..].fill(on_axis);
            for (rotated, point) in rotated.iter_mut().zip(&self.observation.points) {
                *rotated = row[0] * point.x + row[1] * point.y + row[2] * point.z;
            }
            if self.at.layout.warp.is_some() {
                for (rotated, point) in rotated.iter_mut().zip(&self.observation.points) {
                    *rotated += row[2] * self.at.state.bow(self.at.layout, point);
                }
            }
            for (moved, rotated) in
                moved.iter_mut().zip(&*rotated).take(self.observation.points.len())
            {
                *moved = rotated + t[column];
            }
        }
    }

    /// Residuals, weights and cost; false where a used corner cannot be projected.
    #[inline(always)]
    fn weigh(&mut self) -> bool {
        let matrix = self.at.state.lenses[self.observation.sensor].matrix;
        let Columns { distorted, miss: [miss_x, miss_y], factor, points, .. } = &mut *self.columns;
        let ([xs, ys], inside) = (distorted.normalized(), distorted.inside());
        for column in [&mut *miss_x, &mut *miss_y, &mut *factor] {
            column.clear();
            column.resize(points[0].len(), 0.0);
        }
        let (mut cost, mut all_seen) = (0.0, true);
        for (index, residual) in self.into.residuals.iter_mut().enumerate() {
            let observed = self.observation.pixels[index];
            let inverse_std = self.observation.inverse_std[index];
            let miss = [
                matrix.fx * xs[index] + matrix.skew * ys[index] + matrix.cx - observed.x,
                matrix.fy * ys[index] + matrix.cy - observed.y,
            ];
            let seen = inside[index] > 0.0;
            *residual = if seen { miss.map(|m| m * inverse_std) } else { [f64::INFINITY; 2] };
            if self.observation.used[index] {
                all_seen &= seen;
                let loss = self.loss.at(residual[0] * residual[0] + residual[1] * residual[1]);
                cost += loss.cost;
                factor[index] = loss.weight.sqrt() * inverse_std;
            }
            (miss_x[index], miss_y[index]) = (miss[0], miss[1]);
        }
        self.into.local.cost = cost;
        all_seen && cost.is_finite()
    }

    /// The weighted derivatives and residuals; returns the number of columns.
    #[inline(always)]
    fn differentiate(&mut self) -> usize {
        let lens_layout = &self.at.layout.sensors[self.observation.sensor].lens;
        let matrix = self.at.state.lenses[self.observation.sensor].matrix;
        let (free, warped) =
            (lens_layout.free.len(), if self.at.layout.warp.is_some() { 2 } else { 0 });
        let count = free + warped + 7;
        let Columns { distorted, miss, factor, points, values } = &mut *self.columns;
        let rows = 2 * factor.len();
        values.resize(count * rows, 0.0);
        let (by_lens, rest) = values.split_at_mut(free * rows);
        let (by_warp, rest) = rest.split_at_mut(warped * rows);
        let (by_pose, residual) = rest.split_at_mut(6 * rows);
        for (parameter, column) in lens_layout.free.iter().zip(by_lens.chunks_exact_mut(rows)) {
            fill_lens_column(
                *parameter,
                lens_layout.square_pixels,
                &matrix,
                distorted,
                factor,
                column,
            );
        }
        fill_pose_columns(points, &matrix, distorted, factor, by_pose);
        if warped == 2 {
            let normal = self
                .at
                .state
                .sensor_from_board(self.observation.sensor, self.observation.frame_set)
                * Vector3::z();
            fill_warp_columns(self.at.layout, self.observation, normal, by_pose, by_warp);
        }
        for (column, miss) in residual.chunks_exact_mut(factor.len()).zip(&*miss) {
            for ((value, miss), factor) in column.iter_mut().zip(miss).zip(&*factor) {
                *value = miss * factor;
            }
        }
        count
    }
}

/// One lens parameter's column, by its index in [`crate::geometry::lens::Lens::parameters`].
#[inline(always)]
fn fill_lens_column(
    parameter: usize,
    square_pixels: bool,
    matrix: &CameraMatrix,
    distorted: &DistortedColumns,
    factor: &[f64],
    column: &mut [f64],
) {
    let (x, y) = column.split_at_mut(factor.len());
    let [xs, ys] = distorted.normalized();
    let weighted = |out: &mut [f64], values: &[f64]| {
        for ((out, value), factor) in out.iter_mut().zip(values).zip(factor) {
            *out = value * factor;
        }
    };
    match parameter {
        Lens::FX if square_pixels => (weighted(x, xs), weighted(y, ys)),
        Lens::FX => (weighted(x, xs), y.fill(0.0)),
        Lens::FY => (x.fill(0.0), weighted(y, ys)),
        Lens::CX => (x.copy_from_slice(factor), y.fill(0.0)),
        Lens::CY => (x.fill(0.0), y.copy_from_slice(factor)),
        Lens::SKEW => (weighted(x, ys), y.fill(0.0)),
        coefficient => {
            let [by_x, by_y] = distorted.by_coefficient(coefficient - Lens::FIRST_COEFFICIENT);
            for (index, factor) in factor.iter().enumerate() {
                x[index] = (matrix.fx * by_x[index] + matrix.skew * by_y[index]) * factor;
                y[index] = matrix.fy * by_y[index] * factor;
            }
            ((), ())
        }
    };
}

/// The six columns of the pose: by translation ∂pixel/∂point, by rotation (rotated point) ×
/// ∂pixel/∂point.
#[inline(always)]
fn fill_pose_columns(
    points: &[Vec<f64>; 6],
    matrix: &CameraMatrix,
    distorted: &DistortedColumns,
    factor: &[f64],
    columns: &mut [f64],
) {
    let half = factor.len();
    let (rotation, translation) = columns.split_at_mut(6 * half);
    for (axis, column) in translation.chunks_exact_mut(2 * half).enumerate() {
        let [by_x, by_y] = distorted.by_point(axis);
        let (x, y) = column.split_at_mut(half);
        for (index, factor) in factor.iter().enumerate() {
            x[index] = (matrix.fx * by_x[index] + matrix.skew * by_y[index]) * factor;
            y[index] = matrix.fy * by_y[index] * factor;
        }
    }
    for (axis, column) in rotation.chunks_exact_mut(2 * half).enumerate() {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        let (p_next, p_last) = (&points[next][..half], &points[last][..half]);
        for (axis, column) in column.chunks_exact_mut(half).enumerate() {
            let by_next = &translation[(2 * next + axis) * half..][..half];
            let by_last = &translation[(2 * last + axis) * half..][..half];
            for (index, value) in column.iter_mut().enumerate() {
                *value = p_next[index] * by_last[index] - p_last[index] * by_next[index];
            }
        }
    }
}

/// The two columns of the warp, which moves points along the board's normal.
#[inline(always)]
fn fill_warp_columns(
    layout: &Layout,
    observation: &BoardObservation,
    normal: Vector3<f64>,
    by_pose: &[f64],
    columns: &mut [f64],
) {
    let rows = by_pose.len() / 6;
    columns.fill(0.0);
    for (which, column) in columns.chunks_exact_mut(rows).enumerate() {
        for half in 0..2 {
            for (index, point) in observation.points.iter().enumerate() {
                let row = half * rows / 2 + index;
                let by_normal: f64 =
                    (0..3).map(|axis| normal[axis] * by_pose[(3 + axis) * rows + row]).sum();
                column[row] = by_normal * layout.bows(point)[which];
            }
        }
    }
}

/// All dot products of `count` columns of equal length, which is a multiple of [`LANES`].
pub(crate) fn multiply(values: &[f64], count: usize, local: &mut LocalEquations) {
    Arch::new().dispatch(Products { values, count, local });
}

struct Products<'a> {
    values: &'a [f64],
    count: usize,
    local: &'a mut LocalEquations,
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        multiply_columns(simd, self.values, self.count, self.local);
    }
}

/// All dot products of columns, in tiles of 2 × 4 so that each load serves several.
#[inline(always)]
fn multiply_columns<S: Simd>(simd: S, values: &[f64], count: usize, local: &mut LocalEquations) {
    let rows = values.len() / count;
    local.columns = count;
    local.products.clear();
    local.products.resize(count * count, 0.0);
    let column = |k: usize| S::as_simd_f64s(&values[k.min(count - 1) * rows..][..rows]).0;
    for i in (0..count).step_by(2) {
        for j in (i..count).step_by(4) {
            let (left, right) =
                ([0, 1].map(|a| column(i + a)), [0, 1, 2, 3].map(|b| column(j + b)));
            for (a, sums) in tile(simd, left, right).into_iter().enumerate() {
                for (b, sum) in sums.into_iter().enumerate() {
                    if i + a < count && j + b < count {
                        local.products[(i + a) * count + j + b] = simd.reduce_sum_f64s(sum);
                    }
                }
            }
        }
    }
}

/// The products of each of two columns with each of four, lane by lane.
#[inline(always)]
fn tile<S: Simd>(
    simd: S,
    [a, b]: [&[S::f64s]; 2],
    [p, q, r, s]: [&[S::f64s]; 4],
) -> [[S::f64s; 4]; 2] {
    let mut sums = [[simd.splat_f64s(0.0); 4]; 2];
    for (((((a, b), p), q), r), s) in a.iter().zip(b).zip(p).zip(q).zip(r).zip(s) {
        for (sums, left) in sums.iter_mut().zip([a, b]) {
            for (sum, right) in sums.iter_mut().zip([p, q, r, s]) {
                *sum = simd.mul_add_f64s(*left, *right, *sum);
            }
        }
    }
    sums
}
