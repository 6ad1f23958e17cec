//! Color, infrared and depth as one instrument: lenses, where the sensors are, and the depth
//! camera's systematic error, with the covariance of what follows from it.
//!
//! Corners and planes are not weighed against each other: a depth camera's unknown systematic error
//! is as large as what its planes could add to corners, and would bend the lenses towards it. So
//! corners (color, and infrared where it sees the board) come first and decide lenses, poses and
//! the sensors' pose; planes then tell what is left: the correction, and for a camera without an
//! infrared picture its lens and pose. The covariance of the corners' answer is carried into the
//! planes'.
//!
//! The depth picture is the infrared camera's where there is one: they share lens and pose.

mod corners;
pub mod motion;
mod planes;
mod pose_jitter;

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::depth_error::{JudgedTile, Smoothness, TriedCorrection, choose_correction};
use crate::estimation::error::EstimationError;
use crate::estimation::joint::FreeLens;
use crate::estimation::problem::Correspondence;
use crate::estimation::rgbd::corners::CornerBlocks;
use crate::estimation::rgbd::motion::{BoardMotion, TimeOffset};
use crate::estimation::rgbd::planes::Planes;
use crate::geometry::depth_camera::{DepthCamera, DepthTile};
use crate::geometry::depth_correction::{CorrectedQuantity, DepthCorrection, SplineGrid};
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// What was seen at one frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdView {
    /// Its path or sequence number.
    pub name: String,
    /// The board's corners in the color picture; empty where it wasn't found.
    pub color: Vec<Correspondence>,
    /// The board's corners in the infrared picture; empty where it wasn't found.
    pub infrared: Vec<Correspondence>,
    /// The board's surface in the depth picture; empty where it wasn't measured.
    pub tiles: Vec<DepthTile>,
    /// The flat surface around the board, which it lies on, in the depth picture.
    pub surround: Vec<DepthTile>,
    /// About where the board was.
    pub color_from_board: Pose,
    /// How fast it moved, where neighboring pictures tell.
    pub motion: Option<BoardMotion>,
}

/// How the depth camera's lens is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthLens {
    /// It is the infrared camera's too, whose corners are seen.
    Infrared,
    /// By planes alone: focal lengths and principal point.
    FromPlanes,
    /// Beforehand.
    Known,
}

/// A camera with color and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdProblem {
    /// About the color camera's lens; all of it is estimated, but for a skew of 0.
    pub color: Lens,
    /// Standard deviation of a color corner relative to its own `std_px`.
    pub color_noise: f64,
    /// About the depth camera; its correction is ignored.
    pub depth: DepthCamera,
    /// How its lens is known.
    pub depth_lens: DepthLens,
    /// Standard deviation of an infrared corner relative to its own `std_px`.
    pub infrared_noise: f64,
    /// About where the sensors are.
    pub depth_from_color: Pose,
    /// About by how much infrared and depth are taken later than color, where that is known at
    /// all.
    pub time_offset: Option<TimeOffset>,
    /// In what a correction makes sense for this device; empty for none.
    pub corrected: Vec<CorrectedQuantity>,
    /// What was seen.
    pub views: Vec<RgbdView>,
}

/// A calibrated camera with color and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdEstimate {
    /// The color camera's lens.
    pub color: Lens,
    /// Covariance of its parameters.
    pub color_covariance: DMatrix<f64>,
    /// The depth camera: its lens, and its correction where one is better on views that were not
    /// fitted to.
    pub depth: DepthCamera,
    /// Covariance of its lens's parameters; zero where they were known.
    pub depth_covariance: DMatrix<f64>,
    /// Where the depth (and infrared) camera is.
    pub color_from_depth: Pose,
    /// Covariance of its turn about color's axes and of its translation, in rad² and m².
    pub color_from_depth_covariance: Matrix6<f64>,
    /// By how much infrared and depth are taken later than color, where the board's motion tells.
    pub time_offset: Option<TimeOffset>,
    /// Views whose infrared and depth pictures are of another moment than their color picture.
    pub not_together: Vec<usize>,
    /// Where the board was, view by view.
    pub color_from_board: Vec<Pose>,
    /// Part of the tiles on the board itself that lie on its plane, as the answer has it.
    pub following: f64,
    /// By how much tiles scatter more than their own readings do.
    pub tile_noise: f64,
    /// View by view, what each tile was and should have been, with its noise; without tiles that
    /// lie off the plane.
    pub judged: Vec<Vec<JudgedTile>>,
    /// How smooth the correction was taken to be.
    pub smoothness: Smoothness,
    /// Corrections that were tried.
    pub tried: Vec<TriedCorrection>,
}

const BASE_SMOOTHNESS: Smoothness = Smoothness { amplitude: 0.5, bend: 0.01 };

/// Calibrates color and depth.
///
/// # Errors
/// [`EstimationError`] where views are too few or leave a lens or the sensors' pose open.
pub fn calibrate_rgbd(problem: &RgbdProblem) -> Result<RgbdEstimate, EstimationError> {
    let with_depth = problem.views.iter().filter(|view| !view.tiles.is_empty()).count();
    if with_depth < 3 {
        return Err(EstimationError::TooFewViews {
            usable: with_depth,
            needed: 3,
            rejected: String::new(),
        });
    }
    let corners = CornerBlocks::fit(problem).ok_or(EstimationError::NoFit)?;
    let mut planes = Planes::of(problem, &corners);
    let size = problem.depth.image_size;
    let quantity = problem.corrected.first().copied().unwrap_or(CorrectedQuantity::InverseDepth);
    // A constant scale and offset first, so that a wrong unit moves neither the depth camera's lens
    // nor its pose.
    let terms = if problem.corrected.is_empty() { 0 } else { 2 };
    let base = DepthCorrection::none(quantity, terms, SplineGrid::constant(size), planes.seen_m());
    let rounds = if problem.depth_lens == DepthLens::Infrared { 1 } else { 2 };
    let mut fit =
        planes.fit(&corners.depth_state, base, BASE_SMOOTHNESS).ok_or(EstimationError::NoFit)?;
    let (mut smoothness, mut tried) = (BASE_SMOOTHNESS, Vec::new());
    for _ in 0..rounds {
        let (chosen, all) = choose_correction(&planes.judged(&fit), size, &problem.corrected);
        let none = DepthCorrection::none(quantity, 0, SplineGrid::constant(size), planes.seen_m());
        let (correction, smooth) = chosen.unwrap_or((none, BASE_SMOOTHNESS));
        fit = planes.fit(&fit.state, correction, smooth).ok_or(EstimationError::NoFit)?;
        (smoothness, tried) = (smooth, all);
    }
    // Where the form of the correction decides, and not the views, the difference is part of what
    // is not known.
    let other = match problem.depth_lens {
        DepthLens::Infrared => None,
        DepthLens::FromPlanes | DepthLens::Known => fit
            .other_form()
            .and_then(|form| Planes::of(problem, &corners).fit(&fit.state, form, smoothness)),
    };
    planes.assemble(&corners, (&fit, other.as_ref()), (smoothness, tried))
}

/// All parameters of a lens but the skew, up to number `end`.
fn free(lens: &Lens, end: usize) -> FreeLens {
    let free = (0..lens.parameters().len().min(end)).filter(|k| *k != 4).collect();
    FreeLens { model: lens.model(), free, square_pixels: false }
}

/// The pose of a board whose points are counted from `center`.
fn shifted(camera_from_board: &Pose, center: &Vector3<f64>) -> Pose {
    Pose::new(
        camera_from_board.rotation(),
        camera_from_board.translation() + *camera_from_board * *center,
    )
}
