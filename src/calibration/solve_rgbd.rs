//! The solve of a camera with colour and depth: from corners and depth pictures to lenses, the sensors' pose, the depth
//! camera's correction, and how far to trust them.

use nalgebra::{Matrix6, Point3, Vector3};

use crate::calibration::solve::{SolvedCamera, solve_views};
use crate::detection::board_plane::{NoPlane, PlaneOptions, find_board_plane};
use crate::estimation::camera::CameraOptions;
use crate::estimation::error::EstimationError;
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence};
use crate::estimation::rgbd::{DepthLens, RgbdEstimate, RgbdProblem, RgbdView, calibrate_rgbd};
use crate::estimation::robust::median;
use crate::geometry::board::Chessboard;
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::depth_camera::{DepthCamera, DepthReading};
use crate::geometry::depth_correction::CorrectedQuantity;
use crate::geometry::lens::Lens;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::imaging::depth_image::DepthImage;

/// What is known of a depth camera beforehand.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthSensor {
    /// What its numbers mean; `None` for disparity that nobody has told the meaning of: it is found from the board.
    pub reading: Option<DepthReading>,
    /// The reading that means none, besides 0 for metric depth.
    pub invalid: Option<u16>,
    /// The device's own lens and pose, where it tells them.
    pub factory: Option<(Lens, Pose)>,
    /// The infrared picture is the depth picture's: same size, same lens. Default for every device that has one.
    pub with_infrared: bool,
}

/// What was seen at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdCapture {
    /// Its path or sequence number.
    pub name: String,
    /// The board in the colour picture; empty where it wasn't found.
    pub color: Vec<Correspondence>,
    /// The board in the infrared picture; empty where it wasn't found.
    pub infrared: Vec<Correspondence>,
    /// The depth picture, where there is one.
    pub depth: Option<DepthImage>,
}

/// A camera with colour and depth to calibrate.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbdInput {
    /// The board.
    pub board: Chessboard,
    /// The size of the colour pictures.
    pub color_size: ImageSize,
    /// What is known of the depth camera.
    pub depth: DepthSensor,
    /// What was seen.
    pub captures: Vec<RgbdCapture>,
}

/// A solved camera with colour and depth.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedRgbd {
    /// Colour by itself, its verdict and views; its lens is the joint estimate's.
    pub color: SolvedCamera,
    /// Infrared by itself, where it was seen.
    pub infrared: Option<SolvedCamera>,
    /// Everything together.
    pub joint: RgbdEstimate,
    /// Which capture each view of the joint estimate is.
    pub captures: Vec<usize>,
    /// Captures whose depth could not be used, and why.
    pub without_depth: Vec<(String, NoPlane)>,
}

/// Why colour and depth could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RgbdError {
    /// One sensor by itself could not be.
    #[error("{sensor}: {source}")]
    Sensor {
        /// Which.
        sensor: &'static str,
        /// Why not.
        source: EstimationError,
    },
    /// Too few captures have the board's surface in depth.
    #[error(
        "only {usable} of {all} views have the board in the depth picture, 3 are needed{first}: check that depth and colour are of the same device and moment"
    )]
    TooLittleDepth {
        /// How many.
        usable: usize,
        /// Of how many with the board in colour.
        all: usize,
        /// Why the first one has not, as `; view: reason`, or nothing.
        first: String,
    },
    /// All together could not be.
    #[error("colour and depth together: {0}")]
    Joint(EstimationError),
}

/// The board's surface reaches this many squares past its outer inner corners, and is measured this far.
const MARGIN_SQUARES: f64 = 0.8;

/// Calibrates colour, infrared where it is seen, and depth jointly.
///
/// # Errors
/// [`RgbdError`]: a sensor that cannot be calibrated by itself, or too few views with depth.
pub fn solve_rgbd(input: &RgbdInput, options: &CameraOptions) -> Result<SolvedRgbd, RgbdError> {
    let of_sensor = |sensor| move |source| RgbdError::Sensor { sensor, source };
    let color = solve_views(&problem(input, input.color_size, |c| &c.color), options).map_err(of_sensor("color"))?;
    let depth_size = input.captures.iter().find_map(|c| c.depth.as_ref()).map(DepthImage::size);
    let depth_size =
        depth_size.ok_or(RgbdError::TooLittleDepth { usable: 0, all: input.captures.len(), first: String::new() })?;
    let infrared_seen = input.captures.iter().filter(|capture| !capture.infrared.is_empty()).count();
    let infrared = (input.depth.with_infrared && infrared_seen >= 3)
        .then(|| solve_views(&problem(input, depth_size, |c| &c.infrared), options).map_err(of_sensor("infrared")))
        .transpose()?;
    let mut guess = Guess::of(input, depth_size, &color, infrared.as_ref());
    let rounds = if infrared.is_some() { 1 } else { 3 };
    let mut solved = None;
    for round in 0..rounds {
        let margin = if rounds == 1 || round > 0 { MARGIN_SQUARES } else { 0.0 };
        let (joint, captures, without_depth) = guess.solve(input, margin)?;
        guess.lens = joint.depth.lens;
        guess.depth_from_color = joint.color_from_depth.inverse();
        solved = Some((joint, captures, without_depth));
    }
    let (joint, captures, without_depth) = solved.ok_or(RgbdError::Joint(EstimationError::NoFit))?;
    Ok(SolvedRgbd { color, infrared, joint, captures, without_depth })
}

fn problem(
    input: &RgbdInput,
    image_size: ImageSize,
    seen: impl Fn(&RgbdCapture) -> &Vec<Correspondence>,
) -> CameraProblem {
    let with_board = input.captures.iter().filter(|capture| !seen(capture).is_empty());
    let views = with_board.map(|c| BoardView { name: c.name.clone(), correspondences: seen(c).clone() }).collect();
    CameraProblem { image_size, views }
}

/// What the joint solve starts from.
struct Guess {
    color: Lens,
    color_noise: f64,
    lens: Lens,
    infrared_noise: f64,
    depth_lens: DepthLens,
    depth_from_color: Pose,
    reading: DepthReading,
    size: ImageSize,
    /// Of every capture that has one.
    color_from_board: Vec<Option<Pose>>,
    infrared_used: Vec<bool>,
}

impl Guess {
    fn of(input: &RgbdInput, size: ImageSize, color: &SolvedCamera, infrared: Option<&SolvedCamera>) -> Self {
        let color_poses = poses(input, color, |c| &c.color);
        let none = vec![None; input.captures.len()];
        let infrared_poses = infrared.map_or(none, |solved| poses(input, solved, |c| &c.infrared));
        let factory = input.depth.factory;
        let (lens, depth_from_color) = match infrared {
            Some(solved) => {
                let both = color_poses.iter().zip(&infrared_poses);
                let depth_from_color: Vec<Pose> =
                    both.filter_map(|(color, infrared)| Some((*infrared)? * (*color)?.inverse())).collect();
                (solved.estimate.lens, middle_pose(&depth_from_color).unwrap_or(Pose::identity()))
            }
            None => {
                factory.unwrap_or_else(|| (same_view(&color.estimate.lens, input.color_size, size), Pose::identity()))
            }
        };
        let color_from_board = color_poses
            .iter()
            .zip(&infrared_poses)
            .map(|(color, infrared)| color.or_else(|| Some(depth_from_color.inverse() * (*infrared)?)))
            .collect();
        let mut guess = Self {
            color: color.estimate.lens,
            color_noise: noise(input, color, |c| &c.color),
            lens,
            infrared_noise: infrared.map_or(1.0, |solved| noise(input, solved, |c| &c.infrared)),
            depth_lens: if infrared.is_some() { DepthLens::Infrared } else { DepthLens::FromPlanes },
            depth_from_color,
            reading: input.depth.reading.unwrap_or(DepthReading::Metric { unit_m: 0.001 }),
            size,
            color_from_board,
            infrared_used: infrared_poses.iter().map(Option::is_some).collect(),
        };
        if input.depth.reading.is_none() {
            guess.reading = guess.disparity(input).unwrap_or(guess.reading);
        }
        guess
    }

    /// What disparity means, from what is read in the board's middle and how far away colour says it is: the line through
    /// the pairs by the median of the slopes between them (H. Theil, 1950).
    fn disparity(&self, input: &RgbdInput) -> Option<DepthReading> {
        let middle = Point3::from(far_corner(&input.board).coords * 0.5);
        let pair = |(capture, pose): (&RgbdCapture, &Option<Pose>)| {
            let point = self.depth_from_color * ((*pose)? * middle);
            let pixel = self.lens.pixel_from_point(&point)?;
            let picture = capture.depth.as_ref()?;
            let (x, y) = (pixel.x.round(), pixel.y.round());
            let inside = picture.size().contains(Pixel::new(x, y)).then(|| picture.row(y as usize)[x as usize])?;
            (Some(inside) != input.depth.invalid).then(|| (f64::from(inside), 1.0 / point.z))
        };
        let pairs: Vec<(f64, f64)> = input.captures.iter().zip(&self.color_from_board).filter_map(pair).collect();
        let slopes = pairs.iter().enumerate().flat_map(|(k, a)| {
            pairs[k + 1..].iter().filter(|b| (a.0 - b.0).abs() > 1.0).map(|b| (a.1 - b.1) / (a.0 - b.0))
        });
        let slope = median(slopes.collect())?;
        let offset = median(pairs.iter().map(|(raw, inverse)| inverse - slope * raw).collect())?;
        Some(DepthReading::Disparity { offset, slope })
    }

    #[expect(clippy::type_complexity, reason = "three results of one step, named where they are taken apart")]
    fn solve(
        &self,
        input: &RgbdInput,
        margin: f64,
    ) -> Result<(RgbdEstimate, Vec<usize>, Vec<(String, NoPlane)>), RgbdError> {
        let (mut views, mut captures, mut without_depth) = (Vec::new(), Vec::new(), Vec::new());
        let plane_options = PlaneOptions { invalid: input.depth.invalid, ..PlaneOptions::default() };
        let mut with_depth = 0;
        for (index, (capture, pose)) in input.captures.iter().zip(&self.color_from_board).enumerate() {
            let Some(color_from_board) = *pose else { continue };
            let tiles = capture.depth.as_ref().map(|picture| {
                let outline = self.outline(&input.board, &color_from_board, margin);
                find_board_plane(picture, (self.reading, &self.lens), &outline, &plane_options)
            });
            let tiles = match tiles {
                Some(Ok(tiles)) => tiles,
                Some(Err(reason)) => {
                    without_depth.push((capture.name.clone(), reason));
                    Vec::new()
                }
                None => Vec::new(),
            };
            with_depth += usize::from(!tiles.is_empty());
            let infrared = if self.infrared_used[index] { capture.infrared.clone() } else { Vec::new() };
            views.push(RgbdView {
                name: capture.name.clone(),
                color: capture.color.clone(),
                infrared,
                tiles,
                color_from_board,
            });
            captures.push(index);
        }
        if with_depth < 3 {
            let first =
                without_depth.first().map(|(name, reason)| format!("; view `{name}`: {reason}")).unwrap_or_default();
            return Err(RgbdError::TooLittleDepth { usable: with_depth, all: views.len(), first });
        }
        let joint = calibrate_rgbd(&RgbdProblem {
            color: self.color,
            color_noise: self.color_noise,
            depth: DepthCamera { image_size: self.size, lens: self.lens, reading: self.reading, correction: None },
            depth_lens: self.depth_lens,
            infrared_noise: self.infrared_noise,
            depth_from_color: self.depth_from_color,
            corrected: match self.reading {
                DepthReading::Disparity { .. } => vec![CorrectedQuantity::InverseDepth],
                DepthReading::Metric { .. } => vec![CorrectedQuantity::InverseDepth, CorrectedQuantity::Depth],
            },
            views,
        })
        .map_err(RgbdError::Joint)?;
        Ok((joint, captures, without_depth))
    }

    /// The board's edge in the depth picture, `margin` squares past its outer inner corners; what the lens does not see is
    /// left out.
    fn outline(&self, board: &Chessboard, color_from_board: &Pose, margin: f64) -> Vec<Pixel> {
        let far = far_corner(board);
        let (low, high) = (-margin * board.square_m, margin * board.square_m);
        let corners = [(low, low), (far.x + high, low), (far.x + high, far.y + high), (low, far.y + high)];
        let depth_from_board = self.depth_from_color * *color_from_board;
        let sides = corners.iter().zip(corners.iter().cycle().skip(1));
        let points = sides.flat_map(|(a, b)| {
            (0..8).map(move |k| {
                let part = f64::from(k) / 8.0;
                Point3::new(a.0 + part * (b.0 - a.0), a.1 + part * (b.1 - a.1), 0.0)
            })
        });
        points.filter_map(|point| self.lens.pixel_from_point(&(depth_from_board * point))).collect()
    }
}

/// The last corner; the first is the board frame's origin.
fn far_corner(board: &Chessboard) -> Point3<f64> {
    let along = |corners: u32| f64::from(corners - 1) * board.square_m;
    Point3::new(along(board.size.cols), along(board.size.rows), 0.0)
}

/// The pose of every capture that a sensor's solve used.
fn poses(
    input: &RgbdInput,
    solved: &SolvedCamera,
    seen: impl Fn(&RgbdCapture) -> &Vec<Correspondence>,
) -> Vec<Option<Pose>> {
    let mut views = solved.estimate.views.iter();
    let of_capture = |capture: &RgbdCapture| {
        if seen(capture).is_empty() {
            return None;
        }
        let view = views.next()?;
        view.camera_from_board.filter(|_| view.fault.is_none())
    };
    input.captures.iter().map(of_capture).collect()
}

/// By how much a sensor's corners scatter more than their own deviations say; above 0.
fn noise(input: &RgbdInput, solved: &SolvedCamera, seen: impl Fn(&RgbdCapture) -> &Vec<Correspondence>) -> f64 {
    let captures = input.captures.iter().map(seen).filter(|corners| !corners.is_empty());
    let views = captures.zip(&solved.estimate.views).filter(|(_, view)| view.fault.is_none());
    let corners = views.flat_map(|(corners, view)| corners.iter().zip(&view.residuals_px).zip(&view.used));
    let (sum, count) = corners.filter(|(_, used)| **used).fold((0.0, 0), |(sum, count), ((corner, [x, y]), _)| {
        (sum + 0.5 * (x * x + y * y) / corner.std_px.powi(2), count + 1)
    });
    (sum / f64::from(count.max(1))).sqrt().max(f64::MIN_POSITIVE)
}

/// The pose that is nearest to most others.
fn middle_pose(a_from_b: &[Pose]) -> Option<Pose> {
    let apart =
        |(first, second): (&Pose, &Pose)| first.angle_to(second) + (first.translation() - second.translation()).norm();
    let spread =
        |other_from_here: &Pose| median(a_from_b.iter().map(|other| apart((other_from_here, other))).collect());
    let least = a_from_b.iter().min_by(|first, second| {
        let [first, second] = [first, second].map(|one| spread(one).unwrap_or(f64::INFINITY));
        first.total_cmp(&second)
    });
    least.copied()
}

/// A pinhole that sees about as much of the world as another camera does.
fn same_view(lens: &Lens, lens_size: ImageSize, size: ImageSize) -> Lens {
    let scale = f64::from(size.width) / f64::from(lens_size.width);
    let focal = lens.matrix.fx * scale;
    let center = size.center();
    Lens::pinhole(CameraMatrix { fx: focal, fy: focal, cx: center.x, cy: center.y, skew: 0.0 })
}

/// Standard deviations of a pose's turn (radians) and translation (metres), axis by axis.
pub fn pose_std(covariance: &Matrix6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let std = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    (Vector3::from_fn(|k, _| std(k)), Vector3::from_fn(|k, _| std(k + 3)))
}
