//! Color and depth of one camera: what was seen, and what came of it.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::depth_error::{JudgedTile, Smoothness, TriedCorrection};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::joint::{FreeLens, moved};
use crate::estimation::problem::{CameraOptions, Correspondence};
use crate::estimation::rgbd::motion::{BoardMotion, TimeOffset};
use crate::geometry::depth_camera::{DepthCamera, DepthTile};
use crate::geometry::depth_correction::CorrectedQuantity;
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// What was seen at one frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdView {
    /// Its path or sequence number.
    pub name: String,
    /// The board's corners in the color image; empty where it wasn't found.
    pub color: Vec<Correspondence>,
    /// The board's corners in the infrared image; empty where it wasn't found.
    pub infrared: Vec<Correspondence>,
    /// The board's surface in the depth image; empty where it wasn't measured.
    pub tiles: Vec<DepthTile>,
    /// The flat surface around the board, which it lies on, in the depth image.
    pub surround: Vec<DepthTile>,
    /// About where the board was.
    pub color_from_board: Pose,
    /// Its velocity, where neighboring images determine it.
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
    /// About the color camera's lens.
    pub color: Lens,
    /// What is estimated of it: `skew`, `square_pixels` and `given` count.
    pub color_options: CameraOptions,
    /// Covariance of its parameters by a solve of color alone that measured the board's shape,
    /// which it counts; `None` for a board as stated: by the corners' scatter and by how views
    /// differ.
    pub color_covariance: Option<DMatrix<f64>>,
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
    /// Ends the estimate early.
    pub interrupt: Interrupt,
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
    /// Covariance of its rotation about color's axes and of its translation, in rad² and m².
    pub color_from_depth_covariance: Matrix6<f64>,
    /// By how much infrared and depth are taken later than color, where the board's motion
    /// determines it.
    pub time_offset: Option<TimeOffset>,
    /// Views whose infrared and depth images are of another moment than their color image.
    pub not_together: Vec<usize>,
    /// Where the board was, view by view.
    pub color_from_board: Vec<Pose>,
    /// Where it had moved to, in its own frame, when depth was taken: by its motion and its jitter,
    /// view by view.
    pub board_from_later: Vec<Pose>,
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

impl RgbdEstimate {
    /// Where the board of a view had moved to, in its own frame, when infrared was taken, as far as
    /// its motion says; where it was, for a board whose motion is not known.
    pub fn board_from_moved_on(&self, view: &RgbdView, index: usize) -> Pose {
        let (Some(offset), Some(motion)) = (self.time_offset, view.motion) else {
            return Pose::identity();
        };
        let color_from_board = &self.color_from_board[index];
        let moved_on = moved(color_from_board, &motion.step(offset.seconds));
        color_from_board.inverse() * moved_on
    }
}

/// A device whose color and infrared were solved with others': what its depth is fitted to anew.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedDevice {
    /// The color camera's lens.
    pub color: Lens,
    /// The lens of the infrared camera, which is depth's.
    pub depth: Lens,
    /// Where that camera is.
    pub color_from_depth: Pose,
    /// Where the board was, by view of the device's own problem; `None` where the joint solve has
    /// none.
    pub color_from_board: Vec<Option<Pose>>,
}

/// All parameters of a lens but the skew, up to number `end`.
pub(super) fn free(lens: &Lens, end: usize) -> FreeLens {
    let free = (0..lens.parameters().len().min(end)).filter(|k| *k != Lens::SKEW).collect();
    FreeLens { model: lens.model(), free, square_pixels: false }
}

/// The pose of a board whose points are counted from `center`.
pub(super) fn with_origin_at(camera_from_board: &Pose, center: &Vector3<f64>) -> Pose {
    Pose::new(
        camera_from_board.rotation(),
        camera_from_board.translation() + *camera_from_board * *center,
    )
}
