//! The normal equations of lens, board shape, poses and motions at one state, with the poses
//! eliminated. They do not depend on the variances, so that these can be varied without another
//! pass over the corners.
//!
//! Global columns: the lens's free parameters and the board's shape ([`BoardBasis`]). Columns of
//! each view: six of its pose, which are eliminated here, and six of its motion, which are kept
//! because their elimination depends on the variance of motion.

use nalgebra::{DMatrix, DMatrixView, DVector, Matrix6, MatrixXx6, Vector3, Vector6};

use crate::estimation::effects::dense::take_square_from_lower;
use crate::estimation::effects::shape_products::{PointProducts, SeenPoints, by_board_axes};
use crate::estimation::effects::six_columns::{by_inverse_transpose, take_product};
use crate::estimation::effects::state::{EffectsState, Scene, read_out_times};
use crate::estimation::joint::linearize::{
    Columns, LinearizationPoint, LinearizedObservation, LocalEquations, differentiate_observation,
    linearize_observation, multiply,
};
use crate::estimation::robust::Loss;

/// One view's part of the equations.
pub(super) struct ViewPart {
    pub(super) observation: usize,
    /// Cholesky factor L of the pose's block.
    pose_factor: Matrix6<f64>,
    /// The coupling of the pose with the globals (globals × 6), times L⁻ᵀ; then L⁻¹ times its
    /// coupling with the motion, and times its gradient.
    half: MatrixXx6<f64>,
    half_motion: Matrix6<f64>,
    half_gradient: Vector6<f64>,
    /// The motion's block, its coupling with the globals (globals × 6) and its gradient, all with
    /// the pose eliminated.
    pub(super) motion: Matrix6<f64>,
    pub(super) motion_coupling: MatrixXx6<f64>,
    pub(super) motion_gradient: Vector6<f64>,
}

/// The equations of all views.
pub(super) struct System {
    /// Sum of the squared residuals, each in units of its corner's standard deviation.
    pub(super) cost: f64,
    /// Number of residuals: two per inlier corner.
    pub(super) residual_count: usize,
    /// The block of the global parameters, poses eliminated: its lower triangle.
    pub(super) global: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) views: Vec<ViewPart>,
    /// Per point: the gradient by its own x and y, and the diagonal of their information.
    pub(super) point_offset_scores: Vec<[f64; 4]>,
    /// Per observation: (projected − observed) / std.
    pub(super) residuals: Vec<Vec<[f64; 2]>>,
}

/// Buffers that are reused from view to view.
#[derive(Default)]
struct ViewBuffers {
    columns: Columns,
    local: LocalEquations,
    values: Vec<f64>,
}

/// Products of the columns of one view: lens, pose, residual, motion.
struct ViewProducts {
    observation: usize,
    products: LocalEquations,
}

impl System {
    /// `None` where an inlier cannot be projected, or an interrupt was requested.
    pub(super) fn at(scene: Scene<'_>, state: &EffectsState) -> Option<Self> {
        let (lens, globals) = (scene.layout.len, scene.global_len());
        let mut system = Self {
            cost: 0.0,
            residual_count: 0,
            global: DMatrix::zeros(globals, globals),
            gradient: DVector::zeros(globals),
            views: Vec::with_capacity(scene.good.len()),
            point_offset_scores: Vec::new(),
            residuals: scene.observations.iter().map(|o| vec![[0.0; 2]; o.points.len()]).collect(),
        };
        let offsets = scene.basis.offsets(&state.shape);
        let number = (scene.good.len(), scene.moves);
        let mut points = PointProducts::none(scene.basis.points.len(), lens, number);
        let mut buffers = ViewBuffers::default();
        let mut views = Vec::with_capacity(scene.good.len());
        for observation in scene.good {
            if scene.layout.interrupt.is_requested() {
                return None;
            }
            let at = (state, offsets.as_slice(), *observation);
            views.push(system.add_view(scene, at, (&mut points, views.len()), &mut buffers)?);
        }
        points.add_to(scene.basis, &mut system.global, &mut system.gradient);
        system.point_offset_scores = points.point_offset_scores();
        let coupling = points.coupling(scene.basis);
        let columns = if scene.moves { 12 } else { 6 };
        for (k, view) in views.iter().enumerate() {
            let coupling = coupling.columns(k * columns, columns);
            system.views.push(ViewPart::of(view, lens, coupling)?);
        }
        system.eliminate_poses();
        Some(system)
    }

    /// Adds one view's residuals, the products of its points, and its information on the lens.
    fn add_view(
        &mut self,
        scene: Scene<'_>,
        (state, offsets, observation): (&EffectsState, &[Vector3<f64>], usize),
        (points, number): (&mut PointProducts, usize),
        buffers: &mut ViewBuffers,
    ) -> Option<ViewProducts> {
        let seen = state.moved_observation(scene, offsets, observation);
        let residuals = self.residuals[observation].as_mut_slice();
        let into = LinearizedObservation { residuals, local: &mut buffers.local };
        let at = LinearizationPoint { layout: scene.layout, state: &state.fixed };
        // With motion, the products are computed below, after its columns are appended.
        let linearize = if scene.moves { differentiate_observation } else { linearize_observation };
        if !linearize(at, &seen, Loss::Squares, &mut buffers.columns, into) {
            return None;
        }
        self.cost += buffers.local.cost;
        self.residual_count += 2 * seen.used.iter().filter(|used| **used).count();
        let (plain, lens) = (buffers.columns.values(), scene.layout.len);
        let rows = plain.len() / (lens + 7);
        let rotation = state.fixed.rig_from_board[seen.frame_set].rotation_matrix();
        let by = by_board_axes(&rotation, &plain[lens * rows..]);
        let translation = if scene.moves { read_out_times(&seen, scene) } else { Vec::new() };
        let lever = 1.0 / scene.basis.lever();
        let rotation: Vec<f64> = translation.iter().map(|time| time * lever).collect();
        let times = [rotation.as_slice(), &translation];
        let point_of = &scene.basis.point_of[observation];
        points.add(number, &SeenPoints { by, plain, point_of, times });
        if scene.moves {
            buffers.values.clear();
            buffers.values.extend_from_slice(plain);
            buffers.values.resize((lens + 13) * rows, 0.0);
            let (plain, motion) = buffers.values.split_at_mut((lens + 7) * rows);
            let pose = plain[lens * rows..].chunks_exact(rows);
            for (k, (column, pose)) in motion.chunks_exact_mut(rows).zip(pose).enumerate() {
                for (half, pose) in column.chunks_exact_mut(rows / 2).zip(pose.chunks(rows / 2)) {
                    let timed = pose.iter().zip(times[k / 3]);
                    half.iter_mut().zip(timed).for_each(|(to, (by, time))| *to = by * time);
                }
            }
            multiply(&buffers.values, lens + 13, &mut buffers.local);
        }
        for i in 0..lens {
            self.gradient[i] += buffers.local.product(i, lens + 6);
            for j in i..lens {
                self.global[(j, i)] += buffers.local.product(i, j);
            }
        }
        Some(ViewProducts { observation, products: std::mem::take(&mut buffers.local) })
    }

    /// Eliminates the poses from the global block, all views in one product.
    fn eliminate_poses(&mut self) {
        let globals = self.gradient.len();
        let mut halves = DMatrix::zeros(globals, 6 * self.views.len());
        for (k, view) in self.views.iter().enumerate() {
            halves.columns_mut(6 * k, 6).copy_from(&view.half);
            self.gradient.gemv(-1.0, &view.half, &view.half_gradient, 1.0);
        }
        take_square_from_lower(&mut self.global, &halves);
    }
}

impl ViewPart {
    /// From the products of its columns, and its coupling with the shape (shape × pose and motion).
    fn of(view: &ViewProducts, lens: usize, shape: DMatrixView<'_, f64>) -> Option<Self> {
        let (pose, residual, motion) = (lens, lens + 6, lens + 7);
        let product = |i: usize, j: usize| view.products.product(i, j);
        let block = |a: usize, b: usize| Matrix6::from_fn(|i, j| product(a + i, b + j));
        let gradient = |at: usize| Vector6::from_fn(|k, _| product(at + k, residual));
        let globals = lens + shape.nrows();
        let coupling = |at: usize, first: usize| {
            let mut coupling = MatrixXx6::zeros(globals);
            for k in 0..6 {
                (0..lens).for_each(|i| coupling[(i, k)] = product(i, at + k));
                coupling
                    .view_mut((lens, k), (shape.nrows(), 1))
                    .copy_from(&shape.column(first + k));
            }
            coupling
        };
        let pose_factor = block(pose, pose).cholesky()?.unpack();
        let half_gradient = pose_factor.solve_lower_triangular(&gradient(pose))?;
        let mut half = coupling(pose, 0);
        by_inverse_transpose(&mut half, &pose_factor);
        let mut part = Self {
            observation: view.observation,
            pose_factor,
            half,
            half_motion: Matrix6::zeros(),
            half_gradient,
            motion: Matrix6::zeros(),
            motion_coupling: MatrixXx6::zeros(0),
            motion_gradient: Vector6::zeros(),
        };
        if shape.ncols() > 6 {
            let half_motion = pose_factor.solve_lower_triangular(&block(pose, motion))?;
            let mut motion_coupling = coupling(motion, 6);
            take_product(&mut motion_coupling, &part.half, &half_motion);
            part.motion = block(motion, motion) - half_motion.transpose() * half_motion;
            part.motion_gradient = gradient(motion) - half_motion.transpose() * part.half_gradient;
            (part.half_motion, part.motion_coupling) = (half_motion, motion_coupling);
        }
        Some(part)
    }

    /// The largest decrease of the cost by a step of its pose alone.
    pub(super) fn pose_decrease(&self) -> f64 {
        self.half_gradient.norm_squared()
    }

    /// The pose's step that belongs to these steps of the globals and of the motion.
    pub(super) fn pose_step(&self, global: &DVector<f64>, motion: &Vector6<f64>) -> Vector6<f64> {
        let right = self.half_gradient + self.half.tr_mul(global) + self.half_motion * motion;
        self.pose_factor.tr_solve_lower_triangular(&-right).unwrap_or_else(Vector6::zeros)
    }

    /// The pose's response to the globals (globals × 6) and to the motion (6 × 6), and the
    /// covariance of the pose with both fixed.
    pub(super) fn pose_response(&self) -> Option<(MatrixXx6<f64>, Matrix6<f64>, Matrix6<f64>)> {
        let inverse = self.pose_factor.try_inverse()?;
        let up = inverse.transpose();
        Some((-(&self.half * inverse), -(up * self.half_motion), up * inverse))
    }
}
