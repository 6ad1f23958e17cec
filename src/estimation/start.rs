//! The start without an initial guess: Zhang's closed form; or, where a lens distorts the image too
//! strongly for it, the focal length under which linear poses fit best.

use std::ops::Range;

use nalgebra::{Point2, Point3, Vector3};

use crate::estimation::error::EstimationError;
use crate::estimation::interrupt::Interrupt;
use crate::estimation::joint::{BoardObservation, State};
use crate::estimation::measured_board::MeasuredBoard;
use crate::estimation::planar_pose::{Shape, pose_from_bearings};
use crate::estimation::problem::{CameraOptions, CameraProblem, CameraStart};
use crate::estimation::view_fault::{ViewFault, mislabeling};
use crate::estimation::zhang::{self, Skew};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::homography::Homography;
use crate::geometry::lens::{Distortion, Lens, LensModel};
use crate::geometry::median::median;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

/// A view is left out of the start where the rms residual of its own homography exceeds this part
/// of its corners' rms distance from their mean. A strong fisheye has a tenth, labels out of order
/// have more than half.
const MOST_MISFIT: f64 = 0.25;

/// Pixels of less roundness ([`PixelScatter::roundness`]) lie on a line, up to rounding.
const LEAST_ROUNDNESS: f64 = 1e-6;

/// A relabeling explains a view if the rms of its homography is then less than this many times the
/// median of the other views, or …
const RELABELED_MEDIANS: f64 = 4.0;
/// … less than this part of its corners' rms distance from their mean. With wrong labels it is half
/// of that. Neither was swept.
const RELABELED_PART: f64 = 0.01;

/// The largest number of views on which first lenses are compared. The median of their errors
/// tolerates four wrong ones.
const COMPARED_VIEWS: usize = 9;

/// A first lens whose error is less than this part of the image's diagonal (4 px at 640 × 480) is
/// close enough to start from; otherwise the focal lengths below are tried.
const GOOD_ENOUGH: f64 = 0.005;

/// Focal lengths tried, over the image's longer side: fields of view of 136 to 7 degrees without
/// distortion, each focal length 1.3 to 1.7 times the one before. Not swept.
const TRIED_FOCALS: [f64; 11] = [0.2, 0.28, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0, 3.0, 5.0, 8.0];

// A camera matrix of the closed form beyond these limits fits noise or distortion, and is no
// candidate. Cameras lie well within them.
/// The principal point, as parts of the image's width and height.
const PLAUSIBLE_CENTER: [f64; 2] = [0.1, 0.9];
/// fx over fy.
const PLAUSIBLE_ASPECT: Range<f64> = 0.6..1.6;
/// fx over the image's longer side: fields of view of 157 to 1.1 degrees without distortion.
const PLAUSIBLE_FOCAL: Range<f64> = 0.1..50.0;

/// The least number of corners of a view: a flat pose takes four, and two more make errors
/// detectable.
const MIN_POINTS: usize = 6;

/// The views of a problem, each prepared by itself.
pub(crate) struct Prepared {
    pub(crate) image_size: ImageSize,
    pub(crate) names: Vec<String>,
    /// The points' common center in the board frame.
    pub(crate) center_in_board: Vector3<f64>,
    /// One per view; `frame_set` is the view's index.
    pub(crate) observations: Vec<BoardObservation>,
    pub(crate) views: Vec<PreparedView>,
    /// Ends computations on them early.
    pub(crate) interrupt: Interrupt,
}

/// What a view determines by itself.
pub(crate) struct PreparedView {
    shape: Option<Shape>,
    homography: Option<FittedHomography>,
    pub(crate) fault: Option<ViewFault>,
}

/// The homography that fits a flat view best.
#[derive(Clone, Copy)]
struct FittedHomography {
    pixel_from_plane: Homography,
    /// The rms of its residuals.
    rms_px: f64,
}

impl Prepared {
    /// Prepares every view of a valid problem.
    pub(crate) fn of(problem: &CameraProblem) -> Self {
        Self::about(problem, mean_point(std::slice::from_ref(problem)))
    }

    /// As [`Self::of`], about a center common to several problems.
    pub(crate) fn about(problem: &CameraProblem, center_in_board: Vector3<f64>) -> Self {
        // A flat board stays exactly flat.
        let observations: Vec<_> = problem
            .views
            .iter()
            .enumerate()
            .map(|(frame_set, view)| {
                let seen = &view.correspondences;
                BoardObservation {
                    sensor: 0,
                    frame_set,
                    points: seen.iter().map(|c| c.point_in_board - center_in_board).collect(),
                    pixels: seen.iter().map(|c| c.pixel).collect(),
                    inverse_std: seen.iter().map(|c| 1.0 / c.std_px).collect(),
                    used: vec![true; seen.len()],
                }
            })
            .collect();
        let mut views: Vec<_> = observations.iter().map(PreparedView::of).collect();
        name_mislabeled(&observations, &mut views);
        let names = problem.views.iter().map(|view| view.name.clone()).collect();
        let interrupt = Interrupt::default();
        Self {
            image_size: problem.image_size,
            names,
            center_in_board,
            observations,
            views,
            interrupt,
        }
    }

    /// Marks views whose corners all equal those of an earlier view as copies, unless copies count:
    /// noise never leaves two images equal.
    pub(crate) fn name_copies(&mut self, options: &CameraOptions) {
        if options.copies_count {
            return;
        }
        let is_copy = |one: &BoardObservation, other: &BoardObservation| {
            one.pixels == other.pixels && one.points == other.points
        };
        for (index, observation) in self.observations.iter().enumerate() {
            let before = &self.observations[..index];
            let original = before.iter().position(|before| is_copy(before, observation));
            if let (Some(original), None) = (original, self.views[index].fault) {
                self.views[index].fault = Some(ViewFault::Copied { number: original + 1 });
            }
        }
    }

    /// Moves the corners to their positions on a measured board. The homographies of the views
    /// remain those of the stated board, which suffice for a start.
    ///
    /// # Errors
    /// [`EstimationError::OtherBoard`] for a corner that was not measured.
    pub(crate) fn place_on(&mut self, board: &MeasuredBoard) -> Result<(), EstimationError> {
        for point in self.observations.iter_mut().flat_map(|observation| &mut observation.points) {
            let stated = *point + self.center_in_board;
            let offset = board.offset_at(&stated);
            *point += offset.ok_or(EstimationError::OtherBoard { x_m: stated.x, y_m: stated.y })?;
        }
        Ok(())
    }

    /// The fault of each view, if it has one.
    pub(crate) fn faults(&self) -> Vec<Option<ViewFault>> {
        self.views.iter().map(|view| view.fault).collect()
    }

    /// Whether every view that has a shape is flat.
    pub(crate) fn is_flat(&self) -> bool {
        self.views.iter().filter_map(|view| view.shape.as_ref()).all(Shape::is_flat)
    }

    /// The board's normal in its own frame, if it is flat.
    pub(crate) fn board_normal(&self) -> Option<Vector3<f64>> {
        match self.views.iter().find_map(|view| view.shape.as_ref())? {
            Shape::Flat { plane_from_board, .. } => Some(plane_from_board.inverse() * Vector3::z()),
            Shape::Solid { .. } => None,
        }
    }

    /// The views without a fault, by index.
    pub(crate) fn usable(&self) -> Vec<usize> {
        (0..self.views.len()).filter(|index| self.views[*index].fault.is_none()).collect()
    }

    /// `camera_from_board` (about the common center) of one view under `lens`, by a linear method;
    /// `None` where there is none.
    pub(crate) fn pose(&self, view: usize, lens: &Lens) -> Option<Pose> {
        let (prepared, observation) = (&self.views[view], &self.observations[view]);
        let straight = lens.distortion.as_rational() == Some([0.0; 8]);
        if let (true, Some(fitted), Some(Shape::Flat { plane_from_board, .. })) =
            (straight, &prepared.homography, &prepared.shape)
        {
            let camera_from_plane =
                zhang::camera_from_board(lens.matrix, &fitted.pixel_from_plane)?;
            return Some(camera_from_plane * *plane_from_board);
        }
        let bearings: Vec<_> =
            observation.pixels.iter().map(|pixel| lens.bearing_from_pixel(*pixel)).collect();
        pose_from_bearings(prepared.shape.as_ref()?, &observation.points, &bearings)
    }
}

/// The mean of all board points.
pub(crate) fn mean_point(problems: &[CameraProblem]) -> Vector3<f64> {
    let corners = || {
        problems.iter().flat_map(|problem| &problem.views).flat_map(|view| &view.correspondences)
    };
    corners().map(|c| c.point_in_board.coords).sum::<Vector3<f64>>()
        / corners().count().max(1) as f64
}

impl PreparedView {
    fn of(observation: &BoardObservation) -> Self {
        let points = observation.points.len();
        let faulty = |fault| Self { shape: None, homography: None, fault: Some(fault) };
        if points < MIN_POINTS {
            return faulty(ViewFault::TooFewPoints { points, needed: MIN_POINTS });
        }
        let Some(shape) = Shape::of(&observation.points) else {
            return faulty(ViewFault::PointsOnLine);
        };
        let scatter = PixelScatter::of(&observation.pixels);
        if scatter.roundness < LEAST_ROUNDNESS {
            return faulty(ViewFault::PixelsOnLine);
        }
        let Shape::Flat { .. } = &shape else {
            return Self { shape: Some(shape), homography: None, fault: None };
        };
        let pairs = plane_pairs(&shape, observation);
        let homography = Homography::fit(&pairs).ok().map(|pixel_from_plane| FittedHomography {
            pixel_from_plane,
            rms_px: pixel_from_plane.rms(&pairs),
        });
        let extent_px = scatter.rms_px;
        let rms_px = homography.map_or(extent_px, |fitted| fitted.rms_px.min(extent_px));
        let fault = (rms_px > MOST_MISFIT * extent_px).then_some(ViewFault::NoPose { rms_px });
        Self { shape: Some(shape), homography, fault }
    }
}

/// Replaces the fault of views that no homography fits as well as the other views by the relabeling
/// that would.
fn name_mislabeled(observations: &[BoardObservation], views: &mut [PreparedView]) {
    let good = views.iter().filter(|view| view.fault.is_none());
    let Some(typical_px) =
        median(good.filter_map(|view| view.homography.map(|fitted| fitted.rms_px)).collect())
    else {
        return;
    };
    for (observation, view) in observations.iter().zip(views) {
        let (Some(ViewFault::NoPose { .. }), Some(shape)) = (&view.fault, &view.shape) else {
            continue;
        };
        let Shape::Flat { plane_from_board, .. } = shape else { continue };
        let on_plane: Vec<_> = observation.points.iter().map(|p| *plane_from_board * *p).collect();
        let extent_px = PixelScatter::of(&observation.pixels).rms_px;
        let limit_px = (RELABELED_MEDIANS * typical_px).max(RELABELED_PART * extent_px);
        view.fault = mislabeling(&on_plane, &observation.pixels, limit_px).or(view.fault);
    }
}

fn plane_pairs(shape: &Shape, observation: &BoardObservation) -> Vec<(Point2<f64>, Point2<f64>)> {
    let pixels = observation.pixels.iter().map(|pixel| Point2::new(pixel.x, pixel.y));
    match shape {
        Shape::Flat { plane_from_board, .. } if plane_from_board.rotation().w == 1.0 => {
            let translation = plane_from_board.translation();
            observation.points.iter().map(|p| (p + translation).xy()).zip(pixels).collect()
        }
        Shape::Flat { plane_from_board, .. } => {
            observation.points.iter().map(|p| (*plane_from_board * *p).xy()).zip(pixels).collect()
        }
        Shape::Solid { .. } => Vec::new(),
    }
}

/// The scatter of pixels about their mean.
#[derive(Clone, Copy)]
struct PixelScatter {
    /// Their rms distance from it.
    rms_px: f64,
    /// The root of the determinant of their scatter matrix over its trace: 0 on a line, ½ where
    /// they extend equally in every direction.
    roundness: f64,
}

impl PixelScatter {
    fn of(pixels: &[Pixel]) -> Self {
        let n = pixels.len() as f64;
        let (sx, sy) = pixels.iter().fold((0.0, 0.0), |(x, y), p| (x + p.x, y + p.y));
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for p in pixels {
            let (dx, dy) = (p.x - sx / n, p.y - sy / n);
            xx += dx * dx;
            xy += dx * dy;
            yy += dy * dy;
        }
        let (trace, determinant) = (xx + yy, (xx * yy - xy * xy).max(0.0));
        Self {
            rms_px: (trace / n).sqrt(),
            roundness: if trace > 0.0 { determinant.sqrt() / trace } else { 0.0 },
        }
    }
}

/// A first lens of `model` and the poses of the usable views, about the common center. A view
/// without a pose gets that fault. `None` where no view has a pose.
pub(crate) fn start(prepared: &mut Prepared, model: LensModel) -> Option<State> {
    let usable = prepared.usable();
    let homographies: Vec<_> = usable
        .iter()
        .filter_map(|v| Some(prepared.views[*v].homography?.pixel_from_plane))
        .collect();
    let mut candidates: Vec<CameraMatrix> = Vec::new();
    candidates.extend(zhang::camera_matrix(&homographies, prepared.image_size, Skew::Zero).ok());
    candidates.retain(|matrix| is_plausible(matrix, prepared.image_size));
    candidates.extend(
        median_focal(&homographies, prepared.image_size).map(|f| centered(prepared.image_size, f)),
    );
    let few = sample(&usable, COMPARED_VIEWS);
    let lens_of = |matrix| undistorted(model, matrix);
    let score = |matrix: &CameraMatrix| misfit_px(prepared, &few, &lens_of(*matrix));
    let mut scored: Vec<_> =
        candidates.into_iter().map(|matrix| (score(&matrix), matrix)).collect();
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    let good_enough_px = GOOD_ENOUGH * prepared.image_size.diagonal_px();
    if scored.first().is_none_or(|(px, _)| !(*px < good_enough_px)) {
        let width = f64::from(prepared.image_size.width.max(prepared.image_size.height));
        for factor in TRIED_FOCALS {
            let matrix = centered(prepared.image_size, factor * width);
            scored.push((score(&matrix), matrix));
        }
        scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    let lens = lens_of(scored.first()?.1);
    place_views(prepared, lens, &[])
}

/// The state of an earlier estimate, with poses for the views that it lacks.
pub(crate) fn resume(prepared: &mut Prepared, earlier: &CameraStart) -> Option<State> {
    let center = Point3::from(prepared.center_in_board);
    let known: Vec<_> = earlier
        .camera_from_board
        .iter()
        .map(|known| {
            known.map(|camera_from_board| {
                Pose::new(camera_from_board.rotation(), (camera_from_board * center).coords)
            })
        })
        .collect();
    place_views(prepared, earlier.lens, &known)
}

/// `lens` with the pose of each usable view, known or estimated.
fn place_views(
    prepared: &mut Prepared,
    lens: Lens,
    camera_from_board: &[Option<Pose>],
) -> Option<State> {
    let mut rig_from_board = vec![Pose::identity(); prepared.views.len()];
    let mut found = false;
    for view in prepared.usable() {
        match camera_from_board.get(view).copied().flatten().or_else(|| prepared.pose(view, &lens))
        {
            Some(pose) => (rig_from_board[view], found) = (pose, true),
            None => prepared.views[view].fault = Some(ViewFault::NoPose { rms_px: f64::INFINITY }),
        }
    }
    found.then(|| State {
        lenses: vec![lens],
        sensor_from_rig: vec![Pose::identity()],
        rig_from_board,
        warp: [0.0; 2],
    })
}

/// Square pixels, with the principal point in the image's center.
fn centered(size: ImageSize, focal_px: f64) -> CameraMatrix {
    CameraMatrix { fx: focal_px, fy: focal_px, cx: size.center().x, cy: size.center().y, skew: 0.0 }
}

/// The lens of `model` from which a search starts.
pub(crate) fn undistorted(model: LensModel, matrix: CameraMatrix) -> Lens {
    Lens { matrix, distortion: Distortion::start(model) }
}

fn is_plausible(matrix: &CameraMatrix, size: ImageSize) -> bool {
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let [least, most] = PLAUSIBLE_CENTER;
    let inside = |c: f64, length: f64| c > least * length && c < most * length;
    let ratio = matrix.fx / matrix.fy;
    let focal = matrix.fx / width.max(height);
    inside(matrix.cx, width)
        && inside(matrix.cy, height)
        && PLAUSIBLE_ASPECT.contains(&ratio)
        && PLAUSIBLE_FOCAL.contains(&focal)
}

/// The focal length of square pixels, with the principal point in the image's center. Each
/// homography gives one from Zhang's two equations; the median is insensitive to a few wrong ones.
fn median_focal(homographies: &[Homography], size: ImageSize) -> Option<f64> {
    let center = size.center();
    let squares = homographies.iter().filter_map(|homography| {
        let h = homography.matrix();
        let at = |column: usize| {
            let c = h.column(column);
            (c[0] - center.x * c[2], c[1] - center.y * c[2], c[2])
        };
        let ((a, b, c), (d, e, f)) = (at(0), at(1));
        let across = [a * d + b * e, a * a + b * b - d * d - e * e];
        let depth = [c * f, c * c - f * f];
        let square = -(across[0] * depth[0] + across[1] * depth[1])
            / (depth[0] * depth[0] + depth[1] * depth[1]);
        (square.is_finite() && square > 0.0).then_some(square)
    });
    Some(median(squares.collect())?.sqrt())
}

/// At most `count` of `indices`, evenly spaced.
fn sample(indices: &[usize], count: usize) -> Vec<usize> {
    let step = indices.len().div_ceil(count).max(1);
    indices.iter().step_by(step).copied().collect()
}

/// The median over `views` of each one's rms error at its linear pose; infinite for a view without
/// a pose.
fn misfit_px(prepared: &Prepared, views: &[usize], lens: &Lens) -> f64 {
    let of_view = |view: &usize| {
        let observation = &prepared.observations[*view];
        let Some(pose) = prepared.pose(*view, lens) else { return f64::INFINITY };
        let square = |(point, pixel): (&Point3<f64>, &Pixel)| {
            let seen = lens.pixel_from_point(&(pose * *point));
            seen.map_or(f64::INFINITY, |seen| (seen.to_vector() - pixel.to_vector()).norm_squared())
        };
        let sum: f64 = observation.points.iter().zip(&observation.pixels).map(square).sum();
        (sum / observation.points.len() as f64).sqrt()
    };
    median(views.iter().map(of_view).collect()).unwrap_or(f64::INFINITY)
}
