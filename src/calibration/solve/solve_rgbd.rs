//! The solve of a camera with color and depth: from corners and depth images to lenses, the
//! sensors' pose, the depth camera's correction, and how far to trust them.

use crate::calibration::solve::depth_orientation::DepthOrientation;
use crate::calibration::solve::factory_check::FactoryCheck;
use crate::calibration::solve::rgbd_check::check_joint;
pub use crate::calibration::solve::rgbd_error::RgbdError;
pub use crate::calibration::solve::rgbd_guess::ViewWithoutDepth;
use crate::calibration::solve::rgbd_guess::{InitialGuess, JointProblem};
use crate::calibration::solve::rgbd_input::{RgbdInput, check_measured, poses, problem, views};
use crate::calibration::solve::{SolvedCamera, solve_views};
use crate::estimation::camera::CameraOptions;
use crate::estimation::consistent_labels::{FrameSetPose, consistent_labels};
use crate::estimation::error::EstimationError;
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::problem::{BoardView, Correspondence, Shutter};
use crate::estimation::rgbd::halves::{RgbdDifference, RgbdHalves};
use crate::estimation::rgbd::{RgbdEstimate, RgbdFit, RgbdProblem, RgbdView, calibrate_rgbd};
use crate::estimation::rig::FrameSetView;
use crate::geometry::depth_camera::PosedDepthLens;
use crate::geometry::pixel::ImageSize;
use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;

/// A solved camera with color and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedRgbd {
    /// Color by itself, its verdict and views; its lens is the joint estimate's.
    pub color: SolvedCamera,
    /// Infrared by itself, if it saw the board.
    pub infrared: Option<SolvedCamera>,
    /// The joint problem.
    pub problem: RgbdProblem,
    /// The joint estimate.
    pub joint: RgbdEstimate,
    /// The difference between two halves of its views, if there are enough, in the parts that are
    /// reported: color only, if the factory's depth is kept and there are no infrared images.
    pub halves: Option<RgbdDifference>,
    /// The comparison with the factory's depth calibration, if there is one, and views with both.
    pub factory: Option<FactoryCheck>,
    /// The frame set of each view of the joint estimate.
    pub frame_set_of_view: Vec<usize>,
    /// For each view of the joint estimate, its corners in infrared, labeled as in color, at the
    /// stated positions on the board.
    pub stated_infrared: Vec<Vec<Correspondence>>,
    /// Views whose depth could not be used.
    pub without_depth: Vec<ViewWithoutDepth>,
}

impl SolvedRgbd {
    /// The board in the infrared images that were taken together with color, numbered by frame set,
    /// with labels as in color, and at the pose that it had when color was taken.
    pub fn infrared_with_color(&self) -> Vec<FrameSetView> {
        let joint = &self.joint;
        let together = self.problem.views.iter().zip(&self.frame_set_of_view).enumerate().filter(
            |(index, (view, _))| !view.infrared.is_empty() && !joint.not_together.contains(index),
        );
        let as_in_color = |(index, (view, frame_set)): (usize, (&RgbdView, &usize))| {
            let board_from_moved_on = joint.board_from_moved_on(view, index);
            let mut correspondences = self.stated_infrared[index].clone();
            correspondences.iter_mut().for_each(|corner| {
                corner.point_in_board = board_from_moved_on * corner.point_in_board;
            });
            let view = BoardView { name: view.name.clone(), correspondences };
            FrameSetView { frame_set: *frame_set, view }
        };
        together.map(as_in_color).collect()
    }
}

/// The board's surface extends this many squares beyond its outermost corners, and is measured that
/// far.
const MARGIN_SQUARES: f64 = 0.8;

/// Calibrates color, infrared if it saw the board, and depth jointly. Color, with the most accurate
/// corners, measures the board's shape; the other sensors use it.
///
/// # Errors
/// [`RgbdError`]: a sensor that cannot be calibrated by itself, or too few views with depth.
pub fn solve_rgbd(input: &RgbdInput, options: &CameraOptions) -> Result<SolvedRgbd, RgbdError> {
    check_measured(input)?;
    let of_sensor = |sensor| move |source| RgbdError::Sensor { sensor, source };
    // The joint problem takes all rows as read at once, and weights sensors by their residuals.
    // While a board stands still, each depth image is another measurement.
    let options =
        &CameraOptions { shutter: Shutter::Global, copies_count: true, ..options.clone() };
    let color = solve_views(&problem(input, input.color_size, |c| &c.color), options)
        .map_err(of_sensor("color"))?;
    let depth_size = input.frame_sets.iter().find_map(|c| c.depth.as_ref()).map(DepthImage::size);
    let depth_size = depth_size.ok_or(RgbdError::TooLittleDepth {
        usable: 0,
        all: input.frame_sets.len(),
        reasons: String::new(),
    })?;
    let infrared_alone = |input: &RgbdInput| {
        // Given parameters are color's, and the corners already are on the measured board.
        let options = CameraOptions { given: Vec::new(), measured_board: None, ..options.clone() };
        solve_views(&problem(input, depth_size, |c| &c.infrared), &options.as_stated())
            .map_err(of_sensor("infrared"))
    };
    let measured_board = color.sensor.board_shape.as_ref();
    let infrared_seen = views(input).filter(|frame_set| !frame_set.infrared.is_empty()).count();
    let labeled = if !input.depth.with_infrared || infrared_seen < 3 {
        None
    } else if input.board.symmetries().len() > 1 {
        Some(labeled_as_in_color(input, &color, &infrared_alone(input)?))
    } else {
        Some(input.clone())
    };
    let with_infrared = labeled.is_some();
    let labeled = labeled.unwrap_or_else(|| input.clone());
    let placed = measured_board.map(|board| placed_on(&labeled, board));
    let input = placed.as_ref().unwrap_or(&labeled);
    let infrared = with_infrared.then(|| infrared_alone(input)).transpose()?;
    let solved = joint_of(input, depth_size, (&color, infrared.as_ref()), options);
    let (measured, joint) = solved.map_err(|error| {
        of_orientation(error, input, depth_size, (&color, infrared.as_ref()), options)
    })?;
    options.interrupt.check().map_err(RgbdError::Joint)?;
    let JointProblem { problem, frame_set_of_view, without_depth } = measured;
    let halves = RgbdHalves::of(&problem, &joint);
    options.interrupt.check().map_err(RgbdError::Joint)?;
    let factory = input
        .depth
        .factory
        .and_then(|factory| FactoryCheck::of(&problem, &joint, &halves, factory));
    let halves = halves.difference(&problem, &joint, input.color_size);
    let is_kept = factory.as_ref().is_some_and(|factory| factory.kept.is_some());
    let color_alone = is_kept && infrared.is_none();
    let halves = halves.map(|it| if color_alone { it.of_color_alone() } else { it });
    let stated_infrared =
        frame_set_of_view.iter().map(|frame_set| labeled.frame_sets[*frame_set].infrared.clone());
    let stated_infrared = stated_infrared.collect();
    Ok(SolvedRgbd {
        color,
        infrared,
        problem,
        joint,
        halves,
        factory,
        frame_set_of_view,
        stated_infrared,
        without_depth,
    })
}

/// Solves jointly what was calibrated sensor by sensor: `color`, and infrared if it saw the board.
fn joint_of(
    input: &RgbdInput,
    depth_size: ImageSize,
    (color, infrared): (&SolvedCamera, Option<&SolvedCamera>),
    options: &CameraOptions,
) -> Result<(JointProblem, RgbdEstimate), RgbdError> {
    let mut guess = InitialGuess::of(input, depth_size, color, options, infrared);
    let measured = measured_where_depth_sees_it(input, &mut guess, infrared.is_some(), options)?;
    let joint = calibrate_rgbd(&measured.problem).map_err(of_joint)?;
    check_joint(&joint, measured.problem.depth_lens)?;
    Ok((measured, joint))
}

/// `error`; or the orientation of the depth images, if they fit with that undone.
fn of_orientation(
    error: RgbdError,
    input: &RgbdInput,
    depth_size: ImageSize,
    solved: (&SolvedCamera, Option<&SolvedCamera>),
    options: &CameraOptions,
) -> RgbdError {
    let noise = |orientation: DepthOrientation| {
        options.interrupt.check().ok()?;
        let mut upright = input.clone();
        for frame_set in &mut upright.frame_sets {
            frame_set.depth = frame_set.depth.as_ref().and_then(|it| orientation.undone(it));
        }
        let (_, joint) = joint_of(&upright, depth_size, solved, options).ok()?;
        Some((joint.tile_noise, orientation))
    };
    // Planes that fill the image may fit in several orientations, but closely only in the right
    // one: the tiles scatter least there.
    let fitting = DepthOrientation::ALL.into_iter().filter_map(noise);
    let closest = fitting.min_by(|(a, _), (b, _)| a.total_cmp(b));
    closest.map_or(error, |(_, orientation)| RgbdError::Orientation(orientation))
}

/// Measures the board's surface in every depth image. The outline follows from the lens and pose of
/// depth; without infrared these are fitted to the surface found, and it is measured again.
fn measured_where_depth_sees_it(
    input: &RgbdInput,
    guess: &mut InitialGuess,
    with_infrared: bool,
    options: &CameraOptions,
) -> Result<JointProblem, RgbdError> {
    if with_infrared {
        return guess.measured(input, MARGIN_SQUARES);
    }
    let mut measured = guess.measured(input, 0.0)?;
    for _ in 0..2 {
        options.interrupt.check().map_err(RgbdError::Joint)?;
        let PosedDepthLens { lens, depth_from_color } =
            RgbdFit::of(&measured.problem).map_err(of_joint)?.depth();
        (guess.lens, guess.depth_from_color) = (lens, depth_from_color);
        measured = guess.measured(input, MARGIN_SQUARES).map_err(|error| match error {
            RgbdError::TooLittleDepth { .. } => measured.lens_elsewhere(),
            other => other,
        })?;
    }
    Ok(measured)
}

fn of_joint(error: EstimationError) -> RgbdError {
    match error {
        EstimationError::NoFit => RgbdError::NotOneDevice,
        other => RgbdError::Joint(other),
    }
}

/// The same with each corner at its measured position on `board`.
fn placed_on(input: &RgbdInput, board: &MeasuredBoard) -> RgbdInput {
    let mut placed = input.clone();
    for frame_set in &mut placed.frame_sets {
        for corner in frame_set.color.iter_mut().chain(&mut frame_set.infrared) {
            *corner = corner.placed_on(board);
        }
    }
    placed
}

/// The same with infrared's corners labeled as color's, for a board with rotational symmetry.
fn labeled_as_in_color(
    input: &RgbdInput,
    color: &SolvedCamera,
    infrared: &SolvedCamera,
) -> RgbdInput {
    let symmetries = input.board.symmetries();
    let seen = |camera_from_board: Vec<Option<Pose>>| -> Vec<FrameSetPose> {
        let pose = |(frame_set, pose): (usize, Option<Pose>)| {
            Some(FrameSetPose { frame_set, sensor_from_board: pose? })
        };
        camera_from_board.into_iter().enumerate().filter_map(pose).collect()
    };
    let sensors =
        [seen(poses(input, color, |c| &c.color)), seen(poses(input, infrared, |c| &c.infrared))];
    let chosen = consistent_labels(&sensors, &symmetries);
    let mut labeled = input.clone();
    // Frame sets that are no views show the board's motion, but their labels are not made
    // consistent.
    labeled
        .frame_sets
        .iter_mut()
        .filter(|frame_set| !frame_set.is_view)
        .for_each(|frame_set| frame_set.infrared.clear());
    // Color comes first and keeps its labels.
    for (seen, symmetry) in sensors[1].iter().zip(&chosen[1]) {
        let board_from_labels = symmetries[*symmetry].inverse();
        let corners = &mut labeled.frame_sets[seen.frame_set].infrared;
        corners
            .iter_mut()
            .for_each(|corner| corner.point_in_board = board_from_labels * corner.point_in_board);
    }
    labeled
}
