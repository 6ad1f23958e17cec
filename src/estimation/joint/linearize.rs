//! Residuals and their derivatives, one sight of the board at a time, squared into normal equations.
//!
//! A sight's derivatives are kept as columns (one parameter each, all corners), so that every product of the normal
//! equations is a dot product of two contiguous columns. Local columns: the lens's free parameters, the warp's two, the
//! pose's six (turn ω, shift τ in the sensor's frame), the residual.

use nalgebra::{Matrix3, Vector3};

use crate::estimation::joint::{Layout, Sight, State};
use crate::estimation::robust::Loss;

/// The normal equations of one sight in its local columns: `products[i * columns + j]` for i ≤ j.
#[derive(Debug, Default)]
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

/// Room for the columns of one sight, kept between sights.
#[derive(Debug, Default)]
pub(crate) struct Columns {
    values: Vec<f64>,
    rows: usize,
}

/// Rows of a column are padded to this many, with zeros.
const LANES: usize = 4;

/// Linearises one sight into `local`, with its unweighted residuals (in units of each corner's standard deviation) in
/// `residuals`. Answers false where a corner that takes part cannot be projected.
pub(crate) fn linearize_sight(
    (layout, state): (&Layout, &State),
    sight: &Sight,
    loss: Loss,
    columns: &mut Columns,
    (residuals, local): (&mut [[f64; 2]], &mut LocalEquations),
) -> bool {
    let lens_layout = &layout.sensors[sight.sensor].lens;
    let (free, warped) = (lens_layout.free.len(), if layout.warp.is_some() { 2 } else { 0 });
    let count = free + warped + 7;
    let half = sight.points.len().next_multiple_of(LANES);
    columns.rows = 2 * half;
    columns.values.clear();
    columns.values.resize(count * columns.rows, 0.0);
    let sensor_from_board = state.sensor_from_board(sight.sensor, sight.instant);
    let rotation = sensor_from_board.rotation_matrix();
    let translation = sensor_from_board.translation();
    let lens = &state.lenses[sight.sensor];
    local.cost = 0.0;
    for (index, residual) in residuals.iter_mut().enumerate() {
        let (offset, bow) = warp_at(layout, state, sight, index);
        let turned = rotation * (sight.points[index].coords + offset);
        let point = turned + translation;
        let Some(projection) = lens.project(&point.into()) else {
            *residual = [f64::INFINITY; 2];
            if sight.used[index] {
                return false;
            }
            continue;
        };
        let inverse_std = sight.inverse_std[index];
        let observed = sight.pixels[index];
        let miss = [projection.pixel.x - observed.x, projection.pixel.y - observed.y];
        *residual = miss.map(|m| m * inverse_std);
        if !sight.used[index] {
            continue;
        }
        let (cost, weight) = loss.cost_and_weight(residual[0] * residual[0] + residual[1] * residual[1]);
        local.cost += cost;
        let factor = weight.sqrt() * inverse_std;
        for (axis, miss) in miss.into_iter().enumerate() {
            let row = axis * half + index;
            let mut put = |column: usize, value: f64| columns.values[column * columns.rows + row] = value * factor;
            for (column, parameter) in lens_layout.free.iter().enumerate() {
                put(column, projection.by_parameters[(axis, *parameter)]);
            }
            if lens_layout.square_pixels && axis == 1 {
                put(0, projection.by_parameters[(1, 1)]);
            }
            let by_point: Vector3<f64> = projection.by_point.row(axis).transpose();
            if warped == 2 {
                let by_bow = by_point.dot(&rotation.column(2));
                put(free, by_bow * bow[0]);
                put(free + 1, by_bow * bow[1]);
            }
            let by_turn = turned.cross(&by_point);
            for k in 0..3 {
                put(free + warped + k, by_turn[k]);
                put(free + warped + 3 + k, by_point[k]);
            }
            put(count - 1, miss);
        }
    }
    multiply(columns, count, local);
    local.cost.is_finite()
}

/// How far a point of the board is moved by its warp, and by how much per metre of each of the two bows:
/// 1 − (x/half extent)², 0 at the edges (mrcal's model).
fn warp_at(layout: &Layout, state: &State, sight: &Sight, index: usize) -> (Vector3<f64>, [f64; 2]) {
    let Some((_, [half_x, half_y])) = layout.warp else { return (Vector3::zeros(), [0.0; 2]) };
    let point = sight.points[index];
    let bow = [1.0 - (point.x / half_x).powi(2), 1.0 - (point.y / half_y).powi(2)];
    (Vector3::new(0.0, 0.0, state.warp[0] * bow[0] + state.warp[1] * bow[1]), bow)
}

/// All dot products of columns.
fn multiply(columns: &Columns, count: usize, local: &mut LocalEquations) {
    local.columns = count;
    local.products.clear();
    local.products.resize(count * count, 0.0);
    for i in 0..count {
        let a = &columns.values[i * columns.rows..(i + 1) * columns.rows];
        for j in i..count {
            let b = &columns.values[j * columns.rows..(j + 1) * columns.rows];
            let mut sums = [0.0; LANES];
            for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
                for lane in 0..LANES {
                    sums[lane] += a[lane] * b[lane];
                }
            }
            local.products[i * count + j] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        }
    }
}

/// The matrix of the cross product from the left: `cross(v) * w` = v × w.
pub(crate) fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}
