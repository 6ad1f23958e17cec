//! The normal equations of lens, board shape, poses and motions at one state, with the poses
//! eliminated: what every choice of variances starts from, without another pass over the corners.
//!
//! Global columns: the lens's free parameters, the board's shape ([`BoardBasis`]). A view's own: six
//! of its pose, which are eliminated here, and six of its motion while it was read, which are kept
//! because their variance is still to be estimated.

use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, Vector3, Vector6};

use crate::estimation::effects::dense::take_square_from_lower;
use crate::estimation::effects::state::{EffectsState, Scene, read_out_times};
use crate::estimation::joint::BoardObservation;
use crate::estimation::joint::linearize::{
    Columns, LocalEquations, linearize_observation, multiply,
};
use crate::estimation::robust::Loss;

/// One view's part that variances change.
pub(super) struct ViewPart {
    pub(super) observation: usize,
    /// L of L Lᵀ = the pose's block.
    pose_factor: Matrix6<f64>,
    /// L⁻¹ of what couples the pose with: the globals, the motion, the residual.
    half: Matrix6xX<f64>,
    half_motion: Matrix6<f64>,
    half_gradient: Vector6<f64>,
    /// The motion's block, its coupling with the globals (6 × globals), its gradient; the pose
    /// eliminated.
    pub(super) motion: Matrix6<f64>,
    pub(super) motion_coupling: Matrix6xX<f64>,
    pub(super) motion_gradient: Vector6<f64>,
}

/// The equations of all views.
pub(super) struct System {
    /// Sum of the squared residuals, in the corners' own standard deviations.
    pub(super) cost: f64,
    /// How many residuals.
    pub(super) residual_count: usize,
    /// Its lower half.
    pub(super) global: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) views: Vec<ViewPart>,
    /// Per point: the gradient by its own x and y, and the diagonal of their information.
    pub(super) own_scores: Vec<[f64; 4]>,
    /// Per observation: (projected − observed) / std.
    pub(super) residuals: Vec<Vec<[f64; 2]>>,
}

/// Room that is used again from view to view.
#[derive(Default)]
struct Room {
    columns: Columns,
    local: LocalEquations,
    values: Vec<f64>,
}

impl System {
    /// `None` where an inlier cannot be projected, or an interrupt was requested.
    pub(super) fn at(scene: Scene<'_>, state: &EffectsState) -> Option<Self> {
        let globals = scene.global_len();
        let mut system = Self {
            cost: 0.0,
            residual_count: 0,
            global: DMatrix::zeros(globals, globals),
            gradient: DVector::zeros(globals),
            views: Vec::with_capacity(scene.good.len()),
            own_scores: vec![[0.0; 4]; scene.basis.points.len()],
            residuals: scene.observations.iter().map(|o| vec![[0.0; 2]; o.points.len()]).collect(),
        };
        let offsets = scene.basis.offsets(&state.shape);
        let mut room = Room::default();
        for observation in scene.good {
            if scene.layout.interrupt.is_requested() {
                return None;
            }
            system.add_view(scene, (state, &offsets), *observation, &mut room)?;
        }
        system.eliminate_poses();
        Some(system)
    }

    fn add_view(
        &mut self,
        scene: Scene<'_>,
        (state, offsets): (&EffectsState, &[Vector3<f64>]),
        index: usize,
        room: &mut Room,
    ) -> Option<()> {
        let seen = state.moved_observation(scene, offsets, index);
        let results = (self.residuals[index].as_mut_slice(), &mut room.local);
        let at = (scene.layout, &state.fixed);
        if !linearize_observation(at, &seen, Loss::Squares, &mut room.columns, results) {
            return None;
        }
        self.cost += room.local.cost;
        self.residual_count += 2 * seen.used.iter().filter(|used| **used).count();
        let rotation = state.fixed.rig_from_board[seen.frame_set].rotation_matrix();
        let columns = ViewColumns::of(scene, &seen, index);
        let in_plane = columns.fill(&rotation, &seen, room.columns.values(), &mut room.values);
        multiply(&room.values, columns.count(), &mut room.local);
        columns.add_scores(&room.values, &in_plane, &mut self.own_scores);
        self.views.push(columns.add_to(
            (&mut self.global, &mut self.gradient),
            (&room.local, &room.values, &in_plane),
            index,
        )?);
        Some(())
    }

    /// Takes from the global block what the poses explain, all views in one product.
    fn eliminate_poses(&mut self) {
        let globals = self.gradient.len();
        let mut halves = DMatrix::zeros(6 * self.views.len(), globals);
        for (k, view) in self.views.iter().enumerate() {
            halves.rows_mut(6 * k, 6).copy_from(&view.half);
            self.gradient -= view.half.transpose() * view.half_gradient;
        }
        take_square_from_lower(&mut self.global, &halves);
    }
}

impl ViewPart {
    /// By how much its pose alone can lower the cost.
    pub(super) fn pose_decrease(&self) -> f64 {
        self.half_gradient.norm_squared()
    }

    /// The step of the pose that belongs to steps of the globals and of the motion.
    pub(super) fn pose_step(&self, global: &DVector<f64>, motion: &Vector6<f64>) -> Vector6<f64> {
        let right = self.half_gradient + &self.half * global + self.half_motion * motion;
        self.pose_factor.tr_solve_lower_triangular(&-right).unwrap_or_else(Vector6::zeros)
    }

    /// How the pose follows the globals, and the motion: (6 × globals, 6 × 6), and the covariance
    /// of the pose when both are known.
    pub(super) fn pose_response(&self) -> Option<(Matrix6xX<f64>, Matrix6<f64>, Matrix6<f64>)> {
        let inverse = self.pose_factor.try_inverse()?;
        let up = inverse.transpose();
        Some((-(up * &self.half), -(up * self.half_motion), up * inverse))
    }
}

/// Where the columns of one view's Jacobian lie: lens, smooth shapes, motion, pose, residual; each
/// all corners' x, then all corners' y.
pub(super) struct ViewColumns<'a> {
    scene: Scene<'a>,
    lens: usize,
    smooth: usize,
    pub(super) rows: usize,
    point_of: &'a [usize],
}

impl<'a> ViewColumns<'a> {
    pub(super) fn of(scene: Scene<'a>, seen: &BoardObservation, index: usize) -> Self {
        Self {
            scene,
            lens: scene.layout.len,
            smooth: scene.basis.smooth_len(),
            rows: 2 * seen.points.len().max(1).next_multiple_of(8),
            point_of: &scene.basis.point_of[index],
        }
    }

    pub(super) fn motion(&self) -> usize {
        self.lens + self.smooth
    }

    pub(super) fn pose(&self) -> usize {
        self.motion() + if self.scene.moves { 6 } else { 0 }
    }

    pub(super) fn residual(&self) -> usize {
        self.pose() + 6
    }

    pub(super) fn count(&self) -> usize {
        self.residual() + 1
    }

    /// How many globals there are.
    pub(super) fn globals(&self) -> usize {
        self.scene.global_len()
    }

    /// The points that have offsets of their own, corner by corner.
    pub(super) fn own(&self) -> &'a [usize] {
        if self.scene.basis.has_own { self.point_of } else { &[] }
    }

    /// Fills `values` from the columns (lens, pose, residual) of the plain problem; answers the
    /// derivatives by a movement along the board's x and y.
    pub(super) fn fill(
        &self,
        camera_from_board: &nalgebra::Matrix3<f64>,
        seen: &BoardObservation,
        plain: &[f64],
        values: &mut Vec<f64>,
    ) -> [Vec<f64>; 2] {
        let (rows, half) = (self.rows, self.rows / 2);
        let basis = self.scene.basis;
        values.clear();
        values.resize(self.count() * rows, 0.0);
        values[..self.lens * rows].copy_from_slice(&plain[..self.lens * rows]);
        values[self.pose() * rows..].copy_from_slice(&plain[self.lens * rows..]);
        let pose = &plain[self.lens * rows..];
        let [by_x, by_y, by_z] = [0, 1, 2].map(|axis| -> Vec<f64> {
            let by = |row: usize| {
                (0..3).map(|k| camera_from_board[(k, axis)] * pose[(3 + k) * rows + row]).sum()
            };
            (0..rows).map(by).collect()
        });
        let (heights, stretches) = values[self.lens * rows..][..self.smooth * rows]
            .split_at_mut(basis.heights.len() * rows);
        for (column, (_, height)) in heights.chunks_exact_mut(rows).zip(&basis.heights) {
            for (corner, point) in self.point_of.iter().enumerate() {
                for row in [corner, corner + half] {
                    column[row] = by_z[row] * height[*point];
                }
            }
        }
        for (column, stretch) in stretches.chunks_exact_mut(rows).zip(&basis.stretches) {
            for (corner, point) in self.point_of.iter().enumerate() {
                let [x, y] = stretch[*point];
                for row in [corner, corner + half] {
                    column[row] = by_x[row] * x + by_y[row] * y;
                }
            }
        }
        let times = read_out_times(seen, self.scene);
        let lever = 1.0 / basis.half_extent[0].hypot(basis.half_extent[1]);
        for column in 0..self.pose() - self.motion() {
            let unit = if column < 3 { lever } else { 1.0 };
            for (corner, time) in times.iter().enumerate() {
                for row in [corner, corner + half] {
                    values[(self.motion() + column) * rows + row] =
                        pose[column * rows + row] * time * unit;
                }
            }
        }
        [by_x, by_y]
    }

    /// Adds what the view says of each point's own offset.
    fn add_scores(&self, values: &[f64], in_plane: &[Vec<f64>; 2], scores: &mut [[f64; 4]]) {
        let residual = &values[self.residual() * self.rows..];
        for (corner, point) in self.point_of.iter().enumerate() {
            for row in [corner, corner + self.rows / 2] {
                for (axis, by) in in_plane.iter().enumerate() {
                    scores[*point][axis] += by[row] * residual[row];
                    scores[*point][2 + axis] += by[row] * by[row];
                }
            }
        }
    }

    /// Adds the view to the global equations, its pose not yet eliminated.
    fn add_to(
        &self,
        (global, gradient): (&mut DMatrix<f64>, &mut DVector<f64>),
        (local, values, in_plane): (&LocalEquations, &[f64], &[Vec<f64>; 2]),
        observation: usize,
    ) -> Option<ViewPart> {
        let (dense, residual) = (self.motion(), self.residual());
        let block = |a: usize, b: usize| Matrix6::from_fn(|i, j| local.product(a + i, b + j));
        let mut coupling = Matrix6xX::zeros(gradient.len());
        let moving = if self.scene.moves { gradient.len() } else { 0 };
        let mut motion_coupling = Matrix6xX::zeros(moving);
        for i in 0..dense {
            gradient[i] += local.product(i, residual);
            for j in i..dense {
                global[(j, i)] += local.product(i, j);
            }
            for k in 0..6 {
                coupling[(k, i)] = local.product(i, self.pose() + k);
                if self.scene.moves {
                    motion_coupling[(k, i)] = local.product(i, self.motion() + k);
                }
            }
        }
        for axis in 0..2 {
            self.add_own(axis, (global, gradient), (values, in_plane));
            self.couple_own(axis, self.pose(), (values, in_plane), &mut coupling);
            if self.scene.moves {
                self.couple_own(axis, self.motion(), (values, in_plane), &mut motion_coupling);
            }
        }
        let pose_factor = block(self.pose(), self.pose()).cholesky()?.unpack();
        let half_gradient = pose_factor.solve_lower_triangular(&Vector6::from_fn(|k, _| {
            local.product(self.pose() + k, residual)
        }))?;
        let half = pose_factor.solve_lower_triangular(&coupling)?;
        let (mut half_motion, mut motion) = (Matrix6::zeros(), Matrix6::zeros());
        let mut motion_gradient = Vector6::zeros();
        if self.scene.moves {
            half_motion = pose_factor.solve_lower_triangular(&block(self.pose(), self.motion()))?;
            motion_coupling.gemm(-1.0, &half_motion.transpose(), &half, 1.0);
            motion = block(self.motion(), self.motion()) - half_motion.transpose() * half_motion;
            motion_gradient = Vector6::from_fn(|k, _| local.product(self.motion() + k, residual))
                - half_motion.transpose() * half_gradient;
        }
        Some(ViewPart {
            observation,
            pose_factor,
            motion,
            half,
            half_motion,
            half_gradient,
            motion_coupling,
            motion_gradient,
        })
    }

    /// Adds what the points' own offsets along one axis add.
    fn add_own(
        &self,
        axis: usize,
        (global, gradient): (&mut DMatrix<f64>, &mut DVector<f64>),
        (values, in_plane): (&[f64], &[Vec<f64>; 2]),
    ) {
        let (dense, half) = (self.motion(), self.rows / 2);
        let residual = &values[self.residual() * self.rows..][..self.rows];
        let by = &in_plane[axis];
        for (i, column) in values.chunks_exact(self.rows).take(dense).enumerate() {
            let mut target = global.column_mut(i);
            for (corner, point) in self.own().iter().enumerate() {
                target[dense + 2 * point + axis] +=
                    by[corner] * column[corner] + by[corner + half] * column[corner + half];
            }
        }
        for (corner, point) in self.own().iter().enumerate() {
            let at = dense + 2 * point + axis;
            gradient[at] +=
                by[corner] * residual[corner] + by[corner + half] * residual[corner + half];
            for other in axis..2 {
                let with = &in_plane[other];
                global[(dense + 2 * point + other, at)] +=
                    by[corner] * with[corner] + by[corner + half] * with[corner + half];
            }
        }
    }

    /// Couples the points' own offsets along one axis with the six columns at `first`.
    fn couple_own(
        &self,
        axis: usize,
        first: usize,
        (values, in_plane): (&[f64], &[Vec<f64>; 2]),
        coupling: &mut Matrix6xX<f64>,
    ) {
        let (dense, half) = (self.motion(), self.rows / 2);
        let by = &in_plane[axis];
        for (k, column) in values[first * self.rows..].chunks_exact(self.rows).take(6).enumerate() {
            for (corner, point) in self.own().iter().enumerate() {
                coupling[(k, dense + 2 * point + axis)] =
                    by[corner] * column[corner] + by[corner + half] * column[corner + half];
            }
        }
    }
}
