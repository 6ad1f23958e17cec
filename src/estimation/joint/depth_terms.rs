//! Depth in the joint problem: the corrected 1/z of every tile against that of the board's plane.
//!
//! ```text
//! e = (correct(1/z, pixel) − n·ray(pixel) / n·t) / (gain · std)
//! n = R e_z, (R, t) = sensor_from_board
//! ```
//!
//! The gain is ∂correct/∂(1/z), by which the correction scales the reading's noise. Without it, a
//! correction that maps all readings to 1/z = 0, with the planes at infinity, would leave no
//! residuals.
//!
//! 1/z of a plane is linear in the ray (x, y, 1), and the correction is linear in its coefficients,
//! so the iterations converge from distant starts. The ray follows from the pixel by the depth
//! camera's own lens (D. Herrera C., J. Kannala, J. Heikkilä, *Joint depth and color camera
//! calibration with distortion correction*, PAMI 2012, here with the plane's error in inverse
//! depth).

use nalgebra::{Matrix2, Vector3};

use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::normal::{ChainedPose, NormalEquations};
use crate::estimation::row_products::SparseRowProducts;
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::depth_correction::{
    CorrectedQuantity, DepthCorrection, MAX_TERMS, PixelCorrection, held_inverse_depth, power_slope,
};
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// The board's surface as the depth sensor measured it at one frame set.
#[derive(Debug, Clone)]
pub(crate) struct PlaneObservation {
    pub(crate) sensor: usize,
    pub(crate) frame_set: usize,
    pub(crate) tiles: Vec<DepthTile>,
    /// 1 over each tile's standard deviation, in m.
    pub(crate) inverse_std: Vec<f64>,
    pub(crate) used: Vec<bool>,
}

/// One residual, with its derivatives by global parameters and by the board's pose in the sensor's
/// frame.
struct DepthRow {
    residual: f64,
    globals: Vec<(usize, f64)>,
    by_pose: [f64; 6],
}

/// A correction, and the index of its first coefficient among the global parameters.
#[derive(Clone, Copy)]
pub(crate) struct CorrectionColumns<'a> {
    pub(crate) correction: &'a DepthCorrection,
    pub(crate) first: usize,
}

/// Adds the planes to the normal equations, and returns every tile's residual in standard
/// deviations (infinite where a tile cannot be linearized). Where the boards' poses are not `free`,
/// their own blocks and gradients are left out, and only their coupling with the globals is added.
/// Of the globals' block only the upper triangle is filled.
pub(crate) fn add_planes(
    equations: &mut NormalEquations,
    at: LinearizationPoint<'_>,
    correction: CorrectionColumns<'_>,
    observations: &[PlaneObservation],
    free: bool,
) -> Vec<Vec<f64>> {
    let LinearizationPoint { layout, state } = at;
    let mut row = DepthRow { residual: 0.0, globals: Vec::new(), by_pose: [0.0; 6] };
    // Tiles in one cell of the correction's grid have the same globals.
    let mut products = SparseRowProducts::default();
    let residuals = observations.iter().map(|observation| {
        let sensor_from_board = state.sensor_from_board(observation.sensor, observation.frame_set);
        let chained = (observation.sensor != 0)
            .then(|| ChainedPose::of(layout, state, observation.sensor, observation.frame_set));
        let each = (0..observation.tiles.len()).map(|index| {
            let tile = WeightedTile {
                tile: &observation.tiles[index],
                inverse_std: observation.inverse_std[index],
                sensor: observation.sensor,
            };
            if !linearize_tile(at, correction, &sensor_from_board, tile, &mut row) {
                return f64::INFINITY;
            }
            if observation.used[index] {
                let pose = nalgebra::RowVector6::from_row_slice(&row.by_pose);
                let by_board = match &chained {
                    None => row.by_pose,
                    Some(ChainedPose { pose_at, by_sensor, by_board }) => {
                        if let Some(at) = *pose_at {
                            let by_sensor = pose * by_sensor;
                            row.globals.extend((0..6).map(|k| (at + k, by_sensor[k])));
                        }
                        (pose * by_board).into()
                    }
                };
                add_row(equations, observation.frame_set, free, &row, &by_board);
                products.push(&row.globals, &mut equations.global);
            }
            row.residual
        });
        each.collect()
    });
    let residuals = residuals.collect();
    products.add_all(&mut equations.global);
    residuals
}

/// Adds a row to all blocks except that of the globals.
fn add_row(
    equations: &mut NormalEquations,
    frame_set: usize,
    free: bool,
    row: &DepthRow,
    by_board: &[f64; 6],
) {
    equations.cost += row.residual * row.residual;
    if free {
        let block = &mut equations.frame_sets[frame_set];
        for (a, da) in by_board.iter().enumerate() {
            block.gradient[a] += da * row.residual;
            for (b, db) in by_board.iter().enumerate() {
                block.hessian[a][b] += da * db;
            }
        }
    }
    let size = equations.global_gradient.len();
    let couplings = &mut equations.coupling[frame_set * size..(frame_set + 1) * size];
    for (index, value) in &row.globals {
        equations.global_gradient[*index] += value * row.residual;
        for (coupling, by_board) in couplings[*index].iter_mut().zip(by_board) {
            *coupling += value * by_board;
        }
    }
}

/// The least gain. A correction with a smaller one flattens differences in 1/z, and is not valid.
const LEAST_GAIN: f64 = 0.1;

/// A tile of an observation.
#[derive(Clone, Copy)]
struct WeightedTile<'a> {
    tile: &'a DepthTile,
    /// 1 over its standard deviation, in m.
    inverse_std: f64,
    sensor: usize,
}

/// Returns false where the lens has no ray for the tile's pixel, the plane is edge-on, or the
/// correction flattens depth.
fn linearize_tile(
    at: LinearizationPoint<'_>,
    CorrectionColumns { correction, first }: CorrectionColumns<'_>,
    sensor_from_board: &Pose,
    WeightedTile { tile, inverse_std, sensor }: WeightedTile<'_>,
    row: &mut DepthRow,
) -> bool {
    let lens = &at.state.lenses[sensor];
    let Some(ray) = ray(lens, tile) else { return false };
    let normal = *sensor_from_board * Vector3::z();
    let translation = sensor_from_board.translation();
    let distance = normal.dot(&translation);
    let plane = normal.dot(&ray) / distance;
    let weights = correction.grid.weights(tile.pixel);
    let at_pixel = correction.at_nodes(&weights);
    let corrected = at_pixel.correct(tile.inverse_depth);
    let gain = at_pixel.gain(tile.inverse_depth);
    let inverse_std = inverse_std / gain;
    row.residual = (corrected - plane) * inverse_std;
    if !(corrected > 0.0 && gain > LEAST_GAIN && row.residual.is_finite()) {
        return false;
    }
    row.globals.clear();
    let corrected_by = corrected_by_terms(correction, &at_pixel, tile.inverse_depth);
    let gain_by = gain_by_terms(correction, &at_pixel, tile.inverse_depth);
    let by_gain = -row.residual / gain;
    let count = correction.grid.node_count();
    for (term, (corrected_by, gain_by)) in
        corrected_by.iter().zip(&gain_by).enumerate().take(correction.terms)
    {
        let by_term = corrected_by * inverse_std + gain_by * by_gain;
        let at_term = first + term * count;
        row.globals.extend(weights.used().map(|(node, weight)| (at_term + node, weight * by_term)));
    }
    let by_ray = normal * (-inverse_std / distance);
    if !add_lens_columns(at, sensor, &ray, &by_ray, &mut row.globals) {
        return false;
    }
    let by_rotation =
        (normal.cross(&ray) - normal.cross(&translation) * plane) * (-inverse_std / distance);
    let by_translation = normal * (plane / distance * inverse_std);
    row.by_pose = [
        by_rotation.x,
        by_rotation.y,
        by_rotation.z,
        by_translation.x,
        by_translation.y,
        by_translation.z,
    ];
    true
}

/// The ray (x, y, 1) of a tile's center.
pub(crate) fn ray(lens: &Lens, tile: &DepthTile) -> Option<Vector3<f64>> {
    let bearing = lens.bearing_from_pixel(tile.pixel)?;
    (bearing.z > 1e-3).then(|| bearing.into_inner() / bearing.z)
}

/// ∂(corrected 1/z)/∂(coefficient) for the coefficients that affect a tile.
pub(crate) fn correction_columns(
    correction: &DepthCorrection,
    tile: &DepthTile,
    mut put: impl FnMut(usize, f64),
) {
    let weights = correction.grid.weights(tile.pixel);
    let at_pixel = correction.at_nodes(&weights);
    let by_terms = corrected_by_terms(correction, &at_pixel, tile.inverse_depth);
    let count = correction.grid.node_count();
    for (term, by_term) in by_terms.iter().enumerate().take(correction.terms) {
        weights.used().for_each(|(node, weight)| put(term * count + node, by_term * weight));
    }
}

/// ∂(corrected 1/z)/∂(term of the polynomial) at a pixel.
fn corrected_by_terms(
    correction: &DepthCorrection,
    at_pixel: &PixelCorrection,
    inverse_depth: f64,
) -> [f64; MAX_TERMS] {
    let held = held_inverse_depth(inverse_depth, correction.seen_m);
    let (base, factor) = match correction.quantity {
        CorrectedQuantity::InverseDepth => (held, 1.0),
        CorrectedQuantity::Depth => {
            let corrected = at_pixel.correct(inverse_depth);
            (1.0 / held, -corrected * corrected)
        }
    };
    let mut power = factor;
    [(); MAX_TERMS].map(|()| {
        let by_term = power;
        power *= base;
        by_term
    })
}

/// ∂gain/∂(term of the polynomial) at a pixel; 0 where the polynomial is held.
fn gain_by_terms(
    correction: &DepthCorrection,
    at_pixel: &PixelCorrection,
    inverse_depth: f64,
) -> [f64; MAX_TERMS] {
    if !correction.has_seen(inverse_depth) {
        return [0.0; MAX_TERMS];
    }
    match correction.quantity {
        CorrectedQuantity::InverseDepth => std::array::from_fn(|k| power_slope(inverse_depth, k)),
        CorrectedQuantity::Depth => {
            let z = 1.0 / inverse_depth;
            let (corrected, gain) = (at_pixel.correct(inverse_depth), at_pixel.gain(inverse_depth));
            let stretch = (corrected * z).powi(2);
            std::array::from_fn(|k| {
                stretch * power_slope(z, k) - 2.0 * corrected * gain * z.powi(k as i32)
            })
        }
    }
}

/// The columns of the lens. The pixel is fixed and the ray changes: ∂ray/∂parameters =
/// −(∂pixel/∂ray)⁻¹ ∂pixel/∂parameters. Returns false where the lens cannot project the ray.
fn add_lens_columns(
    at: LinearizationPoint<'_>,
    sensor: usize,
    ray: &Vector3<f64>,
    by_ray: &Vector3<f64>,
    globals: &mut Vec<(usize, f64)>,
) -> bool {
    let (lens, at) = (&at.state.lenses[sensor], &at.layout.sensors[sensor]);
    if at.lens.free.is_empty() {
        return true;
    }
    let Some(projection) = lens.project(&(*ray).into()) else { return false };
    let by_xy: Matrix2<f64> = projection.by_point.fixed_view::<2, 2>(0, 0).into_owned();
    let Some(inverse) = by_xy.try_inverse() else { return false };
    for (column, parameter) in at.lens.free.iter().enumerate() {
        let mut by_parameter = projection.by_parameters.column(*parameter).into_owned();
        if at.lens.square_pixels && *parameter == 0 {
            by_parameter += projection.by_parameters.column(1);
        }
        let moved = -(inverse * by_parameter);
        globals.push((at.lens_at + column, by_ray.x * moved.x + by_ray.y * moved.y));
    }
    true
}
