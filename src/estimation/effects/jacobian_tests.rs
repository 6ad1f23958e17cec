//! The columns of one view against numeric differences of its residuals: lens, smooth shapes,
//! motion, pose, and each corner's own offset.

use nalgebra::{DMatrix, MatrixXx6, Point3, UnitQuaternion, Vector3};

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::state::{EffectsState, Scene};
use crate::estimation::effects::system::System;
use crate::estimation::effects::view_columns::ViewColumns;
use crate::estimation::joint::linearize::{
    Columns, LinearizationPoint, LinearizedObservation, LocalEquations, linearize_observation,
};
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State};
use crate::estimation::robust::Loss;
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// Central differences have an error of order step² from curvature, and of 1e-16 / step from
/// rounding.
const STEP: f64 = 1e-5;
/// Entries agree to this part of the largest of their column.
const TOLERANCE: f64 = 1e-6;
const ROWS: f64 = 480.0;

struct World {
    layout: Layout,
    basis: BoardBasis,
    observations: Vec<BoardObservation>,
    state: EffectsState,
}

impl World {
    fn new(square_pixels: bool) -> Self {
        let model = LensModel::Brown;
        let all = 0..Lens::parameter_names(model).len();
        let free = all.filter(|index| !square_pixels || *index != Lens::FY).collect();
        let layout = Layout::new(vec![FreeLens { model, free, square_pixels }], None);
        let fy = if square_pixels { 610.0 } else { 605.0 };
        let parameters = [610.0, fy, 318.0, 243.0, 0.4, -0.2, 0.05, 0.001, -0.002, -0.01];
        let points: Vec<Point3<f64>> = (0..30)
            .map(|k| Point3::new(f64::from(k % 6), f64::from(k / 6), 0.0) * 0.04)
            .map(|p| Point3::new(p.x - 0.1, p.y - 0.08, 0.0))
            .collect();
        let pixel = |k: u32| Pixel::new(100.0 + 15.0 * f64::from(k), 20.0 + 14.0 * f64::from(k));
        let observations = vec![BoardObservation {
            sensor: 0,
            frame_set: 0,
            pixels: (0..30).map(pixel).collect(),
            inverse_std: (0..30).map(|k| 1.0 + 0.1 * f64::from(k)).collect(),
            used: vec![true; points.len()],
            points,
        }];
        let basis = BoardBasis::of(&observations, true).expect("a basis");
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -0.3, 0.2));
        let fixed = State {
            lenses: vec![Lens::from_parameters(model, &parameters).expect("a lens")],
            sensor_from_rig: vec![Pose::identity()],
            rig_from_board: vec![Pose::new(rotation, Vector3::new(0.02, -0.01, 0.5))],
            warp: [0.0; 2],
        };
        let mut state = EffectsState::without_effects(fixed, &basis, 1);
        for (k, coefficient) in state.shape.iter_mut().enumerate() {
            *coefficient = 1e-4 * (k as f64).sin();
        }
        Self { layout, basis, observations, state }
    }

    fn scene(&self) -> Scene<'_> {
        Scene {
            layout: &self.layout,
            basis: &self.basis,
            observations: &self.observations,
            good: &[0],
            rows: ROWS,
            by_columns: None,
            moves: true,
        }
    }

    /// All corners' x, then all corners' y, with the parameter of a column changed by `step`.
    fn residuals(&self, column: Column, step: f64) -> Vec<f64> {
        let mut state = self.state.clone();
        let (mut lens, mut pose) = (vec![0.0; self.layout.len], [0.0; 6]);
        match column {
            Column::Lens(k) => lens[k] = step,
            Column::Shape(k) => state.shape[k] += step,
            Column::Motion(k) => state.motions[0][k] += step,
            Column::Pose(k) => pose[k] = step,
        }
        state.fixed = state.fixed.stepped(&self.layout, &lens, &[pose]).expect("a small step");
        let system = System::at(self.scene(), &state).expect("a system");
        let residuals = &system.residuals[0];
        [0, 1].iter().flat_map(|axis| residuals.iter().map(|r| r[*axis])).collect()
    }
}

#[derive(Clone, Copy)]
enum Column {
    Lens(usize),
    Shape(usize),
    Motion(usize),
    Pose(usize),
}

fn assert_agrees(world: &World, column: Column, analytic: &[f64], name: &str) {
    let unit =
        if matches!(column, Column::Lens(k) if k < Lens::FIRST_COEFFICIENT) { 100.0 } else { 1.0 };
    let step = STEP * unit;
    let (after, before) = (world.residuals(column, step), world.residuals(column, -step));
    let numeric: Vec<f64> =
        after.iter().zip(&before).map(|(a, b)| (a - b) / (2.0 * step)).collect();
    let largest = numeric.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    assert!(largest > 0.0, "{name}: nothing moves");
    for (row, (numeric, analytic)) in numeric.iter().zip(analytic).enumerate() {
        assert!(
            (numeric - analytic).abs() <= TOLERANCE * largest,
            "{name}, row {row}: {analytic}, by differences {numeric}, of {largest}"
        );
    }
}

#[test]
fn columns_are_the_derivatives_of_the_residuals() {
    for square_pixels in [false, true] {
        assert_derivatives(&World::new(square_pixels));
    }
}

fn assert_derivatives(world: &World) {
    let (scene, count) = (world.scene(), 30);
    let offsets = world.basis.offsets(&world.state.shape);
    let seen = world.state.moved_observation(scene, &offsets, 0);
    let (mut columns, mut local) = (Columns::default(), LocalEquations::default());
    let mut residuals = vec![[0.0; 2]; count];
    let at = LinearizationPoint { layout: scene.layout, state: &world.state.fixed };
    let into = LinearizedObservation { residuals: &mut residuals, local: &mut local };
    assert!(linearize_observation(at, &seen, Loss::Squares, &mut columns, into));
    let rotation = world.state.fixed.rig_from_board[0].rotation_matrix();
    let (view, mut values) = (ViewColumns::of(scene, &seen, 0), Vec::new());
    let in_plane = view.fill(&rotation, &seen, columns.values(), &mut values);
    // Without the padding of columns.
    let trimmed = |column: &[f64]| -> Vec<f64> {
        [&column[..count], &column[view.rows / 2..][..count]].concat()
    };
    let (lens, smooth) = (world.layout.len, world.basis.smooth_len());
    for (k, column) in values.chunks_exact(view.rows).enumerate() {
        let column = trimmed(column);
        let of = match k {
            k if k < lens => Column::Lens(k),
            k if k < lens + smooth => Column::Shape(k - lens),
            k if k < view.pose() => Column::Motion(k - view.motion()),
            k if k < view.residual() => Column::Pose(k - view.pose()),
            _ => continue,
        };
        assert_agrees(world, of, &column, &format!("column {k}"));
    }
    assert!(world.basis.has_point_offsets);
    for (corner, point) in view.own().iter().enumerate() {
        for (axis, by) in in_plane.iter().enumerate() {
            let by = trimmed(by);
            let only = |row: usize| if row % count == corner { by[row] } else { 0.0 };
            let column: Vec<f64> = (0..2 * count).map(only).collect();
            let of = Column::Shape(smooth + 2 * point + axis);
            assert_agrees(world, of, &column, &format!("corner {corner}, axis {axis}"));
        }
    }
}

/// The equations, which come from sums over the points, against products of the columns of the
/// Jacobian, the pose eliminated.
#[test]
fn equations_are_the_products_of_the_columns() {
    let world = World::new(false);
    let scene = world.scene();
    let offsets = world.basis.offsets(&world.state.shape);
    let seen = world.state.moved_observation(scene, &offsets, 0);
    let (mut columns, mut local) = (Columns::default(), LocalEquations::default());
    let mut residuals = vec![[0.0; 2]; 30];
    let into = LinearizedObservation { residuals: &mut residuals, local: &mut local };
    let at = LinearizationPoint { layout: scene.layout, state: &world.state.fixed };
    assert!(linearize_observation(at, &seen, Loss::Squares, &mut columns, into));
    let rotation = world.state.fixed.rig_from_board[0].rotation_matrix();
    let (view, mut values) = (ViewColumns::of(scene, &seen, 0), Vec::new());
    let in_plane = view.fill(&rotation, &seen, columns.values(), &mut values);
    let dense = DMatrix::from_column_slice(view.rows, view.count(), &values);
    let mut globals = DMatrix::zeros(view.rows, scene.global_len());
    globals.columns_mut(0, view.motion()).copy_from(&dense.columns(0, view.motion()));
    for (corner, point) in view.own().iter().enumerate() {
        for (axis, by) in in_plane.iter().enumerate() {
            for row in [corner, corner + view.rows / 2] {
                globals[(row, view.motion() + 2 * point + axis)] = by[row];
            }
        }
    }
    let pose = dense.columns(view.pose(), 6);
    let square = (pose.transpose() * pose).cholesky().expect("a pose that is determined");
    let without_pose = |of: DMatrix<f64>| &of - pose * square.solve(&(pose.transpose() * &of));
    let motion = without_pose(dense.columns(view.motion(), 6).into_owned());
    let residual = without_pose(dense.columns(view.residual(), 1).into_owned());
    let globals = without_pose(globals);
    let system = System::at(scene, &world.state).expect("a system");
    let agree = |name: &str, found: DMatrix<f64>, of: [&DMatrix<f64>; 2], lower: bool| {
        let expected = of[0].transpose() * of[1];
        let of_column = |of: &DMatrix<f64>, k: usize| of.column(k).norm().max(1e-12);
        for (i, j) in (0..found.nrows()).flat_map(|i| (0..found.ncols()).map(move |j| (i, j))) {
            let off = (found[(i, j)] - expected[(i, j)]).abs();
            let allowed = 1e-7 * of_column(of[0], i) * of_column(of[1], j);
            assert!(off <= allowed || (lower && i < j), "{name} {i}, {j}: {off}");
        }
    };
    let part = &system.views[0];
    let dynamic = |of: &MatrixXx6<f64>| DMatrix::from_column_slice(of.nrows(), 6, of.as_slice());
    let column = |of: &[f64]| DMatrix::from_column_slice(of.len(), 1, of);
    agree("global", system.global.clone(), [&globals, &globals], true);
    agree("gradient", column(system.gradient.as_slice()), [&globals, &residual], false);
    agree("coupling", dynamic(&part.motion_coupling), [&globals, &motion], false);
    agree("motion gradient", column(part.motion_gradient.as_slice()), [&motion, &residual], false);
}
