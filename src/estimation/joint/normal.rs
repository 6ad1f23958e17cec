//! The normal equations in block-arrow form: one dense block for the global parameters, one 6×6
//! block per frame set, and their coupling. Frame sets are eliminated one by one (Schur
//! complement), so cost is linear in their number.

use nalgebra::{DMatrix, DMatrixView, DVector, Matrix6};

use crate::estimation::joint::linearize::{
    Columns, LinearizationPoint, LinearizedObservation, LocalEquations, linearize_observation,
};
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::robust::Loss;
use crate::estimation::scaled_factor::ScaledFactor;

/// The normal equations of all observations at one state.
#[derive(Debug, Clone)]
pub(crate) struct NormalEquations {
    /// Σ ρ of the loss over the used corners.
    pub(crate) cost: f64,
    pub(crate) global: DMatrix<f64>,
    pub(crate) global_gradient: DVector<f64>,
    pub(crate) frame_sets: Vec<LocalBlock>,
    /// Global × frame sets: row `frame_set * global parameters + k` couples global parameter k with
    /// that frame set's pose.
    pub(crate) coupling: Vec<[f64; 6]>,
    /// Per observation, per corner: (projected − observed) / std; infinite where nothing is
    /// projected.
    pub(crate) residuals: Vec<Vec<[f64; 2]>>,
    /// Per plane, per tile, in standard deviations; infinite where a tile cannot be linearized.
    pub(crate) tile_residuals: Vec<Vec<f64>>,
    /// The equations of each observation alone; empty where they were assembled in another way.
    pub(crate) local: Vec<LocalEquations>,
}

/// The part of one frame set.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LocalBlock {
    pub(crate) hessian: [[f64; 6]; 6],
    pub(crate) gradient: [f64; 6],
}

/// A step, and by how much it lowers the linearized cost.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    pub(crate) global: Vec<f64>,
    pub(crate) frame_sets: Vec<[f64; 6]>,
    pub(crate) predicted_decrease: f64,
}

/// From this many global parameters on, frame sets are eliminated by one matrix product. Chosen,
/// not swept: a single camera has fewer, a correction of depth has more.
const LEAST_PRODUCT: usize = 32;

/// The normal equations at `state`; `None` where a used corner cannot be projected, or
/// an interrupt was requested.
pub(crate) fn linearize(
    layout: &Layout,
    state: &State,
    observations: &[BoardObservation],
    loss: Loss,
) -> Option<NormalEquations> {
    linearize_within(layout, state, observations, loss, &mut Columns::default())
}

/// As [`linearize()`], with buffers that are reused.
pub(crate) fn linearize_within(
    layout: &Layout,
    state: &State,
    observations: &[BoardObservation],
    loss: Loss,
    columns: &mut Columns,
) -> Option<NormalEquations> {
    let mut equations = NormalEquations::empty(layout.len, state.rig_from_board.len());
    equations.residuals =
        observations.iter().map(|observation| vec![[0.0; 2]; observation.points.len()]).collect();
    equations.local.reserve_exact(observations.len());
    for (index, observation) in observations.iter().enumerate() {
        if layout.interrupt.is_requested() {
            return None;
        }
        let mut local = LocalEquations::default();
        let residuals = equations.residuals[index].as_mut_slice();
        let into = LinearizedObservation { residuals, local: &mut local };
        let at = LinearizationPoint { layout, state };
        if !linearize_observation(at, observation, loss, columns, into) {
            return None;
        }
        equations.cost += local.cost;
        let chained = ChainedPose::where_posed(layout, state, observation);
        equations.add(layout, observation.sensor, observation.frame_set, chained, &local);
        equations.local.push(local);
    }
    equations.mirror();
    Some(equations)
}

impl NormalEquations {
    /// Equations without observations, for `global` global parameters and this many frame sets.
    pub(crate) fn empty(global: usize, frame_sets: usize) -> Self {
        Self {
            cost: 0.0,
            global: DMatrix::zeros(global, global),
            global_gradient: DVector::zeros(global),
            frame_sets: vec![LocalBlock::default(); frame_sets],
            coupling: vec![[0.0; 6]; frame_sets * global],
            residuals: Vec::new(),
            tile_residuals: Vec::new(),
            local: Vec::new(),
        }
    }

    /// Copies the upper triangle of the global block, which is all that [`Self::add`] fills, to the
    /// lower one.
    pub(crate) fn mirror(&mut self) {
        self.global.fill_lower_triangle_with_upper_triangle();
    }

    /// Adds the equations of one observation, by `sensor` at `frame_set`, except for their cost;
    /// `chained` where the sensor has a pose of its own.
    #[expect(clippy::needless_range_loop, reason = "indices of matrices")]
    pub(crate) fn add(
        &mut self,
        layout: &Layout,
        sensor: usize,
        frame_set: usize,
        chained: Option<ChainedPose>,
        local: &LocalEquations,
    ) {
        let at = &layout.sensors[sensor];
        let residual = local.columns - 1;
        let pose = residual - 6;
        let mut globals: Vec<usize> = (at.lens_at..at.lens_at + at.lens.free.len()).collect();
        globals.extend(layout.warp.iter().flat_map(|warp| [warp.at, warp.at + 1]));
        for (i, gi) in globals.iter().enumerate() {
            self.global_gradient[*gi] += local.product(i, residual);
            for (j, gj) in globals.iter().enumerate().skip(i) {
                self.global[(*gi, *gj)] += local.product(i, j);
            }
        }
        let block = &mut self.frame_sets[frame_set];
        let coupling = &mut self.coupling[frame_set * layout.len..][..layout.len];
        let Some(ChainedPose { pose_at: Some(pose_at), by_sensor, by_board }) = chained else {
            for a in 0..6 {
                block.gradient[a] += local.product(pose + a, residual);
                for b in 0..6 {
                    block.hessian[a][b] += local.product(pose + a, pose + b);
                }
                for (i, gi) in globals.iter().enumerate() {
                    coupling[*gi][a] += local.product(i, pose + a);
                }
            }
            return;
        };
        let square = Matrix6::from_fn(|a, b| local.product(pose + a, pose + b));
        let gradient = nalgebra::Vector6::from_fn(|a, _| local.product(pose + a, residual));
        let (sensor_square, board_square) =
            (by_sensor.transpose() * square, by_board.transpose() * square * by_board);
        let sensor_board = sensor_square * by_board;
        let sensor_square = sensor_square * by_sensor;
        let (sensor_gradient, board_gradient) =
            (by_sensor.transpose() * gradient, by_board.transpose() * gradient);
        for a in 0..6 {
            self.global_gradient[pose_at + a] += sensor_gradient[a];
            block.gradient[a] += board_gradient[a];
            for b in 0..6 {
                block.hessian[a][b] += board_square[(a, b)];
                coupling[pose_at + a][b] += sensor_board[(a, b)];
                if b >= a {
                    self.global[(pose_at + a, pose_at + b)] += sensor_square[(a, b)];
                }
            }
        }
        for (i, gi) in globals.iter().enumerate() {
            let row = nalgebra::RowVector6::from_fn(|_, a| local.product(i, pose + a));
            let (sensor_row, board_row) = (row * by_sensor, row * by_board);
            for a in 0..6 {
                let (low, high) = (*gi.min(&(pose_at + a)), *gi.max(&(pose_at + a)));
                self.global[(low, high)] += sensor_row[a];
                coupling[*gi][a] += board_row[a];
            }
        }
    }

    /// Number of frame sets with a used corner, or with a tile that determines their pose.
    pub(crate) fn seen_frame_sets(&self) -> usize {
        self.frame_sets.iter().filter(|block| block.hessian[0][0] > 0.0).count()
    }

    pub(crate) fn coupling_of(&self, frame_set: usize) -> &[[f64; 6]] {
        let size = self.global_gradient.len();
        &self.coupling[frame_set * size..][..size]
    }

    /// Solves (H + λ diag H) step = −gradient. `None` where the damped matrix is not positive
    /// definite.
    pub(crate) fn solve(&self, lambda: f64) -> Option<Step> {
        let size = self.global_gradient.len();
        let mut schur = self.global.clone();
        for k in 0..size {
            schur[(k, k)] *= 1.0 + lambda;
        }
        let mut right = -&self.global_gradient;
        let (mut eliminated, mut halves) =
            (Vec::with_capacity(self.frame_sets.len()), self.coupling.clone());
        for (frame_set, block) in self.frame_sets.iter().enumerate() {
            let factor = cholesky6(&block.hessian, lambda)?;
            let half = &mut halves[frame_set * size..][..size];
            half.iter_mut().for_each(|row| *row = forward6(&factor, row));
            let half_gradient = forward6(&factor, &block.gradient);
            right
                .iter_mut()
                .zip(&*half)
                .for_each(|(right, row)| *right += dot6(row, &half_gradient));
            eliminated.push((factor, half_gradient));
        }
        self.eliminate(&mut schur, &halves);
        let global = if size == 0 { right } else { schur.cholesky()?.solve(&right) };
        let mut decrease =
            -self.global_gradient.dot(&global) + lambda * diagonal_form(&self.global, &global);
        let mut frame_sets = Vec::with_capacity(self.frame_sets.len());
        for (frame_set, ((factor, half_gradient), block)) in
            eliminated.iter().zip(&self.frame_sets).enumerate()
        {
            let mut rest = half_gradient.map(|g| -g);
            for (row, step) in halves[frame_set * size..][..size].iter().zip(global.iter()) {
                for a in 0..6 {
                    rest[a] -= row[a] * step;
                }
            }
            let step = backward6(factor, &rest);
            for (a, step) in step.iter().enumerate() {
                decrease += step * (lambda * block.hessian[a][a] * step - block.gradient[a]);
            }
            frame_sets.push(step);
        }
        let step = Step {
            global: global.iter().copied().collect(),
            frame_sets,
            predicted_decrease: decrease,
        };
        decrease.is_finite().then_some(step)
    }

    /// Eliminates the frame sets' poses from the lower triangle of `schur`: subtracts Σ hᵀh of
    /// `halves`, each L⁻¹ of a frame set's coupling.
    fn eliminate(&self, schur: &mut DMatrix<f64>, halves: &[[f64; 6]]) {
        let size = self.global_gradient.len();
        let moving = self.frame_sets.iter().zip(halves.chunks(size.max(1)));
        let moving = moving.filter(|(block, _)| !is_zero(&block.hessian)).map(|(_, half)| half);
        if size < LEAST_PRODUCT {
            for half in moving {
                for i in 0..size {
                    for j in 0..=i {
                        schur[(i, j)] -= dot6(&half[i], &half[j]);
                    }
                }
            }
            return;
        }
        let rows: Vec<f64> = moving
            .flat_map(|half| (0..6).flat_map(|a| half.iter().map(move |row| row[a])))
            .collect();
        let halves = DMatrixView::from_slice(&rows, size, rows.len() / size);
        *schur -= halves * halves.transpose();
    }

    /// The covariance of the global parameters for residuals of unit variance: the inverse of the
    /// Schur complement.
    pub(crate) fn global_covariance(&self) -> Option<DMatrix<f64>> {
        let size = self.global_gradient.len();
        let (mut schur, mut halves) = (self.global.clone(), self.coupling.clone());
        for (frame_set, block) in self.frame_sets.iter().enumerate() {
            let factor = cholesky6(&block.hessian, 0.0)?;
            let half = &mut halves[frame_set * size..][..size];
            half.iter_mut().for_each(|row| *row = forward6(&factor, row));
        }
        self.eliminate(&mut schur, &halves);
        // Scaled by the diagonal before the poses are eliminated: after it, an entry may be 0.
        let unit = DVector::from_fn(size, |i, _| 1.0 / self.global[(i, i)].sqrt());
        let covariance = ScaledFactor::in_units(&schur, unit)?.inverse();
        covariance.iter().all(|v| v.is_finite()).then_some(covariance)
    }

    /// The information of one frame set alone, where these are the equations of that frame set.
    pub(crate) fn reduced(&self, frame_set: usize) -> Option<ReducedView> {
        let size = self.global_gradient.len();
        let block = &self.frame_sets[frame_set];
        let factor = cholesky6(&block.hessian, 0.0)?;
        let half: Vec<[f64; 6]> =
            self.coupling_of(frame_set).iter().map(|row| forward6(&factor, row)).collect();
        let half_gradient = forward6(&factor, &block.gradient);
        let information =
            DMatrix::from_fn(size, size, |i, j| self.global[(i, j)] - dot6(&half[i], &half[j]));
        let gradient =
            DVector::from_fn(size, |i, _| self.global_gradient[i] - dot6(&half[i], &half_gradient));
        Some(ReducedView { information, gradient })
    }

    /// The covariance of one frame set's pose step (ω, τ), given that of the global parameters.
    pub(crate) fn frame_set_covariance(
        &self,
        frame_set: usize,
        global: &DMatrix<f64>,
    ) -> Option<Matrix6<f64>> {
        self.pose_covariance(frame_set, global, None)
    }

    /// As [`Self::frame_set_covariance`], of the board's pose in the frame of a sensor that has a
    /// pose of its own.
    pub(crate) fn pose_covariance(
        &self,
        frame_set: usize,
        global: &DMatrix<f64>,
        chained: Option<ChainedPose>,
    ) -> Option<Matrix6<f64>> {
        let block = &self.frame_sets[frame_set];
        let inverse = Matrix6::from_fn(|a, b| block.hessian[a][b]).cholesky()?.inverse();
        let by_board = chained.map_or_else(Matrix6::identity, |chained| chained.by_board);
        let rows = self.coupling_of(frame_set);
        let coupling = DMatrix::from_fn(6, global.nrows(), |a, k| rows[k][a]);
        let eliminated = by_board * inverse;
        let mut through = DMatrix::from_fn(6, 6, |a, b| -eliminated[(a, b)]) * coupling;
        if let Some(ChainedPose { pose_at: Some(pose_at), by_sensor, .. }) = chained {
            let mut own = through.view_mut((0, pose_at), (6, 6));
            own += by_sensor;
        }
        let carried = &through * global * through.transpose();
        let alone = eliminated * by_board.transpose();
        Some(Matrix6::from_fn(|a, b| alone[(a, b)] + carried[(a, b)]))
    }
}

/// The equations of one view alone for the shared parameters, its pose eliminated.
#[derive(Debug, Clone)]
pub(crate) struct ReducedView {
    /// Its part of the Schur complement, the inverse of a covariance for unit noise.
    pub(crate) information: DMatrix<f64>,
    /// Its part of the gradient of half the cost.
    pub(crate) gradient: DVector<f64>,
}

/// The derivative of the board's pose in the frame of a sensor other than the rig's own, by steps
/// of that sensor's pose and of the board's: δ_sensor_from_board = A δ_sensor_from_rig + B
/// δ_rig_from_board.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ChainedPose {
    /// The index of δ_sensor_from_rig among the global parameters; `None` where that pose is fixed,
    /// or the layout does not contain the sensor.
    pub(crate) pose_at: Option<usize>,
    /// A.
    pub(crate) by_sensor: Matrix6<f64>,
    /// B.
    pub(crate) by_board: Matrix6<f64>,
}

impl ChainedPose {
    pub(crate) fn of(layout: &Layout, state: &State, sensor: usize, frame_set: usize) -> Self {
        let rotation = state.sensor_from_rig[sensor].rotation_matrix();
        let lever = rotation * state.rig_from_board[frame_set].translation();
        let mut by_sensor = Matrix6::identity();
        by_sensor.fixed_view_mut::<3, 3>(3, 0).copy_from(&-lever.cross_matrix());
        let mut by_board = Matrix6::zeros();
        by_board.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        by_board.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        let pose_at = layout.sensors.get(sensor).and_then(|at| at.pose_at);
        Self { pose_at, by_sensor, by_board }
    }

    /// For an observation by a sensor whose pose is estimated; `None` for others.
    pub(crate) fn where_posed(
        layout: &Layout,
        state: &State,
        observation: &BoardObservation,
    ) -> Option<Self> {
        let BoardObservation { sensor, frame_set, .. } = *observation;
        layout.sensors[sensor].pose_at?;
        Some(Self::of(layout, state, sensor, frame_set))
    }
}

fn diagonal_form(matrix: &DMatrix<f64>, vector: &DVector<f64>) -> f64 {
    (0..vector.len()).map(|k| matrix[(k, k)] * vector[k] * vector[k]).sum()
}

fn dot6(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])
}

fn is_zero(matrix: &[[f64; 6]; 6]) -> bool {
    matrix.iter().flatten().all(|v| *v == 0.0)
}

/// L of L Lᵀ = A + λ diag A, with the reciprocals of its diagonal in place of the diagonal. For a
/// frame set without observations (A = 0), L is such that every solution is 0.
fn cholesky6(matrix: &[[f64; 6]; 6], lambda: f64) -> Option<[[f64; 6]; 6]> {
    let mut factor = [[0.0; 6]; 6];
    if is_zero(matrix) {
        return Some(factor);
    }
    for i in 0..6 {
        for j in 0..=i {
            let mut sum = matrix[i][j];
            sum -= (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
            if i == j {
                sum += lambda * matrix[i][i];
                if !(sum > 1e-14 * matrix[i][i]) {
                    return None;
                }
                factor[i][i] = 1.0 / sum.sqrt();
            } else {
                factor[i][j] = sum * factor[j][j];
            }
        }
    }
    Some(factor)
}

fn forward6(factor: &[[f64; 6]; 6], right: &[f64; 6]) -> [f64; 6] {
    let mut x = *right;
    for i in 0..6 {
        for k in 0..i {
            x[i] -= factor[i][k] * x[k];
        }
        x[i] *= factor[i][i];
    }
    x
}

fn backward6(factor: &[[f64; 6]; 6], right: &[f64; 6]) -> [f64; 6] {
    let mut x = *right;
    for i in (0..6).rev() {
        for k in i + 1..6 {
            x[i] -= factor[k][i] * x[k];
        }
        x[i] *= factor[i][i];
    }
    x
}
