//! Checks whether a depth calibration still holds. Depth is compared with the planes of boards that
//! color sees, patch by patch. The limit is the error of patches in views that were held out when
//! the camera was calibrated.

use nalgebra::{Matrix6, Vector3, Vector6};

use crate::calibration::depth_calibration::{DepthBias, DepthCalibration};
use crate::calibration::plane_error::{BoardInDepthImage, PatchError, patch_errors};
use crate::calibration::result::Extrinsics;
use crate::estimation::rgbd::motion::MovingBoard;
use crate::geometry::median::{STD_PER_MAD, median};
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;
use crate::imaging::depth_image::DepthImage;

/// An error of this many standard deviations counts as a change.
const LIMIT_SIGMAS: f64 = 3.0;
/// The standard error of a median over that of a mean.
const MEDIAN_OVER_MEAN: f64 = 1.2533;
/// With this many views or more, the worst one is left out.
const LEAVE_ONE_OUT_VIEWS: usize = 4;
/// The peak speed of a board between two frames over its mean: twice, if it starts and stops there
/// with constant acceleration.
const PEAK_OVER_MEAN: f64 = 2.0;
/// A direction with less than this fraction of the information of the best one is not determined.
const LEAST_INFORMATION_RATIO: f64 = 1e-9;

/// A view's depth image, with the board's pose by color.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthView {
    /// The board in color's frame, and where it may have moved by the time depth was taken.
    pub board: MovingBoard,
    /// The depth image.
    pub image: DepthImage,
}

/// The comparison of views with a depth calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthCheck {
    /// By distance, nearest first: the calibration's ranges in which a board was seen.
    pub ranges: Vec<CheckedRange>,
    /// Views with readings on the board, without the `moving` ones.
    pub views: usize,
    /// Views in which the board's motion may explain that depth is off the board: they show nothing
    /// about depth.
    pub moving: usize,
    /// The deviation of patches: the root of the mean over views of each view's robust figure
    /// squared, in standard deviations of held-out views' patches, including the uncertainty of the
    /// sensors' calibrated pose. A view whose board moved between the images is no change: of four
    /// or more views the worst one is left out.
    pub off_sigmas: f64,
    /// The relative error of depth: the median over views, positive if depth is too long.
    pub relative_bias: f64,
    /// Its standard deviation from the scatter of views; infinite for a single one.
    pub relative_bias_std: f64,
    /// The least movement of the depth camera that these views would show, in the worst direction,
    /// in meters; `None` if there is a movement that they do not show.
    pub visible_m: Option<f64>,
}

/// Depth compared with the board's planes in one range of distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckedRange {
    /// The nearest and the farthest patch, in meters.
    pub seen_m: [f64; 2],
    /// The median error of patches, measured − true, in meters.
    pub bias_m: f64,
    /// Its standard deviation from the scatter of views, in meters; infinite for a single one.
    pub bias_std_m: f64,
    /// The robust standard deviation of patches around the bias, in meters.
    pub robust_std_m: f64,
    /// The standard deviation that the calibration predicts, in meters.
    pub calibrated_m: f64,
    /// Views with patches in this range.
    pub views: usize,
    /// Their patches.
    pub patches: usize,
}

impl CheckedRange {
    /// How far depth may be off without counting as a change, in meters.
    pub fn allowed_m(&self) -> f64 {
        LIMIT_SIGMAS * self.calibrated_m
    }
}

impl DepthCheck {
    /// Compares depth with the planes of `board`.
    pub fn of(
        depth: &DepthCalibration,
        color_from_depth: &Extrinsics,
        board: &Target,
        views: &[DepthView],
    ) -> Self {
        let known = CalibratedErrors { depth, color_from_depth };
        let with_depth = views.iter().filter_map(|view| known.view(board, view));
        let (moving, still): (Vec<_>, Vec<_>) = with_depth.partition(|(_, is_moving)| *is_moving);
        let seen: Vec<Vec<SeenPatch>> = still.into_iter().map(|(patches, _)| patches).collect();
        let ranges = 0..depth.bias.len().max(1);
        let relative = |patches: &Vec<SeenPatch>| {
            median(patches.iter().map(|one| one.patch.error_m / one.z_m()).collect())
        };
        let relative: Vec<f64> = seen.iter().filter_map(relative).collect();
        Self {
            ranges: ranges.filter_map(|index| range(&known, index, &seen)).collect(),
            views: seen.len(),
            moving: moving.len(),
            off_sigmas: off_sigmas(&seen),
            relative_bias: median(relative.clone()).unwrap_or(0.0),
            relative_bias_std: median_std(&relative),
            visible_m: visible_m(&known, &seen),
        }
    }

    /// Whether depth is as it was calibrated, wherever it was seen.
    pub fn holds(&self) -> bool {
        self.off_sigmas <= LIMIT_SIGMAS
    }

    /// Whether depth is consistently too long or too short in all views.
    pub fn is_scaled(&self) -> bool {
        self.relative_bias.abs() > LIMIT_SIGMAS * self.relative_bias_std
    }
}

/// The errors that the calibration predicts.
struct CalibratedErrors<'a> {
    depth: &'a DepthCalibration,
    color_from_depth: &'a Extrinsics,
}

/// A patch of a view's board, with its expected error.
#[derive(Clone, Copy)]
struct SeenPatch {
    patch: PatchError,
    /// The standard deviation of its error, in meters: that of held-out views, including the
    /// uncertainty of the sensors' calibrated pose.
    std_m: f64,
}

impl SeenPatch {
    fn z_m(&self) -> f64 {
        self.patch.point_in_depth.z
    }
}

impl CalibratedErrors<'_> {
    /// The patches of a view's board, at its pose in color or where it had moved since, whichever
    /// fits better; and whether its motion explains that they are off. `None` without readings on
    /// the board.
    fn view(&self, board: &Target, view: &DepthView) -> Option<(Vec<SeenPatch>, bool)> {
        let MovingBoard { camera_from_board, camera_from_later, steps } = view.board;
        let patches = |color_from_board: &Pose| {
            let errors = patch_errors(&BoardInDepthImage {
                camera: &self.depth.camera,
                color_from_depth: &self.color_from_depth.target_from_source,
                board,
                color_from_board,
                image: &view.image,
                invalid: self.depth.invalid,
            });
            let seen = |patch| SeenPatch { patch, std_m: self.patch_std_m(&patch) };
            errors.into_iter().map(seen).collect::<Vec<_>>()
        };
        let [still, later] = [camera_from_board, camera_from_later].map(|pose| patches(&pose));
        let [off_still, off_later] = [&still, &later].map(|patches| view_sigmas(patches, &[]));
        let fastest = steps.map(|step| step * PEAK_OVER_MEAN);
        let motions = fastest.map(|step| self.as_camera_motion(&step, &camera_from_board));
        let unexplained = view_sigmas(&still, &motions);
        let best = if off_later < off_still { (later, off_later) } else { (still, off_still) };
        let (patches, off) = (best.0, best.1?);
        let is_moving =
            off > LIMIT_SIGMAS && unexplained.is_some_and(|sigmas| sigmas <= LIMIT_SIGMAS);
        Some((patches, is_moving))
    }

    /// The motion of the depth camera, (t, w) as for [`moved`], that changes depth as much as a
    /// `step` of the board from `color_from_board`: a point x of the board moves by ω × (x - p) +
    /// τ, with p the board's origin.
    fn as_camera_motion(&self, step: &Vector6<f64>, color_from_board: &Pose) -> Vector6<f64> {
        let [rotation, translation] = [0, 3].map(|at| step.fixed_rows::<3>(at).into_owned());
        let of_color = translation + color_from_board.translation().cross(&rotation);
        let depth_from_color = self.color_from_depth.target_from_source.inverse();
        let rotation = depth_from_color * rotation;
        let of_depth =
            depth_from_color * of_color + depth_from_color.translation().cross(&rotation);
        Vector6::from_iterator(of_depth.iter().chain(rotation.iter()).copied())
    }

    /// The calibration's range that contains a distance, or is nearest to it.
    fn range_index(&self, z_m: f64) -> usize {
        let beside = |range: &DepthBias| (range.from_m - z_m).max(z_m - range.to_m).max(0.0);
        let ranges = self.depth.bias.iter().map(beside).enumerate();
        ranges.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
    }

    /// The standard deviation of a patch at `z_m`: that of held-out views, which grows beyond them
    /// with the square of the distance; if there are none, that of single readings.
    fn held_out_std_m(&self, z_m: f64) -> f64 {
        match self.depth.bias.get(self.range_index(z_m)) {
            Some(range) => range.rms_after_m * (z_m / range.to_m).powi(2).max(1.0),
            None => self.depth.noise.at(z_m),
        }
    }

    /// The same including the uncertainty of the sensors' calibrated pose, with its six parameters
    /// taken as independent: it is large if the calibration was weak.
    fn patch_std_m(&self, patch: &PatchError) -> f64 {
        let Extrinsics { translation_std_m, rotation_std, .. } = self.color_from_depth;
        let std = Vector6::from_iterator(translation_std_m.iter().chain(rotation_std).copied());
        let of_pose_m = moved(patch).component_mul(&std).norm();
        self.held_out_std_m(patch.point_in_depth.z).hypot(of_pose_m)
    }
}

fn range(
    known: &CalibratedErrors<'_>,
    index: usize,
    seen: &[Vec<SeenPatch>],
) -> Option<CheckedRange> {
    let here = |one: &&SeenPatch| known.range_index(one.z_m()) == index;
    let of_view =
        |patches: &Vec<SeenPatch>| patches.iter().filter(here).copied().collect::<Vec<_>>();
    let views: Vec<Vec<SeenPatch>> =
        seen.iter().map(of_view).filter(|patches| !patches.is_empty()).collect();
    let errors = |patches: &[SeenPatch]| patches.iter().map(|one| one.patch.error_m).collect();
    let all = views.concat();
    let distances = || all.iter().map(SeenPatch::z_m);
    let bias_m = median(errors(&all))?;
    let absolute = all.iter().map(|one| (one.patch.error_m - bias_m).abs()).collect();
    let of_views: Vec<f64> = views.iter().filter_map(|view| median(errors(view))).collect();
    let stds = all.iter().map(|one| one.std_m).collect();
    Some(CheckedRange {
        seen_m: [distances().fold(f64::INFINITY, f64::min), distances().fold(0.0, f64::max)],
        bias_m,
        bias_std_m: median_std(&of_views),
        robust_std_m: STD_PER_MAD * median(absolute)?,
        calibrated_m: median(stds)?,
        views: views.len(),
        patches: all.len(),
    })
}

/// How far the patches of a view are off beyond what any of `motions` explains, in standard
/// deviations predicted by the calibration.
fn view_sigmas(patches: &[SeenPatch], motions: &[Vector6<f64>]) -> Option<f64> {
    let sigmas = |one: &SeenPatch| {
        let row = moved(&one.patch);
        let explained_m = motions.iter().map(|step| row.dot(step).abs()).fold(0.0, f64::max);
        (one.patch.error_m.abs() - explained_m).max(0.0) / one.std_m
    };
    Some(STD_PER_MAD * median(patches.iter().map(sigmas).collect())?)
}

/// How far views are off, see [`DepthCheck::off_sigmas`].
fn off_sigmas(seen: &[Vec<SeenPatch>]) -> f64 {
    let mut views: Vec<f64> = seen.iter().filter_map(|patches| view_sigmas(patches, &[])).collect();
    views.sort_by(f64::total_cmp);
    if views.len() >= LEAVE_ONE_OUT_VIEWS {
        views.pop();
    }
    let square = views.iter().map(|sigmas| sigmas * sigmas).sum::<f64>();
    (square / views.len().max(1) as f64).sqrt()
}

/// The standard deviation of the median of `values`, from their scatter.
fn median_std(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    if values.len() < 2 { f64::INFINITY } else { MEDIAN_OVER_MEAN * (square / count).sqrt() }
}

/// The derivative of a patch's depth by a movement of the depth camera by t and a rotation w: for a
/// plane with normal n at the point p it is n · (t + w × p) / (n · p / p_z).
fn moved(patch: &PatchError) -> Vector6<f64> {
    let (point, normal) = (patch.point_in_depth.coords, patch.normal_in_depth);
    let rotated = point.cross(&normal);
    let row = Vector6::from_iterator(normal.iter().chain(rotated.iter()).copied());
    row / normal.dot(&(point / point.z))
}

/// The least movement of the depth camera that shows. Patches of one view have correlated errors,
/// so each view counts as the three parameters of its plane.
fn visible_m(known: &CalibratedErrors<'_>, seen: &[Vec<SeenPatch>]) -> Option<f64> {
    let mut information = Matrix6::zeros();
    for patches in seen {
        let weight = (3.0 / patches.len() as f64).min(1.0);
        for SeenPatch { patch, .. } in patches {
            let row = moved(patch);
            let std_m = known.held_out_std_m(patch.point_in_depth.z);
            information += row * row.transpose() * (weight / (std_m * std_m));
        }
    }
    let eigenvalues = information.symmetric_eigenvalues();
    let covariance = (eigenvalues.min() > LEAST_INFORMATION_RATIO * eigenvalues.max())
        .then(|| information.try_inverse())
        .flatten()?;
    let of_translation = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let largest: Vector3<f64> = of_translation.symmetric_eigenvalues();
    Some(LIMIT_SIGMAS * largest.max().max(0.0).sqrt())
}
