//! Estimates from corners: lenses, the board's poses, the infrared camera's pose, and its delay.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, Vector3, Vector6};

use crate::estimation::clustered_covariance::FitCovariance;
use crate::estimation::joint::linearize::{
    Columns, LinearizationPoint, LinearizedObservation, LocalEquations, linearize_observation,
};
use crate::estimation::joint::minimize::{Stop, walk};
use crate::estimation::joint::normal::{ChainedPose, NormalEquations, ReducedView, Step};
use crate::estimation::joint::{BoardObservation, FreeLens, Layout, State, moved};
use crate::estimation::lens_pole::as_fitted;
use crate::estimation::rgbd::covariance_with_shape::covariance_with_shape;
use crate::estimation::rgbd::motion::{BoardMotion, TimeOffset};
use crate::estimation::rgbd::pose_jitter::{
    PoseByColor, PoseDifference, PoseJitter, eliminate, pose_part,
};
use crate::estimation::rgbd::problem::{DepthLens, RgbdProblem, RgbdView, free, with_origin_at};
use crate::estimation::robust::Loss;
use crate::geometry::median::median;
use crate::geometry::pose::Pose;

/// The estimate from corners: sensor 0 is color and the rig's frame, sensor 1 infrared and depth.
pub(super) struct CornerBlocks {
    pub(super) layout: Layout,
    pub(super) state: State,
    /// The same state, with each board at its pose when infrared and depth were taken.
    pub(super) depth_state: State,
    pub(super) equations: NormalEquations,
    pub(super) covariance: DMatrix<f64>,
    /// The origin of the points, in the board frame.
    pub(super) center: Vector3<f64>,
    /// By how much infrared and depth are later, where the views determine it.
    pub(super) time_offset: Option<TimeOffset>,
    /// Views whose infrared image does not fit color's even with the time offset.
    pub(super) separate_in_time: Vec<usize>,
    /// No board moved between color and infrared.
    pub(super) found_still: bool,
    /// The covariance of color's lens from color alone.
    color_covariance: Option<DMatrix<f64>>,
}

/// The largest residual of an inlier, in standard deviations per axis: of normal residuals, four in
/// a million are larger.
const CORNER_LIMIT_STDS: f64 = 5.0;

/// χ² of six degrees of freedom between color's and infrared's board pose, above which the images
/// were taken at different times: chance exceeds it three times in a million.
const VIEW_LIMIT_CHI2: f64 = 36.0;

/// The largest number of rounds in which noise, pose jitter and inliers are estimated.
const ROUNDS: usize = 10;

/// Everything that is estimated.
#[derive(Clone)]
struct CornerState {
    rig: State,
    /// In seconds.
    offset_s: f64,
}

/// What is fixed during one fit.
struct CornerProblem {
    layout: Layout,
    observations: Vec<BoardObservation>,
    /// The motion at each frame set, about the rig's axes and with the velocity of the board's
    /// center.
    motions: Vec<Option<BoardMotion>>,
    /// The time offset's index among the global parameters, and its prior.
    offset: Option<(usize, TimeOffset)>,
    pose_jitter: PoseJitter,
    /// The noise of infrared corners, relative to their own standard deviations; at least 1.
    noise: f64,
}

impl CornerBlocks {
    /// The fit, starting from sensors that were calibrated one by one. The pose jitter between
    /// color and infrared starts at the median over the views; or, where `together`, at next to
    /// none, so that infrared's lens is fitted to the boards at their poses by color.
    pub(super) fn fit_from(problem: &RgbdProblem, together: bool) -> Option<Self> {
        let center = middle_of_corners(problem);
        let start = CornerState::of(problem, &center);
        let mut posed = CornerProblem::of(problem, center)?;
        if !together {
            posed.start_jitter(&start);
        }
        let whole = posed.settle(start)?;
        let equations = posed.linearized(&whole)?;
        let by_views = posed.covariance(&whole, &equations)?;
        let covariance = match &problem.color_covariance {
            Some(by_itself) => covariance_with_shape(&posed.layout.sensors, by_views, by_itself),
            None => by_views,
        };
        let time_offset = posed.offset.map(|(at, before)| TimeOffset {
            seconds: whole.offset_s,
            std_s: covariance[(at, at)].max(0.0).sqrt(),
            ..before
        });
        let depth_state = posed.at_depth(&whole);
        let separate_in_time = posed.separate_in_time();
        let found_still = posed.pose_jitter.is_none() && separate_in_time.is_empty();
        Some(Self {
            found_still,
            layout: posed.layout,
            state: whole.rig,
            depth_state,
            equations,
            covariance,
            center,
            time_offset,
            separate_in_time,
            color_covariance: problem.color_covariance.clone(),
        })
    }

    /// The pose of each board when depth was taken, in its own earlier frame.
    pub(super) fn board_from_later(&self) -> Vec<Pose> {
        let uncentered = |rig_from_board: &Pose| with_origin_at(rig_from_board, &-self.center);
        let each = self.state.rig_from_board.iter().zip(&self.depth_state.rig_from_board);
        each.map(|(board, later)| uncentered(board).inverse() * uncentered(later)).collect()
    }

    pub(super) fn lens_covariance(&self, sensor: usize) -> DMatrix<f64> {
        if let (0, Some(by_itself)) = (sensor, &self.color_covariance) {
            return by_itself.clone();
        }
        let layout = &self.layout.sensors[sensor];
        let (at, count) = (layout.lens_at, layout.lens.free.len());
        let by_free = layout.lens.all_by_free(&self.state.lenses[sensor]);
        &by_free * self.covariance.view((at, at), (count, count)) * by_free.transpose()
    }
}

/// The mean of the board's points over all corners that were seen.
fn middle_of_corners(problem: &RgbdProblem) -> Vector3<f64> {
    let corners = || problem.views.iter().flat_map(|view| view.color.iter().chain(&view.infrared));
    corners().map(|c| c.point_in_board.coords).sum::<Vector3<f64>>()
        / corners().count().max(1) as f64
}

impl CornerState {
    /// The state of sensors that were calibrated one by one, with boards about `center`.
    fn of(problem: &RgbdProblem, center: &Vector3<f64>) -> Self {
        let board = |view: &RgbdView| with_origin_at(&view.color_from_board, center);
        let rig = State {
            lenses: vec![problem.color, problem.depth.lens],
            sensor_from_rig: vec![Pose::identity(), problem.depth_from_color],
            rig_from_board: problem.views.iter().map(board).collect(),
            warp: [0.0; 2],
        };
        Self { rig, offset_s: problem.time_offset.map_or(0.0, |offset| offset.seconds) }
    }
}

impl CornerProblem {
    /// `None` for a given parameter that color's lens does not have.
    fn of(problem: &RgbdProblem, center: Vector3<f64>) -> Option<Self> {
        let of_color = FreeLens::from_options(problem.color.model(), &problem.color_options);
        let mut lenses = vec![as_fitted(of_color.ok()?.0, &problem.color)];
        if problem.depth_lens == DepthLens::Infrared {
            let infrared = &problem.depth.lens;
            lenses.push(as_fitted(free(infrared, usize::MAX), infrared));
        }
        let mut layout = Layout::new(lenses, None).ended_by(&problem.interrupt);
        let known = problem.time_offset.filter(|_| layout.sensors.len() > 1);
        let offset = known.map(|offset| (layout.len, offset));
        layout.len += usize::from(offset.is_some());
        let mut observations = Vec::new();
        for (frame_set, view) in problem.views.iter().enumerate() {
            let seen = [
                (0, &view.color, problem.color_noise),
                (1, &view.infrared, problem.infrared_noise),
            ];
            for (sensor, corners, noise) in seen {
                if corners.is_empty() || sensor >= layout.sensors.len() {
                    continue;
                }
                observations.push(BoardObservation {
                    sensor,
                    frame_set,
                    points: corners.iter().map(|c| c.point_in_board - center).collect(),
                    pixels: corners.iter().map(|c| c.pixel).collect(),
                    inverse_std: corners.iter().map(|c| 1.0 / (c.std_px * noise)).collect(),
                    used: vec![true; corners.len()],
                });
            }
        }
        let motions = problem.views.iter().map(|view| {
            let lever = view.color_from_board * center;
            view.motion.filter(|_| offset.is_some()).map(|motion| motion.about(&lever))
        });
        let motions = motions.collect();
        Some(Self {
            layout,
            observations,
            motions,
            offset,
            pose_jitter: PoseJitter { rotation: 1e-10, translation: 1e-10 },
            noise: 1.0,
        })
    }

    /// The best state; noise, pose jitter and inliers are estimated again after each fit.
    fn settle(&mut self, start: CornerState) -> Option<CornerState> {
        let mut whole = start;
        for _ in 0..ROUNDS {
            let equations = self.linearized(&whole)?;
            let stepped = |whole: &CornerState, step: &Step| self.stepped(whole, step);
            let linearized = |whole: &CornerState| self.linearized(whole);
            let used = |s: &BoardObservation| s.used.iter().filter(|used| **used).count();
            let count = self.observations.iter().map(|s| 2 * used(s)).sum();
            whole = walk((whole, equations), count, Stop::default(), (linearized, stepped)).0;
            if self.reweight(&whole) {
                break;
            }
        }
        Some(whole)
    }

    /// The covariance of all global parameters, including the scatter between views.
    fn covariance(&self, whole: &CornerState, equations: &NormalEquations) -> Option<DMatrix<f64>> {
        let views: Option<Vec<ReducedView>> =
            self.seen_frame_sets().into_iter().map(|k| self.part(whole, k)).collect();
        Some(FitCovariance::of_views(equations.global_covariance()?, 1.0, &views?).all())
    }

    /// The state with each board at its pose when infrared was taken, by its known motion.
    fn later(&self, whole: &CornerState) -> State {
        let mut later = whole.rig.clone();
        for (pose, motion) in later.rig_from_board.iter_mut().zip(&self.motions) {
            if let Some(motion) = motion {
                *pose = moved(pose, &motion.step(whole.offset_s));
            }
        }
        later
    }

    fn variances(&self, frame_set: usize) -> Vector6<f64> {
        let jitter_s = self.offset.map_or(0.0, |(_, offset)| offset.jitter_s);
        let step = self.motions[frame_set].map_or([0.0; 6], |motion| motion.step(jitter_s));
        self.pose_jitter.covariance(&step)
    }

    fn linearized(&self, whole: &CornerState) -> Option<NormalEquations> {
        let mut equations = self.equations(whole, self.observations.iter())?;
        if let Some((at, before)) = self.offset {
            let off = (whole.offset_s - before.seconds) / before.std_s;
            equations.cost += off * off;
            equations.global_gradient[at] += off / before.std_s;
            equations.global[(at, at)] += before.std_s.powi(-2);
        }
        Some(equations)
    }

    /// The frame sets with a corner that is used.
    fn seen_frame_sets(&self) -> BTreeSet<usize> {
        let used = self.observations.iter().filter(|observation| observation.used.contains(&true));
        used.map(|observation| observation.frame_set).collect()
    }

    /// The equations of one frame set alone, its pose eliminated.
    fn part(&self, whole: &CornerState, frame_set: usize) -> Option<ReducedView> {
        let own = self.observations.iter().filter(|observation| observation.frame_set == frame_set);
        self.equations(whole, own)?.reduced(frame_set)
    }

    /// The normal equations of some observations.
    fn equations<'a>(
        &self,
        whole: &CornerState,
        observations: impl Iterator<Item = &'a BoardObservation>,
    ) -> Option<NormalEquations> {
        if self.layout.interrupt.is_requested() {
            return None;
        }
        let later = self.later(whole);
        let mut equations = NormalEquations::empty(self.layout.len, whole.rig.rig_from_board.len());
        let (mut columns, mut local) = (Columns::default(), LocalEquations::default());
        for observation in observations {
            let state = if observation.sensor == 0 { &whole.rig } else { &later };
            self.linearize_one(state, observation, &mut columns, &mut local)?;
            if observation.sensor == 1 {
                eliminate(&mut local, &self.variances(observation.frame_set))?;
                self.add_offset(&mut equations, state, observation, &local);
            }
            equations.cost += local.cost;
            let chained = ChainedPose::where_posed(&self.layout, state, observation);
            equations.add(&self.layout, observation.sensor, observation.frame_set, chained, &local);
        }
        equations.mirror();
        Some(equations)
    }

    fn linearize_one(
        &self,
        state: &State,
        observation: &BoardObservation,
        columns: &mut Columns,
        local: &mut LocalEquations,
    ) -> Option<()> {
        let mut residuals = vec![[0.0; 2]; observation.points.len()];
        let weighted;
        let observation = match observation.sensor {
            0 => observation,
            _ => {
                let inverse_std =
                    observation.inverse_std.iter().map(|inverse| inverse / self.noise).collect();
                weighted = BoardObservation { inverse_std, ..observation.clone() };
                &weighted
            }
        };
        let at = LinearizationPoint { layout: &self.layout, state };
        let into = LinearizedObservation { residuals: &mut residuals, local };
        linearize_observation(at, observation, Loss::Squares, columns, into).then_some(())
    }

    /// Adds the time offset's part of an infrared image's equations: the offset moves the board
    /// along its motion.
    fn add_offset(
        &self,
        equations: &mut NormalEquations,
        state: &State,
        observation: &BoardObservation,
        local: &LocalEquations,
    ) {
        let (Some((at, _)), Some(motion)) = (self.offset, self.motions[observation.frame_set])
        else {
            return;
        };
        let ChainedPose { pose_at, by_sensor, by_board } =
            ChainedPose::of(&self.layout, state, 1, observation.frame_set);
        let velocity = by_board * Vector6::from_row_slice(&motion.step(1.0));
        let (square, gradient) = pose_part(local);
        let through = square * velocity;
        equations.global_gradient[at] += velocity.dot(&gradient);
        equations.global[(at, at)] += velocity.dot(&through);
        let sensor = &self.layout.sensors[1];
        for k in 0..sensor.lens.free.len() {
            let row = Vector6::from_fn(|a, _| local.product(k, local.columns - 7 + a));
            equations.global[(sensor.lens_at + k, at)] += row.dot(&velocity);
        }
        if let Some(pose_at) = pose_at {
            let by_pose = by_sensor.transpose() * through;
            (0..6).for_each(|a| equations.global[(pose_at + a, at)] += by_pose[a]);
        }
        let by_pose = by_board.transpose() * through;
        let coupling = &mut equations.coupling[observation.frame_set * self.layout.len + at];
        coupling.iter_mut().zip(by_pose.iter()).for_each(|(coupling, by)| *coupling += by);
    }

    fn stepped(&self, whole: &CornerState, step: &Step) -> Option<CornerState> {
        let rig = whole.rig.stepped(&self.layout, &step.global, &step.frame_sets)?;
        let offset_s = whole.offset_s + self.offset.map_or(0.0, |(at, _)| step.global[at]);
        Some(CornerState { rig, offset_s })
    }

    /// Per observation, infrared's board pose against color's. `None` for color's observations,
    /// where color did not see the board, and where the observation cannot be linearized.
    fn differences(&self, whole: &CornerState) -> Vec<Option<PoseDifference>> {
        let later = self.later(whole);
        let (mut columns, mut local) = (Columns::default(), LocalEquations::default());
        let mut by_color: Vec<Option<PoseByColor>> = vec![None; self.motions.len()];
        let mut found = Vec::with_capacity(self.observations.len());
        for observation in &self.observations {
            let state = if observation.sensor == 0 { &whole.rig } else { &later };
            let all = BoardObservation {
                used: vec![true; observation.used.len()],
                ..observation.clone()
            };
            let used = if observation.sensor == 1 && !observation.used.contains(&true) {
                &all
            } else {
                observation
            };
            let linearized = self.linearize_one(state, used, &mut columns, &mut local).is_some();
            let part = linearized.then(|| pose_part(&local));
            if observation.sensor == 0 {
                let ChainedPose { by_board, .. } =
                    ChainedPose::of(&self.layout, &later, 1, observation.frame_set);
                by_color[observation.frame_set] = part.and_then(|(square, gradient)| {
                    let inverse = square.cholesky()?.inverse();
                    Some(PoseByColor {
                        step: -(by_board * (inverse * gradient)),
                        covariance: by_board * inverse * by_board.transpose(),
                    })
                });
                found.push(None);
            } else {
                let both = part.zip(by_color[observation.frame_set]);
                let variances = self.variances(observation.frame_set);
                found.push(both.and_then(|((square, gradient), by_color)| {
                    PoseDifference::of(&square, &gradient, &by_color, variances)
                }));
            }
        }
        found
    }

    fn start_jitter(&mut self, whole: &CornerState) {
        if self.layout.sensors.len() > 1 {
            let differences: Vec<PoseDifference> =
                self.differences(whole).into_iter().flatten().collect();
            self.pose_jitter = PoseJitter::of_middle(&differences);
            let differences = self.differences(whole);
            for (observation, difference) in self.observations.iter_mut().zip(differences) {
                observation.used.fill(
                    difference.is_none_or(|difference| difference.surprise <= VIEW_LIMIT_CHI2),
                );
            }
        }
    }

    /// Estimates noise, pose jitter and inliers again; returns whether they have converged.
    fn reweight(&mut self, whole: &CornerState) -> bool {
        let later = self.later(whole);
        let differences = self.differences(whole);
        let residuals: Vec<Vec<[f64; 2]>> = self
            .observations
            .iter()
            .zip(&differences)
            .map(|(observation, difference)| {
                let mut state =
                    if observation.sensor == 0 { whole.rig.clone() } else { later.clone() };
                if let Some(difference) = difference {
                    let pose_jitter: [f64; 6] = difference.pose_jitter.into();
                    let moved_pose =
                        moved(&state.sensor_from_board(1, observation.frame_set), &pose_jitter);
                    state.rig_from_board[observation.frame_set] =
                        state.sensor_from_rig[1].inverse() * moved_pose;
                }
                state.residuals(&self.layout, observation)
            })
            .collect();
        let together = |difference: &Option<PoseDifference>| {
            difference.is_none_or(|difference| difference.surprise <= VIEW_LIMIT_CHI2)
        };
        let infrared = self.observations.iter().zip(&residuals).zip(&differences);
        let infrared = infrared.filter(|((observation, _), difference)| {
            observation.sensor == 1 && together(difference)
        });
        let noise = median(infrared.map(|((_, residuals), _)| rms(residuals)).collect())
            .unwrap_or(1.0)
            .max(1.0);
        let pose_jitter = self.pose_jitter.next(
            differences
                .iter()
                .flatten()
                .filter(|difference| difference.surprise <= VIEW_LIMIT_CHI2),
        );
        let mut settled =
            (noise / self.noise - 1.0).abs() < 0.02 && pose_jitter.is_near(self.pose_jitter);
        for ((observation, residuals), difference) in
            self.observations.iter_mut().zip(&residuals).zip(&differences)
        {
            let limit = CORNER_LIMIT_STDS * if observation.sensor == 1 { noise } else { 1.0 };
            for (used, [x, y]) in observation.used.iter_mut().zip(residuals) {
                let next = together(difference) && x.hypot(*y) <= limit;
                settled &= next == *used;
                *used = next;
            }
        }
        (self.noise, self.pose_jitter) = (noise, pose_jitter);
        settled || self.layout.sensors.len() == 1
    }

    /// The state with each board at its pose by infrared: by its motion and its pose jitter, or by
    /// infrared alone where that image was taken at another time.
    fn at_depth(&self, whole: &CornerState) -> State {
        let mut later = self.later(whole);
        for (observation, difference) in self.observations.iter().zip(self.differences(whole)) {
            let Some(difference) = difference else { continue };
            let alone = !observation.used.contains(&true);
            let step: [f64; 6] =
                if alone { difference.by_infrared } else { difference.pose_jitter }.into();
            let pose = moved(&later.sensor_from_board(1, observation.frame_set), &step);
            later.rig_from_board[observation.frame_set] = later.sensor_from_rig[1].inverse() * pose;
        }
        later
    }

    /// The frame sets whose infrared image is not used.
    fn separate_in_time(&self) -> Vec<usize> {
        let unused = self
            .observations
            .iter()
            .filter(|observation| observation.sensor == 1 && !observation.used.contains(&true));
        unused.map(|observation| observation.frame_set).collect()
    }
}

/// Root mean square per axis.
fn rms(residuals: &[[f64; 2]]) -> f64 {
    let sum: f64 = residuals.iter().map(|[x, y]| x * x + y * y).sum();
    (sum / (2 * residuals.len().max(1)) as f64).sqrt()
}
