//! The normal equations of the joint problem against numeric differences of its residuals: lens
//! parameters, the poses of sensors through the chain rule, board poses, the warp, and the
//! coefficients and gains of the depth correction.

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use crate::estimation::joint::depth_terms::{CorrectionColumns, PlaneObservation, add_planes};
use crate::estimation::joint::linearize::LinearizationPoint;
use crate::estimation::joint::normal::{NormalEquations, linearize};
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State};
use crate::estimation::robust::Loss;
use crate::geometry::depth_camera::DepthTile;
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// Central differences over ±h of a parameter of typical size s lose h² of curvature and 1e-16/h of
/// rounding: about 1e-9 of s at this share.
const STEP: f64 = 1e-5;
/// Entries agree to this share of the largest of their row and column.
const TOLERANCE: f64 = 1e-6;
/// Of a depth tile likewise: its ray is undistorted by iteration, to about 1e-9 in a step of 1e-5.
const TILE_TOLERANCE: f64 = 1e-4;

const BOARD_HALF_EXTENT: [f64; 2] = [0.12, 0.075];

fn lens(model: LensModel) -> Lens {
    let own: &[f64] = match model {
        LensModel::KannalaBrandt => &[0.02, -0.01, 0.004, -0.002],
        _ => &[-0.2, 0.05, 0.001, -0.002, -0.01],
    };
    let mut parameters = vec![610.0, 605.0, 318.0, 243.0, 0.4];
    parameters.extend(own);
    parameters.resize(Lens::parameter_names(model).len(), 0.01);
    Lens::from_parameters(model, &parameters).expect("a lens")
}

fn pose(rotation: [f64; 3], translation: [f64; 3]) -> Pose {
    let rotated = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::from(rotation));
    Pose::new(rotated, Vector3::from(translation))
}

/// Two sensors with different lenses, the second with a pose of its own, two frame sets, a warp.
/// With `square_pixels` fx and fy of each are one parameter.
fn world(square_pixels: bool) -> (Layout, State, Vec<BoardObservation>) {
    let models = [LensModel::Brown, LensModel::KannalaBrandt];
    let all = |model| 0..Lens::parameter_names(model).len();
    let free = |model: LensModel| FreeLens {
        model,
        free: all(model).filter(|index| !square_pixels || *index != Lens::FY).collect(),
        square_pixels,
    };
    let layout = Layout::new(models.map(free).to_vec(), Some(BOARD_HALF_EXTENT));
    let lens = |model: LensModel| {
        let mut lens = lens(model);
        if square_pixels {
            lens.matrix.fy = lens.matrix.fx;
        }
        lens
    };
    let state = State {
        lenses: models.map(lens).to_vec(),
        sensor_from_rig: vec![Pose::identity(), pose([0.02, -0.05, 0.01], [-0.06, 0.01, 0.005])],
        rig_from_board: vec![
            pose([0.3, -0.2, 0.1], [0.03, -0.02, 0.6]),
            pose([-0.25, 0.35, -0.4], [-0.05, 0.04, 0.8]),
        ],
        warp: [0.0011, -0.0007],
    };
    let points: Vec<Point3<f64>> = (0..12)
        .map(|k| Point3::new(f64::from(k % 4) * 0.07 - 0.1, f64::from(k / 4) * 0.07 - 0.06, 0.0))
        .collect();
    let observations = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(sensor, frame_set)| {
        let pixels = (0..12).map(|k| Pixel::new(300.0 + 7.0 * f64::from(k), 260.0 - f64::from(k)));
        BoardObservation {
            sensor,
            frame_set,
            points: points.clone(),
            pixels: pixels.collect(),
            inverse_std: (0..12).map(|k| 0.01 + 0.001 * f64::from(k)).collect(),
            used: vec![true; 12],
        }
    });
    (layout, state, observations.to_vec())
}

/// Global parameters, then six numbers for each frame set, as one vector.
fn stepped(layout: &Layout, state: &State, step: &[f64]) -> State {
    let (global, poses) = step.split_at(layout.len);
    let poses: Vec<[f64; 6]> =
        poses.chunks(6).map(|pose| std::array::from_fn(|k| pose[k])).collect();
    state.stepped(layout, global, &poses).expect("a small step")
}

/// A step of parameter `k` that moves residuals about as far as any other does.
fn unit_of(layout: &Layout, k: usize) -> f64 {
    let of_lens =
        layout.sensors.iter().any(|sensor| (sensor.lens_at..sensor.lens_at + 5).contains(&k));
    if of_lens { 100.0 } else { 1.0 }
}

/// ∂residual/∂parameter by central differences, column by column.
fn numeric_jacobian(
    count: usize,
    unit: impl Fn(usize) -> f64,
    residuals: impl Fn(&[f64]) -> Vec<f64>,
) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..count)
        .map(|k| {
            let at = |sign: f64| {
                let mut step = vec![0.0; count];
                step[k] = sign * STEP * unit(k);
                DVector::from_vec(residuals(&step))
            };
            (at(1.0) - at(-1.0)) / (2.0 * STEP * unit(k))
        })
        .collect();
    DMatrix::from_columns(&columns)
}

/// Holds the equations' blocks to JᵀJ and Jᵀr.
fn assert_equations(
    equations: &NormalEquations,
    jacobian: &DMatrix<f64>,
    residuals: &[f64],
    tolerance: f64,
) {
    let size = equations.global_gradient.len();
    let square = jacobian.transpose() * jacobian;
    let gradient = jacobian.transpose() * DVector::from_row_slice(residuals);
    let scale = |i: usize, j: usize| (square[(i, i)] * square[(j, j)]).sqrt().max(1e-12);
    let close = |what: &str, i: usize, j: usize, analytic: f64| {
        let off = (analytic - square[(i, j)]).abs();
        assert!(off < tolerance * scale(i, j), "{what} ({i}, {j}): {analytic} {}", square[(i, j)]);
    };
    for i in 0..size {
        for j in i..size {
            close("global", i, j, equations.global[(i, j)]);
        }
        let length = residuals.iter().map(|r| r * r).sum::<f64>().sqrt();
        let bound = tolerance * square[(i, i)].sqrt().max(1e-12) * length;
        assert!((equations.global_gradient[i] - gradient[i]).abs() < bound, "gradient {i}");
    }
    for (frame_set, block) in equations.frame_sets.iter().enumerate() {
        for a in 0..6 {
            let at = size + 6 * frame_set + a;
            for b in 0..6 {
                close("pose", at, size + 6 * frame_set + b, block.hessian[a][b]);
            }
            for i in 0..size {
                close("coupling", i, at, equations.coupling[frame_set * size + i][a]);
            }
        }
    }
}

#[test]
fn corners_have_the_derivatives_of_their_residuals() {
    for square_pixels in [false, true] {
        let (layout, state, observations) = world(square_pixels);
        let residuals = |step: &[f64]| -> Vec<f64> {
            let state = stepped(&layout, &state, step);
            let each =
                observations.iter().flat_map(|observation| state.residuals(&layout, observation));
            each.flatten().collect()
        };
        let count = layout.len + 6 * state.rig_from_board.len();
        let jacobian = numeric_jacobian(count, |k| unit_of(&layout, k), residuals);
        let equations =
            linearize(&layout, &state, &observations, Loss::Squares).expect("all are projected");
        let residuals = residuals(&vec![0.0; count]);
        assert_equations(&equations, &jacobian, &residuals, TOLERANCE);
    }
}

#[test]
fn planes_have_the_derivatives_of_their_residuals() {
    let quantities = [CorrectedQuantity::InverseDepth, CorrectedQuantity::Depth];
    for (quantity, square_pixels) in quantities.into_iter().zip([false, true]) {
        let (layout, state, _) = world(square_pixels);
        let size = ImageSize::new(640, 480);
        let mut correction =
            DepthCorrection::none(quantity, 2, SplineGrid::constant(size), [0.4, 2.0]);
        let start = [0.02, -0.03];
        correction.coefficients.copy_from_slice(&start);
        let tiles: Vec<DepthTile> = (0..9)
            .map(|k| DepthTile {
                pixel: Pixel::new(
                    200.0 + 100.0 * f64::from(k % 3),
                    150.0 + 80.0 * f64::from(k / 3),
                ),
                inverse_depth: 1.5 - 0.03 * f64::from(k),
                reading_std: 0.01,
                count: 100,
            })
            .collect();
        let observations: Vec<PlaneObservation> = [(0, 0), (1, 0), (1, 1)]
            .map(|(sensor, frame_set)| PlaneObservation {
                sensor,
                frame_set,
                tiles: tiles.clone(),
                inverse_std: vec![5.0; 9],
                used: vec![true; 9],
            })
            .to_vec();
        let (at, size) = (layout.len, layout.len + start.len());
        let evaluate = |step: &[f64]| {
            let (rest, coefficients) = (
                [&step[..at], &step[size..]].concat(),
                start.iter().zip(&step[at..size]).map(|(start, step)| start + step),
            );
            let state = stepped(&layout, &state, &rest);
            let correction =
                DepthCorrection { coefficients: coefficients.collect(), ..correction.clone() };
            let wider = Layout { len: size, ..layout.clone() };
            let mut equations = NormalEquations::empty(size, state.rig_from_board.len());
            let planes = add_planes(
                &mut equations,
                LinearizationPoint { layout: &wider, state: &state },
                CorrectionColumns { correction: &correction, first: at },
                &observations,
                true,
            );
            equations.mirror();
            (planes.concat(), equations)
        };
        let count = size + 6 * state.rig_from_board.len();
        let jacobian = numeric_jacobian(count, |k| unit_of(&layout, k), |step| evaluate(step).0);
        let (residuals, equations) = evaluate(&vec![0.0; count]);
        assert!(residuals.iter().all(|residual| residual.is_finite()));
        assert_equations(&equations, &jacobian, &residuals, TILE_TOLERANCE);
    }
}
