//! Bundle adjustment: the lens, all poses and all points that fit all observations best, by
//! Levenberg–Marquardt (B. Triggs et al., *Bundle adjustment – a modern synthesis*, 2000). Each
//! point is eliminated from the normal equations (the Schur complement), so that a step costs a
//! solve of the size of the lens and the poses. After each step every point makes a step of its own
//! (Y. Jeong et al., *Pushing the envelope of modern methods for bundle adjustment*, 2012: embedded
//! point iterations). Where focal length and depth are correlated, the valley of the cost is narrow
//! and curved, and points off its floor would shorten every step.

use nalgebra::{
    DMatrix, DVector, Matrix2x3, Matrix2x6, Matrix3, Point3, SMatrix, Vector2, Vector3,
};

use crate::estimation::interrupt::Interrupt;
use crate::estimation::scene::lens_prior::LensPrior;
use crate::estimation::scene::problem::TrackPoint;
use crate::geometry::lens::{Lens, MAX_PARAMETERS};
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// The parameters that are estimated.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneState {
    /// The lens of all images.
    pub lens: Lens,
    /// Each image's pose. The first is fixed: it defines the scene's frame.
    pub cameras_from_scene: Vec<Pose>,
    /// In the scene's frame.
    pub points: Vec<Point3<f64>>,
}

/// The observation of one point in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneObservation {
    /// Index of the pose.
    pub camera: usize,
    /// Where the point was observed.
    pub pixel: Pixel,
    /// The scale of the feature there: the standard deviation of a Gaussian, in pixels.
    pub scale_px: f64,
    /// One over the standard deviation of each coordinate, per pixel.
    pub inverse_std: f64,
}

impl SceneObservation {
    /// The observations of one scene point, by camera. `camera_of` gives the camera of an image; an
    /// image without one is left out.
    pub(super) fn of_track(
        track: &[TrackPoint],
        camera_of: impl Fn(usize) -> Option<usize>,
    ) -> Vec<Self> {
        let of_point = |at: &TrackPoint| {
            Some(Self {
                camera: camera_of(at.image)?,
                pixel: at.pixel,
                scale_px: at.scale_px,
                inverse_std: 1.0 / at.std_px,
            })
        };
        let mut seen: Vec<Self> = track.iter().filter_map(of_point).collect();
        seen.sort_by_key(|seen| seen.camera);
        seen
    }
}

/// A bundle adjustment problem: the observations, and the parameters that are free.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// For each point.
    pub observations: Vec<Vec<SceneObservation>>,
    /// Which of [`Lens::parameters`] are estimated, ascending.
    pub free: Vec<usize>,
    /// The prior of the lens.
    pub prior: LensPrior,
    /// How the camera moved.
    pub motion: CameraMotion,
    /// The scale of Cauchy's loss, in standard deviations: larger residuals have little weight.
    /// Infinite for least squares.
    pub robust_limit: f64,
    /// Ends iterations early.
    pub interrupt: Interrupt,
}

/// How the camera moved between the images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraMotion {
    /// Its position changed.
    Moving,
    /// It only rotated: translations are 0, and points are directions.
    RotationOnly,
}

/// A linearized observation, in standard deviations.
pub(super) struct PixelRow {
    pub camera: usize,
    pub pixel: Pixel,
    pub residual: Vector2<f64>,
    pub by_lens: SMatrix<f64, 2, MAX_PARAMETERS>,
    pub by_pose: Matrix2x6<f64>,
    pub by_point: Matrix2x3<f64>,
}

/// The normal equations of lens and poses, points eliminated.
pub(super) struct ReducedCameraSystem {
    pub matrix: DMatrix<f64>,
    pub gradient: DVector<f64>,
    /// Per point, what is needed to compute its step.
    points: Vec<EliminatedPoint>,
}

struct EliminatedPoint {
    inverse: Matrix3<f64>,
    gradient: Vector3<f64>,
    by_lens: SMatrix<f64, MAX_PARAMETERS, 3>,
    by_pose: Vec<(usize, SMatrix<f64, 6, 3>)>,
}

/// When iterations end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleStop {
    /// The largest number of steps.
    pub max_steps: usize,
    /// The last step is one that lowers the cost by less than this part.
    pub least_decrease: f64,
}

/// Marquardt's λ at the start, as a part of each diagonal element. It allows nearly a Gauss–Newton
/// step, since resection and triangulation start close to the minimum. Not swept.
const START_DAMPING: f64 = 1e-4;
/// The factor by which λ rises after a step that raises the cost, and falls after one that lowers
/// it (D. Marquardt, 1963).
const DAMPING_FACTOR: f64 = 10.0;
/// The lower limit of λ, so that a few rises restore it.
const MIN_DAMPING: f64 = 1e-9;
/// With a larger λ a step is below rounding, and cannot lower the cost.
const MAX_DAMPING: f64 = 1e8;

impl Bundle {
    /// Number of parameters of lens and poses.
    pub(super) fn size(&self, cameras: usize) -> usize {
        self.free.len() + 6 * cameras.saturating_sub(1)
    }

    /// The index of the first parameter of a camera's pose; `None` for the first camera, which is
    /// fixed.
    pub(super) fn pose_start(&self, camera: usize) -> Option<usize> {
        Some(self.free.len() + 6 * camera.checked_sub(1)?)
    }

    /// The observations of one point, linearized, without those behind their camera.
    pub(super) fn rows(&self, state: &SceneState, point: usize) -> Vec<PixelRow> {
        let row = |seen: &SceneObservation| {
            let camera_from_scene = state.cameras_from_scene[seen.camera];
            let in_camera = camera_from_scene * state.points[point];
            let projection = state.lens.project(&in_camera)?;
            let offset = projection.pixel.to_vector() - seen.pixel.to_vector();
            let residual = offset * seen.inverse_std;
            let weight = self.weight(residual.norm_squared()).sqrt();
            let scale = seen.inverse_std * weight;
            let rotation = camera_from_scene.rotation_matrix();
            let by_point = projection.by_point * scale;
            let rotated = rotation * state.points[point].coords;
            let by_rotation = -by_point * rotated.cross_matrix();
            let mut by_pose = Matrix2x6::zeros();
            by_pose.fixed_columns_mut::<3>(0).copy_from(&by_rotation);
            if self.motion == CameraMotion::Moving {
                by_pose.fixed_columns_mut::<3>(3).copy_from(&by_point);
            }
            let mut by_lens = SMatrix::<f64, 2, MAX_PARAMETERS>::zeros();
            for (k, parameter) in self.free.iter().enumerate() {
                by_lens.set_column(k, &(projection.by_parameters.column(*parameter) * scale));
            }
            Some(PixelRow {
                camera: seen.camera,
                pixel: seen.pixel,
                residual: residual * weight,
                by_lens,
                by_pose,
                by_point: by_point * rotation,
            })
        };
        self.observations[point].iter().filter_map(row).collect()
    }

    /// The weight of an observation with this squared residual, in squared standard deviations.
    fn weight(&self, square: f64) -> f64 {
        if self.robust_limit.is_finite() {
            1.0 / (1.0 + square / self.robust_limit.powi(2))
        } else {
            1.0
        }
    }

    fn loss(&self, square: f64) -> f64 {
        let limit = self.robust_limit.powi(2);
        if limit.is_finite() { limit * (1.0 + square / limit).ln() } else { square }
    }

    /// The cost that is minimized: losses and the prior's squared residuals. An observation behind
    /// its camera costs as much as one with a residual of a hundred standard deviations.
    pub fn cost(&self, state: &SceneState) -> f64 {
        let points: f64 = (0..state.points.len()).map(|point| self.point_cost(state, point)).sum();
        let prior = self.prior.terms(&state.lens);
        points + prior.iter().map(|term| term.residual * term.residual).sum::<f64>()
    }

    /// The losses of the observations of one point.
    fn point_cost(&self, state: &SceneState, point: usize) -> f64 {
        let loss = |seen: &SceneObservation| {
            let in_camera = state.cameras_from_scene[seen.camera] * state.points[point];
            let square = state.lens.pixel_from_point(&in_camera).map_or(1e4, |pixel| {
                (pixel.to_vector() - seen.pixel.to_vector()).norm_squared()
                    * seen.inverse_std
                    * seen.inverse_std
            });
            self.loss(square)
        };
        self.observations[point].iter().map(loss).sum()
    }

    /// The reduced normal equations at `state`, with diagonals multiplied by 1 + `damping`.
    pub(super) fn reduced(&self, state: &SceneState, damping: f64) -> ReducedCameraSystem {
        let size = self.size(state.cameras_from_scene.len());
        let lens = self.free.len();
        let (mut matrix, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut points = Vec::with_capacity(state.points.len());
        for point in 0..state.points.len() {
            let rows = self.rows(state, point);
            let mut block = Matrix3::zeros();
            let mut point_gradient = Vector3::zeros();
            let mut by_lens = SMatrix::<f64, MAX_PARAMETERS, 3>::zeros();
            let mut by_pose: Vec<(usize, SMatrix<f64, 6, 3>)> = Vec::with_capacity(rows.len());
            for row in &rows {
                block += row.by_point.tr_mul(&row.by_point);
                point_gradient += row.by_point.tr_mul(&row.residual);
                by_lens += row.by_lens.tr_mul(&row.by_point);
                add_lens(&mut matrix, &mut gradient, row, lens);
                let Some(start) = self.pose_start(row.camera) else { continue };
                add_pose(&mut matrix, &mut gradient, row, start, lens);
                by_pose.push((start, row.by_pose.tr_mul(&row.by_point)));
            }
            for k in 0..3 {
                block[(k, k)] *= 1.0 + damping;
            }
            block += self.held_length(&block, &state.points[point]);
            let inverse = block.try_inverse().unwrap_or_else(Matrix3::zeros);
            let eliminated =
                EliminatedPoint { inverse, gradient: point_gradient, by_lens, by_pose };
            eliminated.subtract(&mut matrix, &mut gradient, lens);
            points.push(eliminated);
        }
        self.add_prior(&state.lens, &mut matrix, &mut gradient);
        if self.motion == CameraMotion::RotationOnly {
            for translation in (lens + 3..size).filter(|k| (k - lens) % 6 >= 3) {
                matrix[(translation, translation)] = 1.0;
            }
        }
        for k in 0..size {
            matrix[(k, k)] *= 1.0 + damping;
        }
        matrix.fill_upper_triangle_with_lower_triangle();
        ReducedCameraSystem { matrix, gradient, points }
    }

    /// The term that fixes the length of a direction, which has no meaning, in its normal
    /// equations.
    pub(super) fn held_length(&self, block: &Matrix3<f64>, point: &Point3<f64>) -> Matrix3<f64> {
        if self.motion == CameraMotion::Moving {
            return Matrix3::zeros();
        }
        point.coords * point.coords.transpose() * block.trace()
    }

    pub(super) fn add_prior(
        &self,
        lens: &Lens,
        matrix: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) {
        for term in self.prior.terms(lens) {
            let index_of = |parameter: usize| self.free.iter().position(|free| *free == parameter);
            let terms: Vec<(usize, f64)> =
                term.by_parameters.iter().filter_map(|(p, d)| Some((index_of(*p)?, *d))).collect();
            for (i, a) in &terms {
                gradient[*i] += a * term.residual;
                for (j, b) in terms.iter().filter(|(j, _)| j <= i) {
                    matrix[(*i, *j)] += a * b;
                }
            }
        }
    }

    /// Iterates from `start` to a minimum.
    pub fn minimize(&self, start: SceneState, stop: BundleStop) -> SceneState {
        let mut state = start;
        let mut cost = self.cost(&state);
        let mut damping = START_DAMPING;
        let mut was_raised = false;
        for _ in 0..stop.max_steps {
            if self.interrupt.is_requested() {
                break;
            }
            let reduced = self.reduced(&state, damping);
            let next = self.step(&state, &reduced).map(|next| self.with_points_moved(next));
            let next = next.map(|next| (self.cost(&next), next));
            let Some((next_cost, next)) = next.filter(|(next_cost, _)| *next_cost < cost) else {
                damping *= DAMPING_FACTOR;
                was_raised = true;
                if damping > MAX_DAMPING {
                    break;
                }
                continue;
            };
            let settled = cost - next_cost < stop.least_decrease * cost;
            (state, cost) = (next, next_cost);
            // A λ that has just failed would fail again.
            if !was_raised {
                damping = (damping * 0.1).max(MIN_DAMPING);
            }
            was_raised = false;
            if settled {
                break;
            }
        }
        state
    }

    /// Makes one Gauss–Newton step of each point, with lens and poses fixed.
    fn with_points_moved(&self, mut state: SceneState) -> SceneState {
        for point in 0..state.points.len() {
            let (mut block, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
            for row in self.rows(&state, point) {
                block += row.by_point.tr_mul(&row.by_point);
                gradient += row.by_point.tr_mul(&row.residual);
            }
            block += self.held_length(&block, &state.points[point]);
            let Some(inverse) = block.try_inverse() else { continue };
            let (before, cost) = (state.points[point], self.point_cost(&state, point));
            state.points[point] -= inverse * gradient;
            if !(self.point_cost(&state, point) < cost) {
                state.points[point] = before;
            }
        }
        state
    }

    fn step(&self, state: &SceneState, reduced: &ReducedCameraSystem) -> Option<SceneState> {
        let step = -reduced.matrix.clone().cholesky()?.solve(&reduced.gradient);
        let mut parameters = state.lens.parameters();
        for (k, parameter) in self.free.iter().enumerate() {
            parameters[*parameter] += step[k];
        }
        let plausible = parameters[0] > 0.0 && parameters[1] > 0.0;
        let lens = Lens::from_parameters(state.lens.model(), &parameters).filter(|_| plausible)?;
        let moved = |(camera, camera_from_scene): (usize, &Pose)| {
            let Some(start) = self.pose_start(camera) else { return *camera_from_scene };
            let part =
                |k: usize| Vector3::new(step[start + k], step[start + k + 1], step[start + k + 2]);
            let rotation = nalgebra::UnitQuaternion::from_scaled_axis(part(0));
            let translation = camera_from_scene.translation() + part(3);
            Pose::new(rotation * camera_from_scene.rotation(), translation)
        };
        let points = state.points.iter().zip(&reduced.points);
        Some(SceneState {
            lens,
            cameras_from_scene: state.cameras_from_scene.iter().enumerate().map(moved).collect(),
            points: points.map(|(point, own)| point + own.step(&step, self.free.len())).collect(),
        })
    }
}

fn add_lens(matrix: &mut DMatrix<f64>, gradient: &mut DVector<f64>, row: &PixelRow, lens: usize) {
    for i in 0..lens {
        let column = row.by_lens.column(i);
        gradient[i] += column.dot(&row.residual);
        for j in 0..=i {
            matrix[(i, j)] += column.dot(&row.by_lens.column(j));
        }
    }
}

fn add_pose(
    matrix: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
    row: &PixelRow,
    start: usize,
    lens: usize,
) {
    for i in 0..6 {
        let column = row.by_pose.column(i);
        gradient[start + i] += column.dot(&row.residual);
        for j in 0..lens {
            matrix[(start + i, j)] += column.dot(&row.by_lens.column(j));
        }
        for j in 0..=i {
            matrix[(start + i, start + j)] += column.dot(&row.by_pose.column(j));
        }
    }
}

impl EliminatedPoint {
    /// Subtracts the point's part from the lower triangle.
    fn subtract(&self, matrix: &mut DMatrix<f64>, gradient: &mut DVector<f64>, lens: usize) {
        let by_lens = self.by_lens * self.inverse;
        let lens_gradient = by_lens * self.gradient;
        for i in 0..lens {
            gradient[i] -= lens_gradient[i];
            for j in 0..=i {
                matrix[(i, j)] -= by_lens.row(i).dot(&self.by_lens.row(j));
            }
        }
        for (a, (start, block)) in self.by_pose.iter().enumerate() {
            let carried = block * self.inverse;
            let pose_gradient = carried * self.gradient;
            let mut own_gradient = gradient.fixed_rows_mut::<6>(*start);
            own_gradient -= pose_gradient;
            for j in 0..lens {
                let mut view = matrix.fixed_view_mut::<6, 1>(*start, j);
                view -= carried * self.by_lens.row(j).transpose();
            }
            // Observations are sorted by camera: earlier ones have smaller indices.
            for (other, other_block) in &self.by_pose[..=a] {
                let both = carried * other_block.transpose();
                let mut view = matrix.fixed_view_mut::<6, 6>(*start, *other);
                view -= both;
            }
        }
    }

    /// The point's step, given that of lens and poses.
    fn step(&self, step: &DVector<f64>, lens: usize) -> Vector3<f64> {
        let mut rest = self.gradient;
        for k in 0..lens {
            rest += self.by_lens.row(k).transpose() * step[k];
        }
        for (start, block) in &self.by_pose {
            rest += block.tr_mul(&step.fixed_rows::<6>(*start));
        }
        -(self.inverse * rest)
    }
}
