//! What the joint solve of color, infrared and depth starts from: the sensors calibrated one by one,
//! the board's motion, what disparity means, and the board's surface in every depth image.

use std::cmp::Reverse;
use std::mem::discriminant;

use nalgebra::{DMatrix, Point3};

use crate::calibration::rgbd_error::RgbdError;
use crate::calibration::rgbd_input::{RgbdCapture, RgbdInput, poses, views};
use crate::calibration::solve::SolvedCamera;
use crate::detection::board_plane::{NoPlane, PlaneOptions, find_board_plane};
use crate::detection::plane_growth::grow_plane;
use crate::estimation::board_pose::board_poses;
use crate::estimation::board_surface::BoardSurface;
use crate::estimation::problem::{BoardView, CameraOptions, Correspondence};
use crate::estimation::rgbd::motion::{
    BoardMotion, SeenByBoth, TimeOffset, board_motions, time_offset,
};
use crate::estimation::rgbd::{DepthLens, RgbdProblem, RgbdView};
use crate::geometry::camera_matrix::CameraMatrix;
use crate::geometry::depth_camera::{DepthCamera, DepthReading, DepthTile};
use crate::geometry::depth_correction::CorrectedQuantity;
use crate::geometry::lens::Lens;
use crate::geometry::median::{median, median_pose};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;
use crate::geometry::target::Target;

/// The joint problem, which capture each of its views is, and those whose depth could not be used.
pub(super) struct Measured {
    pub(super) problem: RgbdProblem,
    pub(super) captures: Vec<usize>,
    pub(super) without_depth: Vec<(String, NoPlane)>,
}

impl Measured {
    /// That the lens which was fitted to these planes no longer sees the board there.
    pub(super) fn lens_elsewhere(&self) -> RgbdError {
        let views = &self.problem.views;
        RgbdError::LensElsewhere {
            usable: views.iter().filter(|view| !view.tiles.is_empty()).count(),
            all: views.len(),
            reasons: reasons(&self.without_depth),
        }
    }
}

/// What the joint solve starts from.
pub(super) struct Guess {
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
    /// The board's, where color measured it.
    surface: Option<BoardSurface>,
    /// Of every capture that has one.
    color_from_board: Vec<Option<Pose>>,
    infrared_used: Vec<bool>,
    motions: Vec<Option<BoardMotion>>,
    time_offset: Option<TimeOffset>,
}

impl Guess {
    pub(super) fn of(
        input: &RgbdInput,
        size: ImageSize,
        (color, color_options): (&SolvedCamera, &CameraOptions),
        infrared: Option<&SolvedCamera>,
    ) -> Self {
        let color_poses = poses(input, color, |c| &c.color);
        let none = vec![None; input.captures.len()];
        let infrared_poses = infrared.map_or(none, |solved| poses(input, solved, |c| &c.infrared));
        let factory = input.depth.factory;
        let (lens, depth_from_color) = match infrared {
            Some(solved) => {
                let both = color_poses.iter().zip(&infrared_poses);
                let depth_from_color: Vec<Pose> = both
                    .filter_map(|(color, infrared)| Some((*infrared)? * (*color)?.inverse()))
                    .collect();
                (solved.estimate.lens, median_pose(&depth_from_color).unwrap_or(Pose::identity()))
            }
            None => factory.unwrap_or_else(|| {
                (same_view(&color.estimate.lens, input.color_size, size), Pose::identity())
            }),
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

    /// The board's motion at each capture, and the time between the sensors, by every capture that
    /// both see the board in.
    fn find_motion(
        &mut self,
        input: &RgbdInput,
        color: &[Option<Pose>],
        infrared: &[Option<Pose>],
    ) {
        let moments: Vec<(usize, (f64, Pose))> = input
            .captures
            .iter()
            .enumerate()
            .filter_map(|(index, capture)| {
                let pose =
                    color[index].or_else(|| moving_pose(&self.color, capture, &capture.color))?;
                Some((index, (capture.time_s?, pose)))
            })
            .collect();
        let poses: Vec<(f64, Pose)> = moments.iter().map(|(_, moment)| *moment).collect();
        self.motions = vec![None; input.captures.len()];
        let (mut both, (middle, radius_m)) = (Vec::new(), middle_of(&input.board));
        for ((index, (_, first_from_board)), motion) in moments.iter().zip(board_motions(&poses)) {
            self.motions[*index] = motion;
            let capture = &input.captures[*index];
            let second =
                infrared[*index].or_else(|| moving_pose(&self.lens, capture, &capture.infrared));
            if let (Some(motion), Some(second_from_board), DepthLens::Infrared) =
                (motion, second, self.depth_lens)
            {
                both.push(SeenByBoth {
                    first_from_board: *first_from_board,
                    motion,
                    second_from_board,
                });
            }
        }
        self.time_offset = time_offset(&self.depth_from_color, &both, (middle.coords, radius_m))
            .filter(|offset| offset.std_s < LEAST_SURE_S);
    }

    /// What disparity means, from what is read in the board's middle and how far away color says
    /// it is: the line through the pairs by the median of the slopes between them (H. Theil, 1950).
    fn disparity(&self, input: &RgbdInput) -> Option<DepthReading> {
        let (middle, _) = middle_of(&input.board);
        let pair = |(capture, pose): (&RgbdCapture, &Option<Pose>)| {
            let point = self.depth_from_color * ((*pose)? * middle);
            let pixel = self.lens.pixel_from_point(&point)?;
            let image = capture.depth.as_ref().filter(|d| d.only_reading().is_none())?;
            let (x, y) = (pixel.x.round(), pixel.y.round());
            let inside = image
                .size()
                .contains(Pixel::new(x, y))
                .then(|| image.row(y as usize)[x as usize])?;
            (Some(inside) != input.depth.invalid).then(|| (f64::from(inside), 1.0 / point.z))
        };
        let pairs: Vec<(f64, f64)> =
            input.captures.iter().zip(&self.color_from_board).filter_map(pair).collect();
        let slopes = pairs.iter().enumerate().flat_map(|(k, a)| {
            pairs[k + 1..]
                .iter()
                .filter(|b| (a.0 - b.0).abs() > 1.0)
                .map(|b| (a.1 - b.1) / (a.0 - b.0))
        });
        let slope = median(slopes.collect())?;
        let offset = median(pairs.iter().map(|(raw, inverse)| inverse - slope * raw).collect())?;
        Some(DepthReading::Disparity { offset, slope })
    }

    /// The board's surface in every depth image, up to `margin` squares past its outer corners.
    pub(super) fn measured(&self, input: &RgbdInput, margin: f64) -> Result<Measured, RgbdError> {
        let (mut views, mut captures, mut without_depth) = (Vec::new(), Vec::new(), Vec::new());
        let plane_options =
            PlaneOptions { invalid: input.depth.invalid, ..PlaneOptions::default() };
        let mut with_depth = 0;
        for (index, (capture, pose)) in
            input.captures.iter().zip(&self.color_from_board).enumerate()
        {
            let (Some(color_from_board), true) = (*pose, capture.is_view) else { continue };
            let seen = capture.depth.as_ref().map(|image| {
                let place = (&self.lens, &self.depth_from_color);
                let outline = board_outline(&input.board, place, &color_from_board, margin);
                let meaning = (self.reading, &self.lens);
                let tiles = find_board_plane(image, meaning, &outline, &plane_options)?;
                let surround = grow_plane(image, meaning, (&tiles, &outline), &plane_options);
                Ok((self.on_plane(tiles, &color_from_board), surround))
            });
            let (tiles, surround) = match seen {
                Some(Ok(seen)) => seen,
                Some(Err(reason)) => {
                    without_depth.push((capture.name.clone(), reason));
                    (Vec::new(), Vec::new())
                }
                None => (Vec::new(), Vec::new()),
            };
            with_depth += usize::from(!tiles.is_empty());
            let infrared =
                if self.infrared_used[index] { capture.infrared.clone() } else { Vec::new() };
            views.push(RgbdView {
                name: capture.name.clone(),
                color: capture.color.clone(),
                infrared,
                tiles,
                surround,
                color_from_board,
                motion: self.motions[index],
            });
            captures.push(index);
        }
        if with_depth < 3 {
            let (usable, all) = (with_depth, views.len());
            let reasons = reasons(&without_depth);
            return Err(RgbdError::TooLittleDepth { usable, all, reasons });
        }
        Ok(Measured { problem: self.problem(views), captures, without_depth })
    }

    /// The board's `tiles` as they would be on its plane, which is what they are compared with.
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

/// Why views are without depth: each reason with how many have it and the first of them, the
/// commonest first.
fn reasons(without_depth: &[(String, NoPlane)]) -> String {
    let mut each: Vec<(usize, &String, NoPlane)> = Vec::new();
    for (name, reason) in without_depth {
        let same = |(_, _, other): &&mut (usize, &String, NoPlane)| {
            discriminant(other) == discriminant(reason)
        };
        match each.iter_mut().find(same) {
            Some((count, ..)) => *count += 1,
            None => each.push((1, name, *reason)),
        }
    }
    each.sort_by_key(|(count, ..)| Reverse(*count));
    each.iter().map(|(count, name, reason)| format!("; {count}, as `{name}`: {reason}")).collect()
}

/// The board's edge in the image of a depth camera with this lens at `depth_from_color`, `margin`
/// squares past its outer inner corners; what the lens does not see is left out.
pub(super) fn board_outline(
    board: &Target,
    (lens, depth_from_color): (&Lens, &Pose),
    color_from_board: &Pose,
    margin: f64,
) -> Vec<Pixel> {
    let [near, far] = board.extent();
    let margin_m = margin * board.spanned_chessboard().square_m;
    let [left, top] = [near.x - margin_m, near.y - margin_m];
    let [right, bottom] = [far.x + margin_m, far.y + margin_m];
    let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
    let depth_from_board = *depth_from_color * *color_from_board;
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let points = sides.flat_map(|(a, b)| {
        (0..8).map(move |k| {
            let part = f64::from(k) / 8.0;
            Point3::new(a.0 + part * (b.0 - a.0), a.1 + part * (b.1 - a.1), 0.0)
        })
    });
    points.filter_map(|point| lens.pixel_from_point(&(depth_from_board * point))).collect()
}

/// The middle of the board's corners in the board frame, and how far the outermost are from it, in
/// meters.
fn middle_of(board: &Target) -> (Point3<f64>, f64) {
    let [near, far] = board.extent();
    (nalgebra::center(&near, &far), (far - near).norm() / 2.0)
}

/// By how much a sensor's corners scatter more than their own deviations say; above 0.
fn noise(
    input: &RgbdInput,
    solved: &SolvedCamera,
    seen: impl Fn(&RgbdCapture) -> &Vec<Correspondence>,
) -> f64 {
    let captures = views(input).map(seen).filter(|corners| !corners.is_empty());
    let views = captures.zip(&solved.estimate.views).filter(|(_, view)| view.fault.is_none());
    let corners =
        views.flat_map(|(corners, view)| corners.iter().zip(&view.residuals_px).zip(&view.used));
    let (sum, count) =
        corners.filter(|(_, used)| **used).fold((0.0, 0), |(sum, count), ((corner, [x, y]), _)| {
            (sum + 0.5 * (x * x + y * y) / corner.std_px.powi(2), count + 1)
        });
    (sum / f64::from(count.max(1))).sqrt().max(f64::MIN_POSITIVE)
}

/// A time that is less sure than this, in seconds, is none.
const LEAST_SURE_S: f64 = 0.02;

/// Where the board was in a capture that is no view.
fn moving_pose(lens: &Lens, capture: &RgbdCapture, corners: &[Correspondence]) -> Option<Pose> {
    if capture.is_view || corners.is_empty() {
        return None;
    }
    let view = BoardView { name: capture.name.clone(), correspondences: corners.to_vec() };
    board_poses(lens, &view).ok()?.first().map(|pose| pose.camera_from_board)
}

/// A pinhole that sees about as much of the world as another camera does.
pub(super) fn same_view(lens: &Lens, lens_size: ImageSize, size: ImageSize) -> Lens {
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
        let of = |name: &str, reason| (name.to_owned(), reason);
        let [blank, holes] = [NoPlane::Blank { reading: 0 }, NoPlane::Holes { percent: 3 }];
        let without = [of("a", NoPlane::Outside), of("b", blank), of("c", holes), of("d", blank)];
        let line = reasons(&without);
        assert!(line.starts_with("; 2, as `b`: its depth image reads 0 everywhere"), "{line}");
        assert_eq!(line.matches("; 1, as `").count(), 2, "{line}");
        assert_eq!(reasons(&[]), "");
    }
}
