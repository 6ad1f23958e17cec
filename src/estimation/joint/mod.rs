//! The one least-squares problem behind every calibration: sensors × lenses × sensor-to-rig poses ×
//! board poses per frame set × an optional warp of the board.
//!
//! ```text
//! p = sensor_from_rig · rig_from_board · (X + warp)      residual = (lens(p) − pixel) / std
//! ```
//!
//! | term | where |
//! | --- | --- |
//! | which parameters are free, and where each lies in the vector | [`Layout`] |
//! | residuals, their derivatives, the loss | `linearize` |
//! | normal equations, board poses eliminated (Schur complement) | `normal` |
//! | the same for each observation separately, to be assembled for any subset | `per_observation` |
//! | steps: Levenberg–Marquardt with a gain ratio | `minimize` |
//!
//! One camera is a rig of one sensor whose `sensor_from_rig` is the identity. Planes that a depth
//! camera measured add residuals of their own (`depth_terms`). Points are relative to a common
//! center, so that a pose's rotation and translation hardly depend on each other. Cost per
//! iteration is linear in the number of views; no result depends on threads.

pub(crate) mod depth_terms;
pub(crate) mod free_lens;
#[cfg(test)]
mod jacobian_tests;
pub(crate) mod linearize;
pub(crate) mod minimize;
pub(crate) mod normal;
pub(crate) mod per_observation;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::estimation::interrupt::Interrupt;
pub(crate) use crate::estimation::joint::free_lens::FreeLens;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::Pixel;
use crate::geometry::pose::Pose;

/// One sensor's observation of the board at one frame set.
#[derive(Debug, Clone)]
pub(crate) struct BoardObservation {
    pub(crate) sensor: usize,
    pub(crate) frame_set: usize,
    /// In the board frame, relative to the problem's center.
    pub(crate) points: Vec<Point3<f64>>,
    pub(crate) pixels: Vec<Pixel>,
    /// 1 over each corner's relative standard deviation, in 1/px.
    pub(crate) inverse_std: Vec<f64>,
    /// Whether each corner is used.
    pub(crate) used: Vec<bool>,
}

/// The values of all parameters.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub(crate) lenses: Vec<Lens>,
    pub(crate) sensor_from_rig: Vec<Pose>,
    pub(crate) rig_from_board: Vec<Pose>,
    /// The board's bow along x and y: the heights of its middle, in meters.
    pub(crate) warp: [f64; 2],
}

/// The index of each global parameter: for each sensor those of its lens, for each but the first
/// those of its pose; then the warp.
#[derive(Debug, Clone)]
pub(crate) struct Layout {
    pub(crate) sensors: Vec<SensorLayout>,
    /// `None` for a flat board.
    pub(crate) warp: Option<WarpLayout>,
    /// Number of global parameters.
    pub(crate) len: usize,
    /// Ends iterations early: once it is requested, linearization returns `None`.
    pub(crate) interrupt: Interrupt,
}

/// The index of the two parameters of the board's warp, and the extent that it refers to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WarpLayout {
    pub(crate) at: usize,
    /// Half the board's extent along x and y, in meters.
    pub(crate) half_extent_m: [f64; 2],
}

/// The indices of the parameters of one sensor.
#[derive(Debug, Clone)]
pub(crate) struct SensorLayout {
    pub(crate) lens: FreeLens,
    pub(crate) lens_at: usize,
    /// `None` for the sensor that is the rig's own frame.
    pub(crate) pose_at: Option<usize>,
}

impl Layout {
    pub(crate) fn new(lenses: Vec<FreeLens>, warp_half_extent_m: Option<[f64; 2]>) -> Self {
        let mut len = 0;
        let mut take = |n: usize| {
            let at = len;
            len += n;
            at
        };
        let sensors = lenses
            .into_iter()
            .enumerate()
            .map(|(index, lens)| {
                let lens_at = take(lens.free.len());
                let pose_at = (index > 0).then(|| take(6));
                SensorLayout { lens, lens_at, pose_at }
            })
            .collect();
        let warp =
            warp_half_extent_m.map(|half_extent_m| WarpLayout { at: take(2), half_extent_m });
        Self { sensors, warp, len, interrupt: Interrupt::default() }
    }

    /// The layout of sensors with known lenses and poses: only the board's poses are estimated.
    pub(crate) fn of_known_sensors(lenses: &[Lens]) -> Self {
        let known = |lens: &Lens| {
            let lens = FreeLens { model: lens.model(), free: Vec::new(), square_pixels: false };
            SensorLayout { lens, lens_at: 0, pose_at: None }
        };
        let sensors = lenses.iter().map(known).collect();
        Self { sensors, warp: None, len: 0, interrupt: Interrupt::default() }
    }

    /// The same layout, whose iterations `interrupt` ends.
    pub(crate) fn ended_by(self, interrupt: &Interrupt) -> Self {
        Self { interrupt: interrupt.clone(), ..self }
    }

    /// The height of a point of the board above its plane per meter of each of the two bows: 1 −
    /// (x/half extent)², 0 at the edges (mrcal's model).
    pub(crate) fn bows(&self, point: &Point3<f64>) -> [f64; 2] {
        let Some(WarpLayout { half_extent_m: [half_x, half_y], .. }) = self.warp else {
            return [0.0; 2];
        };
        [1.0 - (point.x / half_x).powi(2), 1.0 - (point.y / half_y).powi(2)]
    }
}

impl State {
    /// The pose of the board in a sensor's frame.
    pub(crate) fn sensor_from_board(&self, sensor: usize, frame_set: usize) -> Pose {
        if sensor == 0 {
            self.rig_from_board[frame_set]
        } else {
            self.sensor_from_rig[sensor] * self.rig_from_board[frame_set]
        }
    }

    /// The offset of a point of the board along the board's normal by the warp, in meters.
    pub(crate) fn bow(&self, layout: &Layout, point: &Point3<f64>) -> f64 {
        let [by_x, by_y] = layout.bows(point);
        self.warp[0] * by_x + self.warp[1] * by_y
    }

    /// (projected − observed) / std of each corner of an observation; infinite where a corner
    /// cannot be projected.
    pub(crate) fn residuals(
        &self,
        layout: &Layout,
        observation: &BoardObservation,
    ) -> Vec<[f64; 2]> {
        let sensor_from_board = self.sensor_from_board(observation.sensor, observation.frame_set);
        let lens = &self.lenses[observation.sensor];
        let corners =
            observation.points.iter().zip(&observation.pixels).zip(&observation.inverse_std);
        corners
            .map(|((point, observed), inverse_std)| {
                let point = point + Vector3::z() * self.bow(layout, point);
                match lens.pixel_from_point(&(sensor_from_board * point)) {
                    Some(pixel) => {
                        [(pixel.x - observed.x) * inverse_std, (pixel.y - observed.y) * inverse_std]
                    }
                    None => [f64::INFINITY; 2],
                }
            })
            .collect()
    }

    /// The state after a step: `global` in the order of `layout`, `frame_sets` with six numbers
    /// each. `None` where a lens is no longer valid: a parameter is not finite, or a focal length
    /// not positive.
    pub(crate) fn stepped(
        &self,
        layout: &Layout,
        global: &[f64],
        frame_sets: &[[f64; 6]],
    ) -> Option<Self> {
        let mut next = self.clone();
        for (sensor, at) in layout.sensors.iter().enumerate() {
            let mut parameters = self.lenses[sensor].parameters();
            for (k, index) in at.lens.free.iter().enumerate() {
                parameters[*index] += global[at.lens_at + k];
            }
            if at.lens.square_pixels {
                parameters[1] = parameters[0];
            }
            let positive = parameters[0] > 0.0 && parameters[1] > 0.0;
            if !positive || !parameters.iter().all(|p| p.is_finite()) {
                return None;
            }
            next.lenses[sensor] = Lens::from_parameters(at.lens.model, &parameters)?;
            if let Some(pose_at) = at.pose_at {
                next.sensor_from_rig[sensor] =
                    moved(&self.sensor_from_rig[sensor], &global[pose_at..pose_at + 6]);
            }
        }
        if let Some(WarpLayout { at, .. }) = layout.warp {
            next.warp = [self.warp[0] + global[at], self.warp[1] + global[at + 1]];
        }
        for (pose, step) in next.rig_from_board.iter_mut().zip(frame_sets) {
            *pose = moved(pose, step);
        }
        Some(next)
    }
}

/// A pose after a small rotation about its target's axes, exp(ω) R, and a translation t + τ; `step`
/// is (ω, τ).
pub(crate) fn moved(a_from_b: &Pose, step: &[f64]) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    Pose::new(
        rotation * a_from_b.rotation(),
        a_from_b.translation() + Vector3::new(step[3], step[4], step[5]),
    )
}
