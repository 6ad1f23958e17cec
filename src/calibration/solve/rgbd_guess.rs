//! The initial guess for the joint solve of color, infrared and depth: the sensors calibrated one
//! by one, the board's motion, the meaning of disparity, and the board's surface in every depth
//! image.

use std::cmp::Reverse;
use std::mem::discriminant;

use nalgebra::{DMatrix, Point3};

use crate::calibration::solve::SolvedCamera;
use crate::calibration::solve::disparity_meaning::{
    KnownReading, disparity_through, reading_in_middle,
};
use crate::calibration::solve::rgbd_error::RgbdError;
use crate::calibration::solve::rgbd_input::{RgbdFrameSet, RgbdInput, poses, views};
use crate::detection::board_plane::{DepthInput, NoPlane, PlaneOptions, find_board_plane};
use crate::detection::plane_growth::grow_plane;
use crate::estimation::board_pose::board_poses;
use crate::estimation::board_surface::BoardSurface;
use crate::estimation::problem::{BoardView, CameraOptions, Correspondence};
use crate::estimation::rgbd::motion::{
    BoardExtent, BoardMotion, SharedFrameSet, TimeOffset, TimedPose, board_motions, time_offset,
};
use crate::estimation::rgbd::{DepthLens, RgbdProblem, RgbdView};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::depth_camera::{DepthCamera, DepthReading, DepthTile, PosedDepthLens};
use crate::geometry::depth_correction::CorrectedQuantity;
use crate::geometry::lens::Lens;
use crate::geometry::median::median_pose;
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// The joint problem.
pub(super) struct JointProblem {
    pub(super) problem: RgbdProblem,
    /// The input's frame set of each view of the problem.
    pub(super) frame_set_of_view: Vec<usize>,
    /// Views whose depth could not be used.
    pub(super) without_depth: Vec<ViewWithoutDepth>,
}

/// A view whose depth image does not show the board's surface.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewWithoutDepth {
    /// Its name.
    pub name: String,
    /// Why not.
    pub reason: NoPlane,
}

impl JointProblem {
    /// The error that the lens fitted to these planes no longer sees the board there.
    pub(super) fn lens_elsewhere(&self) -> RgbdError {
        let views = &self.problem.views;
        RgbdError::LensElsewhere {
            usable: views.iter().filter(|view| !view.tiles.is_empty()).count(),
            all: views.len(),
            reasons: reasons(&self.without_depth),
        }
    }
}

/// The start of the joint solve.
pub(super) struct InitialGuess {
    color: Lens,
    color_options: CameraOptions,
    color_covariance: Option<DMatrix<f64>>,
    color_noise: f64,
    pub(super) lens: Lens,
    infrared_noise: f64,
    depth_lens: DepthLens,
    pub(super) depth_from_color: Pose,
    reading: DepthReading,
    size: ImageSize,
    /// The board's surface, if color measured it.
    surface: Option<BoardSurface>,
    /// For every frame set with a pose.
    color_from_board: Vec<Option<Pose>>,
    infrared_used: Vec<bool>,
    motions: Vec<Option<BoardMotion>>,
    time_offset: Option<TimeOffset>,
}

impl InitialGuess {
    pub(super) fn of(
        input: &RgbdInput,
        size: ImageSize,
        color: &SolvedCamera,
        color_options: &CameraOptions,
        infrared: Option<&SolvedCamera>,
    ) -> Self {
        let color_poses = poses(input, color, |c| &c.color);
        let none = vec![None; input.frame_sets.len()];
        let infrared_poses = infrared.map_or(none, |solved| poses(input, solved, |c| &c.infrared));
        let factory = input.depth.factory;
        let PosedDepthLens { lens, depth_from_color } = match infrared {
            Some(solved) => {
                let both = color_poses.iter().zip(&infrared_poses);
                let depth_from_color: Vec<Pose> = both
                    .filter_map(|(color, infrared)| Some((*infrared)? * (*color)?.inverse()))
                    .collect();
                PosedDepthLens {
                    lens: solved.estimate.lens,
                    depth_from_color: median_pose(&depth_from_color).unwrap_or(Pose::identity()),
                }
            }
            None => initial_depth((&color.estimate.lens, input.color_size), size, factory),
        };
        let color_from_board = color_poses
            .iter()
            .zip(&infrared_poses)
            .map(|(color, infrared)| {
                color.or_else(|| Some(depth_from_color.inverse() * (*infrared)?))
            })
            .collect();
        let mut guess = Self {
            color: color.estimate.lens,
            color_options: color_options.clone(),
            color_covariance: color
                .estimate
                .board_shape
                .is_some()
                .then(|| color.estimate.lens_covariance.clone()),
            color_noise: noise(input, color, |c| &c.color),
            lens,
            infrared_noise: infrared.map_or(1.0, |solved| noise(input, solved, |c| &c.infrared)),
            depth_lens: if infrared.is_some() {
                DepthLens::Infrared
            } else {
                DepthLens::FromPlanes
            },
            depth_from_color,
            reading: input.depth.reading.unwrap_or(DepthReading::Metric { unit_m: 0.001 }),
            size,
            surface: color.sensor.board_shape.as_ref().and_then(BoardSurface::of),
            color_from_board,
            infrared_used: infrared_poses.iter().map(Option::is_some).collect(),
            motions: Vec::new(),
            time_offset: None,
        };
        guess.find_motion(input, &color_poses, &infrared_poses);
        if input.depth.reading.is_none() {
            guess.reading = guess.disparity(input).unwrap_or(guess.reading);
        }
        guess
    }

    /// Estimates the board's motion at each frame set, and the time between the sensors from the
    /// frame sets in which both see the board.
    fn find_motion(
        &mut self,
        input: &RgbdInput,
        color: &[Option<Pose>],
        infrared: &[Option<Pose>],
    ) {
        let (indices, moments): (Vec<usize>, Vec<TimedPose>) = input
            .frame_sets
            .iter()
            .enumerate()
            .filter_map(|(index, frame_set)| {
                let camera_from_board = color[index]
                    .or_else(|| moving_pose(&self.color, frame_set, &frame_set.color))?;
                Some((index, TimedPose { time_s: frame_set.time_s?, camera_from_board }))
            })
            .unzip();
        self.motions = vec![None; input.frame_sets.len()];
        let mut both = Vec::new();
        let motions = board_motions(&moments);
        for ((index, moment), motion) in indices.into_iter().zip(&moments).zip(motions) {
            self.motions[index] = motion;
            let frame_set = &input.frame_sets[index];
            let second =
                infrared[index].or_else(|| moving_pose(&self.lens, frame_set, &frame_set.infrared));
            if let (Some(motion), Some(second_from_board), DepthLens::Infrared) =
                (motion, second, self.depth_lens)
            {
                both.push(SharedFrameSet {
                    first_from_board: moment.camera_from_board,
                    motion,
                    second_from_board,
                });
            }
        }
        self.time_offset = time_offset(&self.depth_from_color, &both, extent_of(&input.board))
            .filter(|offset| offset.std_s < MOST_OFFSET_STD_S);
    }

    /// The meaning of disparity, from all frame sets with a board.
    fn disparity(&self, input: &RgbdInput) -> Option<DepthReading> {
        let depth = PosedDepthLens { lens: self.lens, depth_from_color: self.depth_from_color };
        let known = |(frame_set, pose): (&RgbdFrameSet, &Option<Pose>)| {
            let image = (frame_set.depth.as_ref()?, input.depth.invalid);
            reading_in_middle(image, &depth, &input.board, pose.as_ref()?)
        };
        let known: Vec<KnownReading> =
            input.frame_sets.iter().zip(&self.color_from_board).filter_map(known).collect();
        disparity_through(&known)
    }

    /// Measures the board's surface in every depth image, up to `margin` squares beyond its
    /// outermost corners.
    pub(super) fn measured(
        &self,
        input: &RgbdInput,
        margin: f64,
    ) -> Result<JointProblem, RgbdError> {
        let (mut views, mut frame_set_of_view, mut without_depth) =
            (Vec::new(), Vec::new(), Vec::new());
        let plane_options =
            PlaneOptions { invalid: input.depth.invalid, ..PlaneOptions::default() };
        let mut with_depth = 0;
        for (index, (frame_set, pose)) in
            input.frame_sets.iter().zip(&self.color_from_board).enumerate()
        {
            let (Some(color_from_board), true) = (*pose, frame_set.is_view) else { continue };
            let seen = frame_set.depth.as_ref().map(|image| {
                let lens =
                    PosedDepthLens { lens: self.lens, depth_from_color: self.depth_from_color };
                let outline = board_outline(&input.board, &lens, &color_from_board, margin);
                let depth = DepthInput { image, reading: self.reading, lens: &self.lens };
                let tiles = find_board_plane(depth, &outline, &plane_options)?;
                let surround = grow_plane(depth, &tiles, &outline, &plane_options);
                Ok((self.on_plane(tiles, &color_from_board), surround))
            });
            let (tiles, surround) = match seen {
                Some(Ok(seen)) => seen,
                Some(Err(reason)) => {
                    without_depth.push(ViewWithoutDepth { name: frame_set.name.clone(), reason });
                    (Vec::new(), Vec::new())
                }
                None => (Vec::new(), Vec::new()),
            };
            with_depth += usize::from(!tiles.is_empty());
            let infrared =
                if self.infrared_used[index] { frame_set.infrared.clone() } else { Vec::new() };
            views.push(RgbdView {
                name: frame_set.name.clone(),
                color: frame_set.color.clone(),
                infrared,
                tiles,
                surround,
                color_from_board,
                motion: self.motions[index],
            });
            frame_set_of_view.push(index);
        }
        if with_depth < 3 {
            let (usable, all) = (with_depth, views.len());
            let reasons = reasons(&without_depth);
            return Err(RgbdError::TooLittleDepth { usable, all, reasons });
        }
        Ok(JointProblem { problem: self.problem(views), frame_set_of_view, without_depth })
    }

    /// The board's `tiles` reduced to its plane, which they are compared with.
    fn on_plane(&self, tiles: Vec<DepthTile>, color_from_board: &Pose) -> Vec<DepthTile> {
        let Some(surface) = &self.surface else { return tiles };
        let depth_from_board = self.depth_from_color * *color_from_board;
        let reduced = |tile| surface.on_plane(&self.lens, &depth_from_board, tile);
        tiles.iter().filter_map(reduced).collect()
    }

    fn problem(&self, views: Vec<RgbdView>) -> RgbdProblem {
        RgbdProblem {
            color: self.color,
            color_options: self.color_options.clone(),
            color_covariance: self.color_covariance.clone(),
            color_noise: self.color_noise,
            depth: DepthCamera {
                image_size: self.size,
                lens: self.lens,
                reading: self.reading,
                correction: None,
            },
            depth_lens: self.depth_lens,
            infrared_noise: self.infrared_noise,
            depth_from_color: self.depth_from_color,
            time_offset: self.time_offset,
            corrected: match self.reading {
                DepthReading::Disparity { .. } => vec![CorrectedQuantity::InverseDepth],
                DepthReading::Metric { .. } => {
                    vec![CorrectedQuantity::InverseDepth, CorrectedQuantity::Depth]
                }
            },
            views,
            interrupt: self.color_options.interrupt.clone(),
        }
    }
}

/// Why views have no depth: each reason with its count and its first view, the most frequent first.
fn reasons(without_depth: &[ViewWithoutDepth]) -> String {
    // Each reason's count, with its first view.
    let mut each: Vec<(usize, &ViewWithoutDepth)> = Vec::new();
    for view in without_depth {
        let same = |(_, first): &&mut (usize, &ViewWithoutDepth)| {
            discriminant(&first.reason) == discriminant(&view.reason)
        };
        match each.iter_mut().find(same) {
            Some((count, _)) => *count += 1,
            None => each.push((1, view)),
        }
    }
    each.sort_by_key(|(count, _)| Reverse(*count));
    let line = |(count, ViewWithoutDepth { name, reason }): &(usize, &ViewWithoutDepth)| {
        format!("; {count}, as `{name}`: {reason}")
    };
    each.iter().map(line).collect()
}

/// The board's outline in the image of a depth camera, `margin` squares beyond its outermost
/// corners; points outside the lens's valid region are left out.
pub(in crate::calibration) fn board_outline(
    board: &Target,
    depth: &PosedDepthLens,
    color_from_board: &Pose,
    margin: f64,
) -> Vec<Pixel> {
    let [near, far] = board.extent();
    let margin_m = margin * board.spanned_chessboard().square_m;
    let [left, top] = [near.x - margin_m, near.y - margin_m];
    let [right, bottom] = [far.x + margin_m, far.y + margin_m];
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
    let depth_from_board = depth.depth_from_color * *color_from_board;
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let points = sides.flat_map(|(a, b)| {
        (0..8).map(move |k| {
            let part = f64::from(k) / 8.0;
            Point3::new(a.0 + part * (b.0 - a.0), a.1 + part * (b.1 - a.1), 0.0)
        })
    });
    points.filter_map(|point| depth.lens.pixel_from_point(&(depth_from_board * point))).collect()
}

/// The middle of the board's corners, and the distance of the outermost from it.
fn extent_of(board: &Target) -> BoardExtent {
    let [near, far] = board.extent();
    BoardExtent {
        center_in_board: nalgebra::center(&near, &far).coords,
        radius_m: (far - near).norm() / 2.0,
    }
}

/// The scatter of a sensor's corners relative to their predicted standard deviations; above 0.
fn noise(
    input: &RgbdInput,
    solved: &SolvedCamera,
    seen: impl Fn(&RgbdFrameSet) -> &Vec<Correspondence>,
) -> f64 {
    let frame_sets = views(input).map(seen).filter(|corners| !corners.is_empty());
    let views = frame_sets.zip(&solved.estimate.views).filter(|(_, view)| view.fault.is_none());
    let corners =
        views.flat_map(|(corners, view)| corners.iter().zip(&view.residuals_px).zip(&view.used));
    let (sum, count) =
        corners.filter(|(_, used)| **used).fold((0.0, 0), |(sum, count), ((corner, [x, y]), _)| {
            (sum + 0.5 * (x * x + y * y) / corner.std_px.powi(2), count + 1)
        });
    (sum / f64::from(count.max(1))).sqrt().max(f64::MIN_POSITIVE)
}

/// A time offset that is less certain than this, in seconds, is not used.
const MOST_OFFSET_STD_S: f64 = 0.02;

/// The board's pose in a frame set that is no view.
fn moving_pose(lens: &Lens, frame_set: &RgbdFrameSet, corners: &[Correspondence]) -> Option<Pose> {
    if frame_set.is_view || corners.is_empty() {
        return None;
    }
    let view = BoardView { name: frame_set.name.clone(), correspondences: corners.to_vec() };
    board_poses(lens, &view).ok()?.first().map(|pose| pose.camera_from_board)
}

/// A depth camera with images of `size` before any estimate: as the device states it, or at the
/// place of color, with the field of view of its lens.
pub(in crate::calibration) fn initial_depth(
    (color, color_size): (&Lens, ImageSize),
    size: ImageSize,
    stated: Option<PosedDepthLens>,
) -> PosedDepthLens {
    stated.unwrap_or_else(|| PosedDepthLens {
        lens: same_view(color, color_size, size),
        depth_from_color: Pose::identity(),
    })
}

/// A pinhole lens with about the same field of view as another camera's.
pub(in crate::calibration) fn same_view(
    lens: &Lens,
    lens_size: ImageSize,
    size: ImageSize,
) -> Lens {
    let scale = f64::from(size.width) / f64::from(lens_size.width);
    let focal = lens.matrix.fx * scale;
    let center = size.center();
    Lens::pinhole(CameraMatrix { fx: focal, fy: focal, cx: center.x, cy: center.y, skew: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commonest_reason_comes_first_with_its_first_view() {
        let of = |name: &str, reason| ViewWithoutDepth { name: name.to_owned(), reason };
        let [blank, holes] = [NoPlane::Blank { reading: 0 }, NoPlane::Holes { percent: 3 }];
        let without = [of("a", NoPlane::Outside), of("b", blank), of("c", holes), of("d", blank)];
        let line = reasons(&without);
        assert!(line.starts_with("; 2, as `b`: its depth image reads 0 everywhere"), "{line}");
        assert_eq!(line.matches("; 1, as `").count(), 2, "{line}");
        assert_eq!(reasons(&[]), "");
    }
}
