//! The values of all parameters, including the board's shape and each view's motion.

use nalgebra::{DVector, Point3, UnitQuaternion, Vector2, Vector3, Vector6};

use crate::estimation::effects::board_basis::BoardBasis;
use crate::estimation::effects::effect::Effect;
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::view_motion::read_out_time;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::{Pose, pose_step};

/// The observations, and which effects of them are modelled.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) layout: &'a Layout,
    pub(super) basis: &'a BoardBasis,
    pub(super) observations: &'a [BoardObservation],
    /// The observations that are inliers, by index.
    pub(super) good: &'a [usize],
    /// The height of the images, in rows.
    pub(super) rows: f64,
    /// As a control, the images' width where columns are read one after another in place of rows.
    pub(super) by_columns: Option<f64>,
    /// Whether motion is modelled; if not, its columns are left out.
    pub(super) moves: bool,
}

impl Scene<'_> {
    pub(super) fn global_len(&self) -> usize {
        self.layout.len + self.basis.len()
    }
}

/// Lens and poses, with the random effects.
#[derive(Debug, Clone)]
pub(crate) struct EffectsState {
    pub(crate) fixed: State,
    /// Coefficients of [`BoardBasis`], in meters.
    pub(crate) shape: Vec<f64>,
    /// Per observation, in meters: the board's motion in the camera's frame from the image's first
    /// row to its last. First a rotation vector about the board's center, times half the board's
    /// diagonal, then a translation. The pose is that at the middle row.
    pub(crate) motions: Vec<Vector6<f64>>,
}

/// A step of the parameters of one observation.
pub(super) struct ViewStep {
    pub(super) observation: usize,
    /// Rotation, translation.
    pub(super) pose: Vector6<f64>,
    /// As [`EffectsState::motions`].
    pub(super) motion: Vector6<f64>,
}

/// When each corner was read, relative to the image's middle, in units of the readout time.
pub(super) fn read_out_times(observation: &BoardObservation, scene: Scene<'_>) -> Vec<f64> {
    let time = |pixel: &Pixel| match scene.by_columns {
        None => read_out_time(pixel.y, scene.rows),
        Some(columns) => read_out_time(pixel.x, columns),
    };
    observation.pixels.iter().map(time).collect()
}

impl EffectsState {
    pub(super) fn without_effects(fixed: State, basis: &BoardBasis, observations: usize) -> Self {
        Self { fixed, shape: vec![0.0; basis.len()], motions: vec![Vector6::zeros(); observations] }
    }

    /// The state after a step of all globals (lens, then shape) and of some views.
    pub(super) fn stepped(
        &self,
        scene: Scene<'_>,
        global: &DVector<f64>,
        views: &[ViewStep],
    ) -> Option<Self> {
        let mut next = self.clone();
        let mut poses = vec![[0.0; 6]; next.fixed.rig_from_board.len()];
        for view in views {
            poses[scene.observations[view.observation].frame_set] = view.pose.into();
            // The motion rotates with the pose, as its derivatives assume.
            let rotation =
                UnitQuaternion::from_scaled_axis(view.pose.fixed_rows::<3>(0).clone_owned());
            let own = &mut next.motions[view.observation];
            *own += view.motion;
            let rotated = |at: usize, own: &Vector6<f64>| -> Vector3<f64> {
                rotation * own.fixed_rows::<3>(at).into_owned()
            };
            *own = pose_step(&rotated(0, own), &rotated(3, own));
        }
        let (lens, shape) = global.as_slice().split_at(scene.layout.len);
        next.fixed = self.fixed.stepped(scene.layout, lens, &poses)?;
        next.shape.iter_mut().zip(shape).for_each(|(u, step)| *u += step);
        Some(next)
    }

    /// An observation with its points displaced by shape and motion, in the board frame of the
    /// middle row's pose: the plain projection of these points is that of the moving board.
    pub(super) fn moved_observation(
        &self,
        scene: Scene<'_>,
        offsets: &[Vector3<f64>],
        index: usize,
    ) -> BoardObservation {
        let mut seen = scene.observations[index].clone();
        for (point, index_of_point) in seen.points.iter_mut().zip(&scene.basis.point_of[index]) {
            *point += offsets[*index_of_point];
        }
        let motion = self.motion_in_board(scene.basis, (index, seen.frame_set));
        if let Some([spin, velocity]) = motion {
            let times = read_out_times(&seen, scene);
            for (point, time) in seen.points.iter_mut().zip(times) {
                let rotation = UnitQuaternion::from_scaled_axis(spin * time);
                *point = Point3::from(rotation * point.coords + velocity * time);
            }
        }
        seen
    }

    /// Moves the rigid motion and the scale that the points' offsets have in common into the poses,
    /// since neither is a shape. Where offsets and poses cancel, only the prior constrains them, so
    /// the search ends before the offsets are free of a common motion.
    pub(super) fn with_rigid_part_in_poses(mut self, basis: &BoardBasis) -> Self {
        let own = &mut self.shape[basis.smooth_len()..];
        if !basis.has_point_offsets {
            return self;
        }
        let count = basis.points.len() as f64;
        let planar = |k: usize| Vector2::new(basis.points[k].x, basis.points[k].y);
        let center = (0..basis.points.len()).map(planar).sum::<Vector2<f64>>() / count;
        let (mut translation, mut along, mut across, mut square) =
            (Vector2::zeros(), 0.0, 0.0, 0.0);
        for (k, offset) in own.chunks_exact(2).enumerate() {
            let (arm, offset) = (planar(k) - center, Vector2::new(offset[0], offset[1]));
            translation += offset / count;
            along += arm.dot(&offset);
            across += arm.perp(&offset);
            square += arm.norm_squared();
        }
        let (scale, angle) = (along / square, across / square);
        for (k, offset) in own.chunks_exact_mut(2).enumerate() {
            let arm = planar(k) - center;
            let rigid = translation + scale * arm + angle * Vector2::new(-arm.y, arm.x);
            offset[0] -= rigid.x;
            offset[1] -= rigid.y;
        }
        // A point x' of the new shape was at translation + center + (1 + scale) R (x' - center) in
        // the old one, and distances from the camera are divided by 1 + scale.
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let center = Vector3::new(center.x, center.y, 0.0);
        let translation = Vector3::new(translation.x, translation.y, 0.0);
        for pose in &mut self.fixed.rig_from_board {
            let moved =
                (pose.rotation() * (center + translation) + pose.translation()) / (1.0 + scale);
            let rotation = pose.rotation() * rotation;
            *pose = Pose::new(rotation, moved - rotation * center);
        }
        for motion in &mut self.motions {
            motion.fixed_rows_mut::<3>(3).apply(|v| *v /= 1.0 + scale);
        }
        self
    }

    /// An observation's motion in the board frame: a rotation vector in radians, then a translation
    /// in meters; `None` without motion.
    pub(super) fn motion_in_board(
        &self,
        basis: &BoardBasis,
        (index, frame_set): (usize, usize),
    ) -> Option<[Vector3<f64>; 2]> {
        let motion = &self.motions[index];
        if motion.iter().all(|v| *v == 0.0) {
            return None;
        }
        let board_from_camera = self.fixed.rig_from_board[frame_set].rotation().inverse();
        let of = |from: usize| motion.fixed_rows::<3>(from).into_owned();
        Some([board_from_camera * (of(0) / basis.lever()), board_from_camera * of(3)])
    }

    /// Sets the coefficients of an effect to zero.
    pub(super) fn clear(&mut self, effect: Effect, basis: &BoardBasis) {
        let range = effect.range(basis);
        if effect.is_motion() {
            for motion in &mut self.motions {
                range.clone().for_each(|k| motion[k] = 0.0);
            }
        } else {
            self.shape[range].fill(0.0);
        }
    }
}
