//! What is given to an estimate: points of the board and the pixels they were seen at, view by
//! view.

use nalgebra::Point3;

use crate::geometry::lens::LensModel;
use crate::geometry::pixel::{ImageSize, Pixel};

/// A point of the board and where it was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// In meters.
    pub point_in_board: Point3<f64>,
    /// Where it was seen.
    pub pixel: Pixel,
    /// Standard deviation of `pixel` per axis, in pixels; weights are relative, the noise level
    /// itself is estimated.
    pub std_px: f64,
}

/// One picture of the board.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// What the view is called in errors and results: a path or a sequence number.
    pub name: String,
    /// What was seen.
    pub correspondences: Vec<Correspondence>,
}

/// Which lens model to fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensChoice {
    /// This one.
    Model(LensModel),
    /// The one with the smallest held-out error, fewer parameters preferred.
    Auto,
}

/// A camera to calibrate.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraProblem {
    /// The size of its images.
    pub image_size: ImageSize,
    /// What was seen.
    pub views: Vec<BoardView>,
}
