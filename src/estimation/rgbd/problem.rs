//! Color and depth of one camera: the observations, and the estimate.

use nalgebra::{DMatrix, Matrix6, Vector3};

use crate::estimation::depth_error::{ComparedTile, Smoothness, TriedCorrection};
use crate::estimation::interrupt::Interrupt;
use crate::estimation::joint::{FreeLens, moved};
use crate::estimation::problem::{CameraOptions, Correspondence};
use crate::estimation::rgbd::motion::{BoardMotion, TimeOffset};
use crate::geometry::depth_camera::{DepthCamera, DepthTile};
use crate::geometry::depth_correction::CorrectedQuantity;
use crate::geometry::lens::Lens;
use crate::geometry::pose::Pose;

/// The observations of one frame set.
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
    /// The board's approximate pose.
    pub color_from_board: Pose,
    /// Its velocity, where neighboring images determine it.
    pub motion: Option<BoardMotion>,
}

/// How the depth camera's lens is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthLens {
    /// It is also that of the infrared camera, and is estimated from its corners.
    Infrared,
    /// Estimated from planes alone: focal lengths and principal point.
    FromPlanes,
    /// Known in advance.
    Known,
}

/// A camera with color and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdProblem {
    /// The color camera's lens, approximately.
    pub color: Lens,
    /// Which of its parameters are estimated: only `skew`, `square_pixels` and `given` are used.
    pub color_options: CameraOptions,
    /// Covariance of its parameters from a solve of color alone that also estimated the board's
    /// shape, including the uncertainty of the shape. `None` for a board as stated: the covariance
    /// then comes from the corners' scatter and the scatter between views.
    pub color_covariance: Option<DMatrix<f64>>,
    /// Standard deviation of a color corner relative to its own `std_px`.
    pub color_noise: f64,
    /// The depth camera, approximately; its correction is ignored.
    pub depth: DepthCamera,
    /// How its lens is known.
    pub depth_lens: DepthLens,
    /// Standard deviation of an infrared corner relative to its own `std_px`.
    pub infrared_noise: f64,
    /// The approximate pose of color in depth's frame.
    pub depth_from_color: Pose,
    /// By how much infrared and depth are taken later than color, approximately, where that is
    /// known at all.
    pub time_offset: Option<TimeOffset>,
    /// The quantities whose correction makes sense for this device; empty for no correction.
    pub corrected: Vec<CorrectedQuantity>,
    /// The views.
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
    /// The depth camera: its lens, and its correction where one predicts left-out views better than
    /// none.
    pub depth: DepthCamera,
    /// Covariance of its lens's parameters; zero where they were known.
    pub depth_covariance: DMatrix<f64>,
    /// The pose of the depth (and infrared) camera in color's frame.
    pub color_from_depth: Pose,
    /// Covariance of its rotation about color's axes and of its translation, in rad² and m².
    pub color_from_depth_covariance: Matrix6<f64>,
    /// By how much infrared and depth are taken later than color, where the board's motion
    /// determines it.
    pub time_offset: Option<TimeOffset>,
    /// Views whose infrared and depth images were not taken together with their color image.
    pub not_together: Vec<usize>,
    /// The board's pose in each view.
    pub color_from_board: Vec<Pose>,
    /// Its pose when depth was taken, in its own earlier frame, by its motion and its jitter, in
    /// each view.
    pub board_from_later: Vec<Pose>,
    /// The part of the tiles on the board itself that lie on its estimated plane.
    pub following: f64,
    /// By how much tiles scatter more than their own readings.
    pub tile_noise: f64,
    /// Per view, the measured and the expected value of each inlier tile, with its noise.
    pub compared: Vec<Vec<ComparedTile>>,
    /// The smoothness prior of the correction.
    pub smoothness: Smoothness,
    /// Corrections that were tried.
    pub tried: Vec<TriedCorrection>,
}

impl RgbdEstimate {
    /// The pose of a view's board when infrared was taken, in its own earlier frame, according to
    /// its motion; the identity for a board whose motion is not known.
    pub fn board_from_moved_on(&self, view: &RgbdView, index: usize) -> Pose {
        let (Some(offset), Some(motion)) = (self.time_offset, view.motion) else {
            return Pose::identity();
        };
        let color_from_board = &self.color_from_board[index];
        let moved_on = moved(color_from_board, &motion.step(offset.seconds));
        color_from_board.inverse() * moved_on
    }
}

/// A device whose color and infrared were solved together with other devices: its depth is fitted
/// again to that result.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedDevice {
    /// The color camera's lens.
    pub color: Lens,
    /// The lens of the infrared camera, which depth shares.
    pub depth: Lens,
    /// The pose of that camera in color's frame.
    pub color_from_depth: Pose,
    /// The board's pose, by view of the device's own problem; `None` where the joint solve has
    /// none.
    pub color_from_board: Vec<Option<Pose>>,
}

/// All parameters of a lens with an index below `end`, except the skew.
pub(super) fn free(lens: &Lens, end: usize) -> FreeLens {
    let free = (0..lens.parameters().len().min(end)).filter(|k| *k != Lens::SKEW).collect();
    FreeLens { model: lens.model(), free, square_pixels: false }
}

/// The pose of a board whose origin is moved to `center`.
pub(super) fn with_origin_at(camera_from_board: &Pose, center: &Vector3<f64>) -> Pose {
    Pose::new(
        camera_from_board.rotation(),
        camera_from_board.translation() + *camera_from_board * *center,
    )
}
