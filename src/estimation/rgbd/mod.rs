//! Color, infrared and depth as one device: lenses, the sensors' relative pose, and the depth
//! camera's systematic error, with their covariance.
//!
//! Corners and planes are not weighted against each other: what planes could add to corners is no
//! larger than a depth camera's unknown systematic error, which would bias the lenses. So corners
//! (color, and infrared where it sees the board) come first and determine lenses, board poses and
//! the sensors' relative pose. Planes then determine the rest: the correction, and for a camera
//! without an infrared image its lens and pose. The covariance of the corners' estimate is
//! propagated to the planes'.
//!
//! Depth is measured by the infrared camera where there is one: they share lens and pose.

mod corner_starts;
mod corners;
mod covariance_with_shape;
pub mod device_prior;
pub mod halves;
pub mod motion;
mod plane_covariance;
pub mod plane_information;
mod planes;
mod pose_jitter;
pub mod problem;

pub use problem::{DepthLens, PlacedDevice, RgbdEstimate, RgbdProblem, RgbdView};

use crate::estimation::depth_error::{Smoothness, TriedCorrection, choose_correction};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::State;
use crate::estimation::rgbd::corner_starts::fit_corners;
use crate::estimation::rgbd::corners::CornerBlocks;
use crate::estimation::rgbd::planes::{Fit, Planes};
use crate::geometry::depth_camera::PosedDepthLens;
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use crate::geometry::pose::Pose;

/// For the correction of scale and offset that is fitted before its form is chosen. Each may change
/// 1/z by half of it (1 sigma) at the middle of the depths seen. That is more than the forms that
/// are compared may, so that a wrong scale is found first. The curvature, which only a grid has, is
/// the first of those that are compared.
pub(crate) const BASE_SMOOTHNESS: Smoothness = Smoothness { amplitude: 0.5, curvature: 0.01 };

/// Color, infrared and depth fitted together, before their covariance is computed.
pub(crate) struct RgbdFit<'a> {
    problem: &'a RgbdProblem,
    corners: CornerBlocks,
    planes: Planes<'a>,
    correction: FittedCorrection,
}

impl<'a> RgbdFit<'a> {
    /// # Errors
    /// [`EstimationError`] where views are too few or do not determine a lens or the sensors' pose,
    /// and [`EstimationError::Interrupted`] once `problem.interrupt` was requested.
    pub(crate) fn of(problem: &'a RgbdProblem) -> Result<Self, EstimationError> {
        let with_depth = problem.views.iter().filter(|view| !view.tiles.is_empty()).count();
        if with_depth < 3 {
            return Err(EstimationError::TooFewViews {
                usable: with_depth,
                needed: 3,
                rejected: String::new(),
            });
        }
        let corners = fit_corners(problem).ok_or_else(|| no_fit(problem))?;
        let mut planes =
            Planes::of(problem, &corners.depth_state, corners.equations.frame_sets.as_slice());
        let correction = fit_correction(problem, &mut planes, &corners.depth_state)?;
        Ok(Self { problem, corners, planes, correction })
    }

    /// The lens of the depth camera, and its pose.
    pub(crate) fn depth(&self) -> PosedDepthLens {
        let state = &self.correction.fit.state;
        PosedDepthLens { lens: state.lenses[1], depth_from_color: state.sensor_from_rig[1] }
    }

    /// The fit with its covariance.
    ///
    /// # Errors
    /// [`EstimationError::NoFit`] where views do not determine a lens or the sensors' pose, and
    /// [`EstimationError::Interrupted`] once `problem.interrupt` was requested.
    pub(crate) fn estimate(self) -> Result<RgbdEstimate, EstimationError> {
        let Self { problem, corners, planes, correction: FittedCorrection { fit, tried } } = self;
        // Where lens and pose depend on the form of the correction, the difference between two
        // forms is part of their uncertainty.
        let other = match problem.depth_lens {
            DepthLens::Infrared => None,
            DepthLens::FromPlanes | DepthLens::Known => fit.other_form().and_then(|form| {
                let by_corners = corners.equations.frame_sets.as_slice();
                let mut planes = Planes::of(problem, &corners.depth_state, by_corners);
                planes.fit(&fit.state, form, fit.smoothness)
            }),
        };
        problem.interrupt.check()?;
        planes.assemble(&corners, &fit, other.as_ref(), tried)
    }
}

/// Calibrates color and depth.
///
/// # Errors
/// [`EstimationError`] where views are too few or do not determine a lens or the sensors' pose, and
/// [`EstimationError::Interrupted`] once `problem.interrupt` was requested.
pub fn calibrate_rgbd(problem: &RgbdProblem) -> Result<RgbdEstimate, EstimationError> {
    RgbdFit::of(problem)?.estimate()
}

/// Why there is no fit: an interrupt was requested, or none was found.
fn no_fit(problem: &RgbdProblem) -> EstimationError {
    problem.interrupt.check().err().unwrap_or(EstimationError::NoFit)
}

/// Fits the depth of `estimate` again, for a device whose color and infrared were solved together
/// with other devices: lenses, poses and boards are those of that solve, and planes determine the
/// correction.
///
/// # Errors
/// [`EstimationError::NoFit`] where no correction fits, [`EstimationError::Interrupted`] once
/// `problem.interrupt` was requested.
pub fn recalibrate_depth(
    problem: &RgbdProblem,
    estimate: &RgbdEstimate,
    placed: &PlacedDevice,
) -> Result<RgbdEstimate, EstimationError> {
    let own = estimate.color_from_board.iter().zip(&placed.color_from_board);
    let color_from_board: Vec<Pose> = own.map(|(own, placed)| placed.unwrap_or(*own)).collect();
    let later = color_from_board.iter().zip(&estimate.board_from_later);
    let state = State {
        lenses: vec![placed.color, placed.depth],
        sensor_from_rig: vec![Pose::identity(), placed.color_from_depth.inverse()],
        rig_from_board: later.map(|(board, later)| *board * *later).collect(),
        warp: [0.0; 2],
    };
    let mut planes = Planes::of(problem, &state, &[]);
    let FittedCorrection { fit, tried } = fit_correction(problem, &mut planes, &state)?;
    Ok(RgbdEstimate { color_from_board, ..planes.refitted(estimate, &fit, tried) })
}

/// The planes' fit with the correction that predicts left-out views best.
struct FittedCorrection {
    fit: Fit,
    /// The corrections that were compared in the last round.
    tried: Vec<TriedCorrection>,
}

fn fit_correction(
    problem: &RgbdProblem,
    planes: &mut Planes<'_>,
    start: &State,
) -> Result<FittedCorrection, EstimationError> {
    let size = problem.depth.image_size;
    let quantity = problem.corrected.first().copied().unwrap_or(CorrectedQuantity::InverseDepth);
    // A constant scale and offset come first, so that a wrong unit affects neither the depth
    // camera's lens nor its pose.
    let terms = if problem.corrected.is_empty() { 0 } else { 2 };
    let base = DepthCorrection::none(quantity, terms, SplineGrid::constant(size), planes.seen_m());
    let rounds = if problem.depth_lens == DepthLens::Infrared { 1 } else { 2 };
    let mut fit = planes.fit(start, base, BASE_SMOOTHNESS).ok_or_else(|| no_fit(problem))?;
    let mut tried = Vec::new();
    for _ in 0..rounds {
        let compared = planes.compared(&fit);
        let choice = choose_correction(&compared, size, &problem.corrected, &problem.interrupt);
        let none = DepthCorrection::none(quantity, 0, SplineGrid::constant(size), planes.seen_m());
        let smoothness = if choice.form.is_some() { choice.smoothness } else { BASE_SMOOTHNESS };
        let form = choice.form.unwrap_or(none);
        fit = planes.fit(&fit.state, form, smoothness).ok_or_else(|| no_fit(problem))?;
        tried = choice.tried;
    }
    Ok(FittedCorrection { fit, tried })
}
