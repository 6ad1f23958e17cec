//! Several sensors that are fixed to each other, from views of one board: lenses, sensor poses, and
//! the board's pose at each frame set, in one joint problem. A sensor need not observe every frame
//! set.

use nalgebra::{DMatrix, Matrix6};

use crate::estimation::camera_estimate::{CameraEstimate, Part, assemble};
use crate::estimation::camera_fit::{CameraFit, fit_camera};
use crate::estimation::clustered_covariance::{Clustered, FitCovariance};
use crate::estimation::consistent_labels::FrameSetPose;
use crate::estimation::error::EstimationError;
use crate::estimation::joint::{BoardObservation, Layout, State};
use crate::estimation::lens_choice::choose_lens;
use crate::estimation::lens_choice::other_minimum::closer_of_two_minima;
use crate::estimation::problem::{BoardView, CameraOptions, CameraProblem, LensChoice, check};
use crate::estimation::robust_fit::robust_fit;
use crate::estimation::shape_widening::widening;
use crate::estimation::split_halves::{
    LensDifference, LensWithCovariance, PoseBetweenHalves, SplitHalves,
};
use crate::estimation::start::{Prepared, mean_point};
use crate::estimation::view_fault::ViewFault;
use crate::estimation::view_order::{ViewOrder, mean_pixel};
use crate::geometry::median::median_pose;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;

/// A rig to calibrate.
#[derive(Debug, Clone, PartialEq)]
pub struct RigProblem {
    /// Its sensors; the first is the rig's own frame.
    pub sensors: Vec<RigSensor>,
    /// Number of frame sets.
    pub frame_sets: usize,
}

/// One sensor of a rig and its observations.
#[derive(Debug, Clone, PartialEq)]
pub struct RigSensor {
    /// Its name, in errors.
    pub name: String,
    /// The size of its images.
    pub image_size: ImageSize,
    /// Its observations.
    pub views: Vec<FrameSetView>,
    /// Which parameters of its lens to estimate.
    pub options: CameraOptions,
    /// Covariance of its lens from its own solve that also estimated the board's shape, including
    /// the uncertainty of the shape, where `options.measured_board` comes from that solve; `None`
    /// for a board of known shape.
    pub lens_covariance_with_shape: Option<DMatrix<f64>>,
}

/// A sensor's view of the board in one frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameSetView {
    /// The frame set, counted from 0: sensors' views of one frame set were taken together.
    pub frame_set: usize,
    /// The corners that the sensor observed in it.
    pub view: BoardView,
}

/// A calibrated rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigEstimate {
    /// Each sensor's lens and views, as for a single camera.
    pub cameras: Vec<CameraEstimate>,
    /// The pose of each sensor; the first is the identity.
    pub sensor_poses: Vec<SensorPose>,
    /// By sensor, the comparison of two halves of the frame sets; empty with fewer than six frame
    /// sets.
    pub halves: Vec<SensorHalves>,
}

/// The differences of two halves of a rig's frame sets, fitted separately, in one sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorHalves {
    /// In its lens.
    pub lens: LensDifference,
    /// In its pose; `None` for the first sensor, which is the rig's own frame.
    pub pose: Option<PoseBetweenHalves>,
    /// Root mean square error of each half's views under the lenses and sensor poses of the other
    /// half, in pixels.
    pub held_out_rms_px: Option<f64>,
}

/// The pose of a sensor on the rig.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorPose {
    /// The pose.
    pub sensor_from_rig: Pose,
    /// Its covariance, as a rotation about the sensor's axes (radians) and a translation (meters);
    /// zero for the first sensor.
    pub covariance: Matrix6<f64>,
    /// The variance inflation in it for scatter between views beyond that of their corners' noise,
    /// as [`CameraEstimate::variance_inflation`]; the uncertainty of the board's shape is not
    /// included.
    pub variance_inflation: f64,
}

/// Calibrates a rig: each sensor by itself for a start, then all jointly, with each sensor weighted
/// by its own noise. The same in any order of the frame sets.
///
/// # Errors
/// As [`crate::estimation::camera::calibrate_camera`] for each sensor; a sensor that shares no
/// frame set with the others, or is inconsistent with them in all.
pub fn calibrate_rig(problem: &RigProblem) -> Result<RigEstimate, EstimationError> {
    let order = FrameSetOrder::of(problem);
    Ok(order.as_given(solve(&order.problem(problem))?))
}

fn solve(problem: &RigProblem) -> Result<RigEstimate, EstimationError> {
    let cameras: Vec<CameraProblem> =
        problem.sensors.iter().map(RigSensor::to_camera_problem).collect();
    cameras.iter().try_for_each(check)?;
    let center = mean_point(&cameras);
    let (mut alone, mut other_minima) = (Vec::new(), Vec::new());
    for (sensor, camera) in problem.sensors.iter().zip(&cameras) {
        let mut prepared = Prepared::about(camera, center);
        if let Some(board) = &sensor.options.measured_board {
            prepared.place_on(board)?;
        }
        let (fit, other) = match sensor.options.lens {
            LensChoice::Model(model) => {
                let fit = fit_camera(&mut prepared, model, &sensor.options)?;
                closer_of_two_minima(fit, &prepared)
            }
            LensChoice::Auto => (choose_lens(&mut prepared, &sensor.options)?.fit.plain, None),
        };
        alone.push((prepared, fit));
        other_minima.push(other);
    }
    let fit = fit_jointly(problem, &alone)?;
    agree(problem, &fit)?;
    let known = FitCovariance::of(&fit).ok_or(EstimationError::NoFit)?;
    let by_shape = shape_widening_of(problem, &alone);
    let (mut estimates, mut sensor_poses, mut first_observation) = (Vec::new(), Vec::new(), 0);
    for (sensor, camera) in cameras.iter().enumerate() {
        let (prepared, own) = &alone[sensor];
        let part = Part { sensor, first_observation, noise: own_noise(own) };
        let estimate = assemble(camera, prepared, &fit, Some(&known), part)?;
        estimates.push(CameraEstimate {
            lens_covariance: &estimate.lens_covariance * by_shape,
            other_minimum: other_minima[sensor],
            ..estimate
        });
        let (covariance, variance_inflation) = match fit.layout.sensors[sensor].pose_at {
            Some(at) => {
                let Clustered { covariance, factor, .. } = known.block_as_seen(at..at + 6);
                (covariance.fixed_view::<6, 6>(0, 0).into_owned(), factor)
            }
            None => (Matrix6::zeros(), 1.0),
        };
        let sensor_from_rig = fit.robust.minimum.state.sensor_from_rig[sensor];
        let covariance = covariance * by_shape;
        sensor_poses.push(SensorPose { sensor_from_rig, covariance, variance_inflation });
        first_observation += camera.views.len();
    }
    let halves = compare_halves(&fit, &estimates, &sensor_poses);
    Ok(RigEstimate { cameras: estimates, sensor_poses, halves })
}

/// Checks that every sensor has a view that is consistent with the others. Without one, its lens
/// and pose are not determined, and the joint problem has no solution. The first sensor, relative
/// to which the others are placed, is named last.
fn agree(problem: &RigProblem, fit: &CameraFit) -> Result<(), EstimationError> {
    let has_view = |sensor: usize| {
        let mut own = fit.observations.iter().zip(&fit.faults);
        own.any(|(observation, fault)| observation.sensor == sensor && fault.is_none())
    };
    match (0..problem.sensors.len()).rev().find(|sensor| !has_view(*sensor)) {
        Some(sensor) => {
            Err(EstimationError::NothingAgrees { sensor: problem.sensors[sensor].name.clone() })
        }
        None => Ok(()),
    }
}

/// Empty for exact corners, whose halves agree to rounding.
fn compare_halves(
    fit: &CameraFit,
    cameras: &[CameraEstimate],
    sensor_poses: &[SensorPose],
) -> Vec<SensorHalves> {
    let Some(halves) = SplitHalves::of(fit).filter(|_| !fit.is_exact()) else { return Vec::new() };
    let of_sensor = |(sensor, (camera, pose)): (usize, (&CameraEstimate, &SensorPose))| {
        let stated = LensWithCovariance { lens: &camera.lens, covariance: &camera.lens_covariance };
        let covariance = DMatrix::from_column_slice(6, 6, pose.covariance.as_slice());
        SensorHalves {
            lens: halves.lens_difference(sensor, stated, camera.image_size),
            pose: halves.pose_difference(sensor, &covariance),
            held_out_rms_px: halves.held_out_rms_px(sensor),
        }
    };
    cameras.iter().zip(sensor_poses).enumerate().map(of_sensor).collect()
}

/// The factor on variances for the uncertainty of the board's shape. Each sensor that measured the
/// shape gives a factor for itself; the mean of their excesses over 1 is divided by the number of
/// these sensors, since together they know the shape that much better.
fn shape_widening_of(problem: &RigProblem, alone: &[(Prepared, CameraFit)]) -> f64 {
    let of_sensor = |(sensor, (_, fit)): (&RigSensor, &(Prepared, CameraFit))| {
        let with_shape = sensor.lens_covariance_with_shape.as_ref()?;
        let known = FitCovariance::of(fit)?;
        let layout = &fit.layout.sensors[0];
        let (at, count) = (layout.lens_at, layout.lens.free.len());
        let known_shape = known.block(at..at + count).covariance;
        Some(widening(&layout.lens.reduced(with_shape), &known_shape) - 1.0)
    };
    let excess: Vec<f64> = problem.sensors.iter().zip(alone).filter_map(of_sensor).collect();
    let count = excess.len().max(1) as f64;
    1.0 + excess.iter().sum::<f64>() / (count * count)
}

/// The frame sets of a rig, ordered by the mean pixel of the view of the first sensor in each.
struct FrameSetOrder {
    /// The position of each frame set in this order.
    positions: Vec<usize>,
    /// The order of each sensor's views.
    sensors: Vec<ViewOrder>,
}

impl FrameSetOrder {
    fn of(problem: &RigProblem) -> Self {
        let views = || problem.sensors.iter().rev().flat_map(|sensor| &sensor.views);
        let seen = views().map(|seen| seen.frame_set + 1).max().unwrap_or(0);
        let mut pixels = vec![[f64::INFINITY; 2]; problem.frame_sets.max(seen)];
        for seen in views() {
            pixels[seen.frame_set] = mean_pixel(&seen.view);
        }
        let positions = ViewOrder::by(pixels.len(), |set| pixels[set]).positions();
        let of_sensor = |sensor: &RigSensor| {
            let position = |view: usize| positions[sensor.views[view].frame_set];
            ViewOrder::by_position(sensor.views.len(), position)
        };
        let sensors = problem.sensors.iter().map(of_sensor).collect();
        Self { positions, sensors }
    }

    /// The problem with its frame sets, and each sensor's views, in this order.
    fn problem(&self, problem: &RigProblem) -> RigProblem {
        let of_sensor = |(sensor, order): (&RigSensor, &ViewOrder)| {
            let mut views = order.ordered(&sensor.views);
            for seen in &mut views {
                seen.frame_set = self.positions[seen.frame_set];
            }
            RigSensor { views, options: order.options(&sensor.options), ..sensor.clone() }
        };
        let sensors = problem.sensors.iter().zip(&self.sensors).map(of_sensor).collect();
        RigProblem { sensors, frame_sets: problem.frame_sets }
    }

    /// An estimate of the problem in this order, with each sensor's views in the order given.
    fn as_given(&self, estimate: RigEstimate) -> RigEstimate {
        let cameras = estimate.cameras.into_iter().zip(&self.sensors);
        let cameras = cameras.map(|(camera, order)| order.as_given(camera)).collect();
        RigEstimate { cameras, ..estimate }
    }
}

impl RigSensor {
    fn to_camera_problem(&self) -> CameraProblem {
        CameraProblem {
            image_size: self.image_size,
            views: self.views.iter().map(|seen| seen.view.clone()).collect(),
        }
    }

    /// The board's poses in the good views of `fit`.
    fn placed<'a>(&'a self, fit: &'a CameraFit) -> impl Iterator<Item = FrameSetPose> + 'a {
        let state = &fit.robust.minimum.state;
        let views = self.views.iter().enumerate().filter(|(view, _)| fit.faults[*view].is_none());
        // A sensor by itself is its own rig.
        views.map(|(view, seen)| FrameSetPose {
            frame_set: seen.frame_set,
            sensor_from_board: state.rig_from_board[view],
        })
    }
}

/// The noise of a sensor by itself; at least a small part of the standard deviations, well above
/// rounding, for exact corners.
fn own_noise(fit: &CameraFit) -> f64 {
    fit.noise_square().sqrt().max(1e-6)
}

fn fit_jointly(
    problem: &RigProblem,
    alone: &[(Prepared, CameraFit)],
) -> Result<CameraFit, EstimationError> {
    let (sensor_from_rig, rig_from_board) = place_sensors(problem, alone)?;
    // Includes frame sets whose every view was rejected, where a single sensor locates the board.
    let mut located = rig_from_board.clone();
    let (mut observations, mut faults) = (Vec::new(), Vec::new());
    for (index, (sensor, (_, fit))) in problem.sensors.iter().zip(alone).enumerate() {
        let noise = own_noise(fit);
        for (view, FrameSetView { frame_set, .. }) in sensor.views.iter().enumerate() {
            let mut observation = BoardObservation {
                sensor: index,
                frame_set: *frame_set,
                ..fit.observations[view].clone()
            };
            observation.inverse_std.iter_mut().for_each(|inverse| *inverse /= noise);
            observations.push(observation);
            let own = fit.robust.minimum.state.rig_from_board[view];
            let residuals = &fit.robust.minimum.equations.residuals[view];
            if residuals.iter().any(|residual| residual[0].is_finite()) {
                located[*frame_set].get_or_insert_with(|| sensor_from_rig[index].inverse() * own);
            }
            let expected = rig_from_board
                .get(*frame_set)
                .copied()
                .flatten()
                .map(|pose| sensor_from_rig[index] * pose);
            let rotated = expected.is_some_and(|expected| expected.angle_to(&own) > HALF_TURN);
            faults.push(fit.faults[view].or(rotated.then_some(ViewFault::HalfTurn)));
        }
    }
    let state = State {
        lenses: alone.iter().map(|(_, fit)| *fit.lens()).collect(),
        sensor_from_rig,
        rig_from_board: located.iter().map(|pose| pose.unwrap_or(Pose::identity())).collect(),
        warp: [0.0; 2],
    };
    let lenses = alone.iter().map(|(_, fit)| fit.layout.sensors[0].lens.clone()).collect();
    let layout = Layout::new(lenses, None).ended_by(&alone[0].1.layout.interrupt);
    let mut robust =
        robust_fit(&layout, state, &mut observations, &mut faults).ok_or(EstimationError::NoFit)?;
    let residuals = &mut robust.minimum.equations.residuals;
    for (residuals, observation) in residuals.iter_mut().zip(&observations) {
        if located[observation.frame_set].is_none() {
            // The board's pose is not known.
            residuals.fill([f64::INFINITY; 2]);
        }
    }
    Ok(CameraFit::new(layout, robust, observations, faults))
}

/// A board whose rotation differs by more than this, in radians, from that by the other sensors was
/// labeled from its other end.
const HALF_TURN: f64 = 2.4;

type Places = (Vec<Pose>, Vec<Option<Pose>>);

/// `sensor_from_rig` of each sensor and `rig_from_board` of each frame set, from the poses that
/// each sensor found by itself. Each sensor is joined to those already placed by the median
/// relative pose over shared frame sets.
fn place_sensors(
    problem: &RigProblem,
    alone: &[(Prepared, CameraFit)],
) -> Result<Places, EstimationError> {
    let mut rig_from_board: Vec<Option<Pose>> = vec![None; problem.frame_sets];
    let mut sensor_from_rig: Vec<Option<Pose>> = vec![None; problem.sensors.len()];
    let frame_set_out_of_range = problem
        .sensors
        .iter()
        .flat_map(|s| &s.views)
        .any(|seen| seen.frame_set >= problem.frame_sets);
    if frame_set_out_of_range || problem.sensors.is_empty() {
        return Err(EstimationError::NoFit);
    }
    for _ in 0..problem.sensors.len() {
        let next = (0..problem.sensors.len()).filter(|k| sensor_from_rig[*k].is_none()).find_map(
            |sensor| {
                let placed = problem.sensors[sensor].placed(&alone[sensor].1);
                let shared = placed.filter_map(|own| {
                    Some(own.sensor_from_board * rig_from_board[own.frame_set]?.inverse())
                });
                let first = sensor == 0;
                let sensor_from_rig: Vec<Pose> =
                    if first { vec![Pose::identity()] } else { shared.collect() };
                Some((sensor, median_pose(&sensor_from_rig)?))
            },
        );
        let Some((sensor, sensor_from)) = next else {
            let isolated = sensor_from_rig.iter().position(Option::is_none).unwrap_or(0);
            return Err(EstimationError::NothingShared {
                sensor: problem.sensors[isolated].name.clone(),
            });
        };
        sensor_from_rig[sensor] = Some(sensor_from);
        for own in problem.sensors[sensor].placed(&alone[sensor].1) {
            rig_from_board[own.frame_set]
                .get_or_insert(sensor_from.inverse() * own.sensor_from_board);
        }
    }
    Ok((sensor_from_rig.into_iter().flatten().collect(), rig_from_board))
}
