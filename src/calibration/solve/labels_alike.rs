//! A symmetric board is labeled alike in all frame sets of a camera before anything is solved: one
//! shape of the board is estimated from all of them.

use std::borrow::Cow;

use crate::calibration::solve::observations::{
    CameraFrameSets, InstrumentObservations, ObservedFrameSet,
};
use crate::calibration::solve::solve_options::{SolveMethod, SolveOptions};
use crate::estimation::camera::CameraOptions;
use crate::estimation::problem::Correspondence;
use crate::estimation::relabeled::{RelabeledProblem, relabeled};
use crate::geometry::pose::Pose;
use crate::imaging::frame::SensorKind;

/// `observations` with color's corners labeled alike. The other sensors take their labels from
/// color's where they are solved together with it.
pub(super) fn labeled_alike<'a>(
    observations: &'a InstrumentObservations,
    options: &SolveOptions,
) -> Cow<'a, InstrumentObservations> {
    let symmetries = observations.board.map_or_else(Vec::new, |board| board.symmetries());
    if symmetries.len() < 2 || options.method == SolveMethod::LinearTransform {
        return Cow::Borrowed(observations);
    }
    let mut labeled = Cow::Borrowed(observations);
    for (index, camera) in observations.cameras.iter().enumerate() {
        let problem = camera.problem(SensorKind::Color);
        let held = |lens| CameraOptions::holding(&lens, &options.camera.interrupt);
        let held = camera.given.map(held).map(|held| CameraOptions {
            measured_board: options.camera.measured_board.clone(),
            ..held
        });
        let options = held.as_ref().unwrap_or(&options.camera);
        if let Some(alike) = RelabeledProblem::labeled_alike(&problem, &symmetries, options) {
            relabel(&mut labeled.to_mut().cameras[index], &alike, &symmetries);
        }
    }
    labeled
}

/// Takes the labels of color from `alike`, view by view. Every other frame set gets those under
/// which its corners are nearest to those of the nearest view: between neighboring frames, a board
/// is not rotated far.
fn relabel(camera: &mut CameraFrameSets, alike: &RelabeledProblem, board_from_labels: &[Pose]) {
    let is_seen = |seen: &&ObservedFrameSet| !seen.corners(SensorKind::Color).is_empty();
    let numbers = camera.views().filter(is_seen).map(|seen| seen.number);
    let views = alike.problem.views.iter().map(|view| view.correspondences.as_slice());
    let views: Vec<(usize, &[Correspondence])> = numbers.zip(views).collect();
    let mut of_views = views.iter();
    for seen in &mut camera.frame_sets {
        let is_view = seen.is_view;
        let number = seen.number;
        let color = seen.corners.iter_mut().find(|(kind, _)| *kind == SensorKind::Color);
        let Some((_, corners)) = color.filter(|(_, corners)| !corners.is_empty()) else { continue };
        if is_view {
            *corners = of_views.next().map_or_else(Vec::new, |(_, corners)| corners.to_vec());
            continue;
        }
        let nearest = views.iter().min_by_key(|(view, _)| view.abs_diff(number));
        let Some((_, nearest)) = nearest else { continue };
        let labelings = board_from_labels.iter().map(|symmetry| relabeled(corners, symmetry));
        let closest =
            labelings.min_by(|a, b| distance_px(a, nearest).total_cmp(&distance_px(b, nearest)));
        if let Some(closest) = closest {
            *corners = closest;
        }
    }
}

/// The mean distance of the corners that both show.
fn distance_px(a: &[Correspondence], b: &[Correspondence]) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for own in a {
        let nearest = b.iter().min_by(|x, y| {
            let distance_m = |c: &Correspondence| (c.point_in_board - own.point_in_board).norm();
            distance_m(x).total_cmp(&distance_m(y))
        });
        if let Some(other) = nearest {
            sum += (own.pixel.to_vector() - other.pixel.to_vector()).norm();
            count += 1;
        }
    }
    sum / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::geometry::board::{BoardSize, Chessboard};
    use crate::geometry::pixel::{ImageSize, Pixel};

    /// The corners of a board that stands at `angle_rad`, labeled from the end that is on the left.
    fn corners(board: &Chessboard, angle_rad: f64) -> Vec<Correspondence> {
        let symmetries = board.symmetries();
        let symmetry = symmetries[usize::from(angle_rad.cos() < 0.0)];
        let corner = |point: Point3<f64>| {
            let at = 1000.0 * (point.coords - Vector3::new(0.105, 0.075, 0.0));
            let (sin, cos) = angle_rad.sin_cos();
            let pixel =
                Pixel::new(320.0 + cos * at.x - sin * at.y, 240.0 + sin * at.x + cos * at.y);
            Correspondence { point_in_board: symmetry * point, pixel, std_px: 0.05 }
        };
        board.corners_in_board().into_iter().map(corner).collect()
    }

    #[test]
    fn frames_between_views_are_labeled_as_the_nearest_view() {
        let board = Chessboard::new(BoardSize::new(8, 6).unwrap(), 0.03).unwrap();
        let symmetries = board.symmetries();
        let frame_set = |number: usize, angle_rad: f64, is_view: bool| ObservedFrameSet {
            number,
            name: number.to_string(),
            time_s: None,
            is_view,
            corners: vec![(SensorKind::Color, corners(&board, angle_rad))],
            depth: None,
        };
        // The board is rotated from 0 to 180 degrees. Labels change in the middle.
        let angles = [0.0, 0.3, 1.2, 1.8, 2.6, PI];
        let is_view = [true, false, false, false, false, true];
        let frame_sets = (0..6).map(|k| frame_set(k, angles[k], is_view[k])).collect();
        let mut camera = CameraFrameSets {
            name: None,
            image_sensors: vec![(SensorKind::Color, ImageSize::new(640, 480))],
            given: None,
            depth: None,
            frame_sets,
        };
        let problem = camera.problem(SensorKind::Color);
        let alike = RelabeledProblem::of(&problem, vec![symmetries[0], symmetries[1]]);
        relabel(&mut camera, &alike, &symmetries);
        for (seen, angle_rad) in camera.frame_sets.iter().zip(angles) {
            let first = seen.corners(SensorKind::Color)[0];
            assert!(first.point_in_board.coords.norm() < 1e-12, "labeled alike at {angle_rad}");
        }
    }
}
