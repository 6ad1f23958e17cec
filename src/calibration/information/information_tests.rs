//! Tests of the information: compared with numeric derivatives, and with solves with one view more;
//! and of suggestions, for cameras with known ground truth.

use nalgebra::{DMatrix, Point3, UnitQuaternion, Vector3};

use crate::calibration::information::candidate_views::{
    BoardPoints, CandidateSpace, PlacementInImage, base_rotation,
};
use crate::calibration::information::corner_noise::{CornerNoise, NoiseSample};
use crate::calibration::information::lens_information::{LensInformation, open_parameters};
use crate::calibration::information::movement::{PlacementInCamera, next_movement};
use crate::calibration::information::next_view::suggest_view;
use crate::calibration::information::pool::{Pool, information_in};
use crate::calibration::information::projection_goal::{GoalFigure, ProjectionGoal};
use crate::calibration::information::view_information::{WeightedCorner, view_information};
use crate::estimation::camera::{CameraEstimate, CameraOptions, calibrate_camera};
use crate::estimation::problem::{BoardView, CameraProblem, Correspondence, LensChoice};
use crate::geometry::board::{BoardSize, Chessboard};
use crate::geometry::lens::{Lens, LensModel};
use crate::geometry::pixel::{ImageSize, Pixel};
use crate::geometry::pose::Pose;

pub(super) const SIZE: ImageSize = ImageSize::new(640, 480);

pub(super) fn lens() -> Lens {
    let parameters = [560.0, 555.0, 328.0, 235.0, 0.0, -0.22, 0.11, 0.0008, -0.0005, -0.02];
    Lens::from_parameters(LensModel::Brown, &parameters).unwrap()
}

pub(super) fn fisheye() -> Lens {
    let parameters = [215.0, 214.0, 322.0, 236.0, 0.0, -0.012, -0.004, 0.002, -0.0006];
    Lens::from_parameters(LensModel::KannalaBrandt, &parameters).unwrap()
}

pub(super) fn board() -> Chessboard {
    Chessboard::new(BoardSize::new(9, 6).unwrap(), 0.03).unwrap()
}

/// Poses of a sequence in which all corners are seen.
fn poses(lens: &Lens, indices: impl Iterator<Item = usize>) -> Vec<Pose> {
    let (board, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
    let space = CandidateSpace {
        lens,
        size: SIZE,
        board: &board,
        noise: &noise,
        base: UnitQuaternion::identity(),
        avoided: &[],
    };
    let view = |index| space.view(&PlacementInImage::of_sequence(index));
    indices.filter_map(view).map(|view| view.camera_from_board).collect()
}

/// Numbers of unit variance that follow from `seed`: sums of twelve uniform ones.
pub(super) fn noise(seed: &mut u64) -> f64 {
    let mut uniform = || {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..12).map(|_| uniform()).sum::<f64>() - 6.0
}

fn problem(lens: &Lens, camera_from_board: &[Pose], noise_px: f64, mut seed: u64) -> CameraProblem {
    let mut view = |(index, camera_from_board): (usize, &Pose)| {
        let mut seen = |point: Point3<f64>| {
            let pixel = lens.pixel_from_point(&(*camera_from_board * point)).unwrap();
            let pixel = Pixel::new(
                pixel.x + noise_px * noise(&mut seed),
                pixel.y + noise_px * noise(&mut seed),
            );
            Correspondence { point_in_board: point, pixel, std_px: 1.0 }
        };
        let correspondences = board().corners_in_board().into_iter().map(&mut seen).collect();
        BoardView { name: index.to_string(), correspondences }
    };
    CameraProblem {
        image_size: SIZE,
        views: camera_from_board.iter().enumerate().map(&mut view).collect(),
    }
}

fn solved(problem: &CameraProblem, model: LensModel) -> CameraEstimate {
    let options = CameraOptions { lens: LensChoice::Model(model), ..CameraOptions::default() };
    calibrate_camera(problem, &options.as_stated()).unwrap()
}

/// The Schur complement of a normal matrix made of numeric derivatives.
fn numeric_information(
    lens: &Lens,
    camera_from_board: &Pose,
    corners: &[WeightedCorner],
) -> DMatrix<f64> {
    let free = open_parameters(lens.model());
    let columns = free.len() + 6;
    let mut jacobian = DMatrix::zeros(2 * corners.len(), columns);
    let seen = |column: usize, step: f64| -> Vec<Pixel> {
        let (mut parameters, mut pose) = (lens.parameters(), *camera_from_board);
        if column < free.len() {
            parameters[free[column]] += step;
        } else {
            let mut motion = [0.0; 6];
            motion[column - free.len()] = step;
            let rotation =
                UnitQuaternion::from_scaled_axis(Vector3::new(motion[0], motion[1], motion[2]));
            let translation = Vector3::new(motion[3], motion[4], motion[5]);
            pose =
                Pose::new(rotation * pose.rotation(), rotation * pose.translation() + translation);
        }
        let lens = Lens::from_parameters(lens.model(), &parameters).unwrap();
        let pixel = |c: &WeightedCorner| lens.pixel_from_point(&(pose * c.point_in_board)).unwrap();
        corners.iter().map(pixel).collect()
    };
    for column in 0..columns {
        let step = if column < 4 { 1e-3 } else { 1e-6 };
        let (up, down) = (seen(column, step), seen(column, -step));
        for (k, corner) in corners.iter().enumerate() {
            let slope = (up[k].to_vector() - down[k].to_vector()) / (2.0 * step * corner.std_px);
            jacobian[(2 * k, column)] = slope.x;
            jacobian[(2 * k + 1, column)] = slope.y;
        }
    }
    let normal = jacobian.transpose() * &jacobian;
    let n = free.len();
    let (a, b, h) =
        (normal.view((0, 0), (n, n)), normal.view((0, n), (n, 6)), normal.view((n, n), (6, 6)));
    a - b * h.into_owned().try_inverse().unwrap() * b.transpose()
}

#[test]
fn the_information_of_a_view_is_that_of_numeric_derivatives() {
    for lens in [lens(), fisheye()] {
        let poses = poses(&lens, 0..40);
        assert!(poses.len() > 20, "{} poses", poses.len());
        for pose in &poses {
            let corners: Vec<WeightedCorner> = (board().corners_in_board().into_iter().enumerate())
                .map(|(k, point_in_board)| WeightedCorner {
                    point_in_board,
                    std_px: 0.1 + 0.002 * k as f64,
                })
                .collect();
            let free = open_parameters(lens.model());
            let analytic = view_information(&lens, &free, pose, &corners).unwrap();
            let numeric = numeric_information(&lens, pose, &corners);
            for i in 0..free.len() {
                for j in 0..free.len() {
                    let scale = (numeric[(i, i)] * numeric[(j, j)]).sqrt();
                    let off = (analytic[(i, j)] - numeric[(i, j)]).abs() / scale;
                    assert!(off < 1e-4, "({i}, {j}) off by {off:e}");
                }
            }
        }
    }
}

#[test]
fn the_covariance_with_one_more_view_is_that_of_the_solve_with_it() {
    for (lens, seed) in [(lens(), 3), (fisheye(), 4), (lens(), 5)] {
        let poses = poses(&lens, 0..30);
        let all = problem(&lens, &poses[..13], 0.1, seed);
        let mut fewer = all.clone();
        fewer.views.truncate(12);
        let (before, after) = (solved(&fewer, lens.model()), solved(&all, lens.model()));
        let known = LensInformation::of_estimate(&before).unwrap();
        // The view at its pose from the later solve, with the noise from the earlier one.
        let placed = CameraEstimate { lens: before.lens, ..after.clone() };
        let more = information_in(&placed, &known.free, &all.views[12], &after.views[12]).unwrap();
        let scale = (after.noise / before.noise).powi(2);
        let predicted = known.covariance_with(&(more * scale)).unwrap();
        for (index, (predicted, solved)) in
            predicted.diagonal().iter().zip(after.lens_covariance.diagonal().iter()).enumerate()
        {
            if *solved > 0.0 {
                let ratio = (predicted * scale / solved).sqrt();
                assert!((ratio - 1.0).abs() < 0.04, "parameter {index}: {ratio}");
            }
        }
    }
}

#[test]
fn of_equal_views_the_uncertainty_falls_with_the_root_of_their_number() {
    let lens = lens();
    let goal = ProjectionGoal::new(&lens, SIZE, GoalFigure::Median);
    let estimate = solved(&problem(&lens, &poses(&lens, 0..20), 0.1, 9), LensModel::Brown);
    let known = LensInformation::of_estimate(&estimate).unwrap();
    let four_times = known.with(&(&known.matrix * 3.0));
    let [one, four] =
        [known, four_times].map(|k| goal.uncertainty_px(&k.covariance().unwrap()).unwrap());
    assert!((one / four - 2.0).abs() < 1e-9, "{one} {four}");
}

/// The candidate poses of the board for a camera with this lens.
fn space<'a>(lens: &'a Lens, board: &'a BoardPoints, noise: &'a CornerNoise) -> CandidateSpace<'a> {
    CandidateSpace {
        lens,
        size: SIZE,
        board,
        noise,
        base: UnitQuaternion::identity(),
        avoided: &[],
    }
}

#[test]
fn a_held_compensation_gives_the_map_that_it_was_taken_from() {
    for lens in [lens(), fisheye()] {
        let (board, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
        let space = space(&lens, &board, &noise);
        let mut known = LensInformation::prior(lens, SIZE);
        let mut information = (0..40).filter_map(|index| {
            let view = space.view(&PlacementInImage::of_sequence(index))?;
            let free = open_parameters(lens.model());
            view_information(&lens, &free, &view.camera_from_board, &view.corners)
        });
        for view in information.by_ref().take(6) {
            known = known.with(&view);
        }
        let goal = ProjectionGoal::new(&lens, SIZE, GoalFigure::Worst);
        let covariance = known.covariance().unwrap();
        let now = goal.map(&covariance).unwrap();
        let near = goal.near(&now).unwrap();
        for (factor, covariance) in [(1.0, covariance.clone()), (0.5, covariance * 0.25)] {
            let held = near.uncertainty(&covariance);
            for (std, expected) in held.std_px.iter().zip(&now.std_px) {
                let (std, expected) = (std.unwrap_or(0.0), factor * expected.unwrap_or(0.0));
                assert!((std - expected).abs() <= 1e-9 * expected, "{std} px, not {expected}");
            }
        }
        let after = known.covariance_with(&information.next().unwrap()).unwrap();
        let exact = goal.uncertainty_px(&after).unwrap();
        let held = goal.figure_px(&near.uncertainty(&after)).unwrap();
        assert!((held / exact - 1.0).abs() < 0.1, "{held} px for {exact} px");
    }
}

#[test]
fn frontal_views_are_followed_by_a_tilted_one() {
    let lens = lens();
    let (board, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
    let space = space(&lens, &board, &noise);
    let frontal = (0..20).filter_map(|index| {
        space.view(&PlacementInImage {
            tilt: 0.03,
            roll: 0.0,
            ..PlacementInImage::of_sequence(index)
        })
    });
    let mut known = LensInformation::prior(lens, SIZE);
    for view in frontal {
        let free = known.free.clone();
        known = known
            .with(&view_information(&lens, &free, &view.camera_from_board, &view.corners).unwrap());
    }
    let goal = ProjectionGoal::new(&lens, SIZE, GoalFigure::Median);
    let next = suggest_view(&known, &goal, &space, None, Some(0.05)).unwrap();
    let held = PlacementInCamera::of(&space, &next.camera_from_board).unwrap();
    assert!(held.tilt.norm() > 0.35, "{held:?}");
    assert!(next.expected_uncertainty_px.unwrap() < 0.8 * next.uncertainty_px, "{next:?}");
    assert!(next.outline_px.iter().all(|corner| SIZE.contains(*corner)));
    let [few, many] = next.views_to_go.unwrap();
    assert!(0 < few && few <= many, "{few} {many}");
}

#[test]
fn following_suggestions_teaches_more_than_any_order_of_the_sequence() {
    let lens = lens();
    let (board, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
    let space = space(&lens, &board, &noise);
    let goal = ProjectionGoal::new(&lens, SIZE, GoalFigure::Worst);
    let prior = LensInformation::prior(lens, SIZE);
    let informed =
        |known: &LensInformation, camera_from_board: &Pose, corners: &[WeightedCorner]| {
            known.with(&view_information(&lens, &known.free, camera_from_board, corners).unwrap())
        };
    let mut followed = prior.clone();
    for _ in 0..8 {
        let next = suggest_view(&followed, &goal, &space, None, None).unwrap();
        let corners: Vec<_> = (board.points.iter())
            .map(|point| WeightedCorner { point_in_board: *point, std_px: 0.1 })
            .collect();
        followed = informed(&followed, &next.camera_from_board, &corners);
    }
    let figure =
        |known: &LensInformation| goal.uncertainty_px(&known.covariance().unwrap()).unwrap();
    for first in 0..6 {
        let views =
            (20 * first..).filter_map(|index| space.view(&PlacementInImage::of_sequence(index)));
        let wandered = views.take(8).fold(prior.clone(), |known, view| {
            let corners: Vec<_> = (board.points.iter())
                .map(|point| WeightedCorner { point_in_board: *point, std_px: 0.1 })
                .collect();
            informed(&known, &view.camera_from_board, &corners)
        });
        let [with, without] = [&followed, &wandered].map(figure);
        assert!(with < 0.8 * without, "from {first}: {with} and {without}");
    }
}

#[test]
fn the_view_that_teaches_most_comes_before_a_repeated_one() {
    let lens = lens();
    let mut views = poses(&lens, 0..16);
    let repeated = views[0];
    views.extend([repeated; 6]);
    let problem = problem(&lens, &views, 0.1, 11);
    let estimate = solved(&problem, LensModel::Brown);
    let pool = Pool::of(&problem, &estimate, GoalFigure::Worst);
    let order = pool.order();
    assert_eq!(order.len(), views.len());
    for pair in order.windows(2) {
        assert!(pair[1].before_px == pair[0].after_px && pair[1].after_px <= pair[1].before_px);
    }
    let chosen = pool.choose(8);
    let first: Vec<usize> = order.iter().take(8).map(|step| step.view).collect();
    assert!(pool.uncertainty_px(&chosen) <= pool.uncertainty_px(&first) * (1.0 + 1e-9));
    // One of the seven that are alike is enough among eight.
    let count = views.len() - 7;
    let alike = chosen.iter().filter(|view| **view >= count || **view == 0).count();
    assert!(alike <= 2, "{chosen:?}");
}

#[test]
fn movements_are_named_by_what_is_seen_in_the_image() {
    let lens = lens();
    let (board, noise) = (BoardPoints::of_chessboard(&board()), CornerNoise::default());
    let space = space(&lens, &board, &noise);
    let middle = board.middle().coords;
    let at = |rotation: [f64; 3], place: [f64; 3]| {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(rotation));
        Pose::new(rotation, Vector3::from(place) - rotation * middle)
    };
    let here = at([0.0; 3], [0.0, 0.0, 0.6]);
    for (rotation, place, words) in [
        // Rotated about the image's x by a positive angle, the lower side moves away (y × z = x).
        ([0.5, 0.0, 0.0], [0.0, 0.0, 0.6], "tilt its top towards the camera"),
        ([-0.5, 0.0, 0.0], [0.0, 0.0, 0.6], "tilt its bottom towards the camera"),
        ([0.0, 0.5, 0.0], [0.0, 0.0, 0.6], "tilt its right side towards the camera"),
        ([0.0, 0.0, 0.6], [0.0, 0.0, 0.6], "turn it clockwise"),
        ([0.0; 3], [0.15, 0.0, 0.6], "move it to the right"),
        ([0.0; 3], [0.0, -0.15, 0.6], "move it up"),
        ([0.0; 3], [0.0, 0.0, 0.3], "bring it nearer to the camera"),
    ] {
        assert_eq!(next_movement(&space, &here, &at(rotation, place)).unwrap(), words);
    }
    // The upper side's points are nearer when it is tilted towards the camera.
    let tilted = at([0.5, 0.0, 0.0], [0.0, 0.0, 0.6]);
    assert!((tilted * board.points[0]).z < 0.6);
    assert_eq!(next_movement(&space, &here, &at([0.05; 3], [0.01, 0.0, 0.6])), None);
}

#[test]
fn blur_and_tilt_widen_the_noise() {
    let at = |distance_m: f64| NoiseSample {
        std_px: 0.1,
        side_px: 20.0,
        // In focus at 0.5 m.
        blur_px: (0.64 + (2.0 * (1.0 / distance_m - 2.0)).powi(2)).sqrt(),
        distance_m,
    };
    let samples: Vec<NoiseSample> = [0.3, 0.4, 0.5, 0.6, 0.8].map(at).to_vec();
    let noise = CornerNoise::learn(&samples);
    assert!((noise.blur_px(0.5) - 0.8).abs() < 1e-6, "{}", noise.blur_px(0.5));
    assert!(noise.blur_px(0.32) > 2.0 * noise.blur_px(0.5));
    assert!(noise.std_px(10.0, 0.5) > 1.3 * noise.std_px(20.0, 0.5));
    assert!(noise.std_px(20.0, 0.3) > 1.3 * noise.std_px(20.0, 0.5));
}

#[test]
fn a_board_at_the_rim_of_a_fisheye_is_seen_from_the_front() {
    // Its normal points along the line of sight, 80 degrees off the axis and tilted by 20 more.
    let seen_at = |angle: f64| Pose::from_axis_angle(Vector3::y() * angle, Vector3::zeros());
    let camera_from_facing =
        seen_at(80_f64.to_radians()) * Pose::from_axis_angle(Vector3::zeros(), Vector3::z());
    let camera_from_board = camera_from_facing * seen_at(20_f64.to_radians());
    assert!((camera_from_board * Vector3::z()).z < 0.0);
    let base = base_rotation(&camera_from_board);
    assert!((base * Vector3::z()).z > 0.99, "{base}");
}
