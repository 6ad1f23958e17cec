//! The observations of a camera with color and depth, before calibration.

use crate::calibration::solve::SolvedCamera;
use crate::calibration::solve::rgbd_error::RgbdError;
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence};
use crate::geometry::depth_camera::{DepthReading, PosedDepthLens};
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;

/// What is known of a depth camera before calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthSensor {
    /// The meaning of its numbers; `None` for disparity of unknown meaning, which is then estimated
    /// from the board.
    pub reading: Option<DepthReading>,
    /// The value that means no reading, besides 0 for metric depth.
    pub invalid: Option<u16>,
    /// What the device states of its lens and pose.
    pub factory: Option<PosedDepthLens>,
    /// Whether the infrared image has the geometry of the depth image: same size, same lens.
    /// Default for every device that has one.
    pub with_infrared: bool,
}

/// The observations in one frame set.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdFrameSet {
    /// Its path or sequence number.
    pub name: String,
    /// When the color image was taken, in seconds from an arbitrary origin; `None` if times are not
    /// meaningful.
    pub time_s: Option<f64>,
    /// Whether it is a view. The others determine the board's motion, and the time between the
    /// sensors' exposures.
    pub is_view: bool,
    /// The board in the color image; empty where it wasn't found.
    pub color: Vec<Correspondence>,
    /// The board in the infrared image; empty where it wasn't found.
    pub infrared: Vec<Correspondence>,
    /// The depth image, where there is one.
    pub depth: Option<DepthImage>,
}

/// A camera with color and depth to calibrate.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdInput {
    /// The board.
    pub board: Target,
    /// The size of the color images.
    pub color_size: ImageSize,
    /// What is known of the depth camera.
    pub depth: DepthSensor,
    /// What was seen.
    pub frame_sets: Vec<RgbdFrameSet>,
}

impl DepthSensor {
    /// Whether `reading` means that nothing was measured.
    fn is_none(&self, reading: u16) -> bool {
        let is_metric = matches!(self.reading, Some(DepthReading::Metric { .. }));
        self.invalid == Some(reading) || (is_metric && reading == 0)
    }
}

/// # Errors
/// [`RgbdError::NothingMeasured`] where no depth image has a reading.
pub(super) fn check_measured(input: &RgbdInput) -> Result<(), RgbdError> {
    let images = || views(input).filter_map(|frame_set| frame_set.depth.as_ref());
    let nothing = |image: &DepthImage| image.only_reading().filter(|r| input.depth.is_none(*r));
    match images().next().and_then(nothing) {
        Some(reading) if images().all(|image| nothing(image).is_some()) => {
            Err(RgbdError::NothingMeasured { images: images().count(), reading })
        }
        _ => Ok(()),
    }
}

/// The frame sets that are views.
pub(super) fn views(input: &RgbdInput) -> impl Iterator<Item = &RgbdFrameSet> {
    input.frame_sets.iter().filter(|frame_set| frame_set.is_view)
}

/// The problem of one sensor by itself, whose corners `seen` returns.
pub(super) fn problem(
    input: &RgbdInput,
    image_size: ImageSize,
    seen: impl Fn(&RgbdFrameSet) -> &Vec<Correspondence>,
) -> CameraProblem {
    let with_board = views(input).filter(|frame_set| !seen(frame_set).is_empty());
    let views = with_board
        .map(|c| BoardView { name: c.name.clone(), correspondences: seen(c).clone() })
        .collect();
    CameraProblem { image_size, views }
}

/// For each frame set, the pose from a sensor's solve, if that used it.
pub(super) fn poses(
    input: &RgbdInput,
    solved: &SolvedCamera,
    seen: impl Fn(&RgbdFrameSet) -> &Vec<Correspondence>,
) -> Vec<Option<Pose>> {
    let mut views = solved.estimate.views.iter();
    let of_capture = |frame_set: &RgbdFrameSet| {
        if seen(frame_set).is_empty() || !frame_set.is_view {
            return None;
        }
        let view = views.next()?;
        view.camera_from_board.filter(|_| view.fault.is_none())
    };
    input.frame_sets.iter().map(of_capture).collect()
}
